"""Distances of the shapes of a MuJoCo model by Coal, Pinocchio's collision library."""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxcslc._environment import require


@dataclasses.dataclass(frozen=True, eq=False)
class CoalShapes:
    """Distances of the shapes of a MuJoCo model by Coal, Pinocchio's library of collisions.

    MuJoCo says where shapes are. Meshes are their convex hulls, as MuJoCo takes them.

    **Attributes**

    - `shapes`: of each geometry, in the order of the model.
    """

    shapes: tuple[Any, ...]

    @classmethod
    def of(cls, model: Any) -> "CoalShapes":
        """Make the shapes of a compiled model.

        **Raises**

        - `ValueError`: a geometry of another kind than spheres, capsules, ellipsoids, cylinders,
          boxes and meshes; names its body.
        - `MissingExtraError`: without Coal.
        """
        return cls(tuple(_shape(model, geom) for geom in range(model.ngeom)))

    def distance(
        self, data: Any, first: int, second: int, farthest: float, ends: Float[np.ndarray, "6"]
    ) -> float:
        """Compute the distance of two geometries, at most `farthest` [m], negative if they overlap.

        **Arguments**

        - `data`: MuJoCo's, of a pose.
        - `ends`: takes the nearest points of both.
        """
        coal: Any = require("coal", "collision")
        result = coal.DistanceResult()
        poses = [
            coal.Transform3s(data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom])
            for geom in (first, second)
        ]
        distance = coal.distance(
            self.shapes[first],
            poses[0],
            self.shapes[second],
            poses[1],
            coal.DistanceRequest(),
            result,
        )
        if distance < farthest:
            ends[:3], ends[3:] = result.getNearestPoint1(), result.getNearestPoint2()
        return min(float(distance), farthest)


def _shape(model: Any, geom: int) -> Any:
    """A geometry as Coal's shape, in the frame of MuJoCo's."""
    coal: Any = require("coal", "collision")
    mujoco: Any = require("mujoco", "urdf")
    kinds = mujoco.mjtGeom
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    if kind == kinds.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        begin = int(model.mesh_vertadr[mesh])
        vertices = coal.StdVec_Vec3s()
        for vertex in model.mesh_vert[begin : begin + int(model.mesh_vertnum[mesh])]:
            vertices.append(np.asarray(vertex, float))
        return coal.Convex.convexHull(vertices, False, None)
    a, b, c = (float(x) for x in size)
    shapes = {
        int(kinds.mjGEOM_SPHERE): lambda: coal.Sphere(a),
        int(kinds.mjGEOM_CAPSULE): lambda: coal.Capsule(a, 2 * b),
        int(kinds.mjGEOM_ELLIPSOID): lambda: coal.Ellipsoid(a, b, c),
        int(kinds.mjGEOM_CYLINDER): lambda: coal.Cylinder(a, 2 * b),
        int(kinds.mjGEOM_BOX): lambda: coal.Box(2 * a, 2 * b, 2 * c),
    }
    if kind not in shapes:
        body = model.body(int(model.geom_bodyid[geom])).name
        raise ValueError(
            f"surroundings: a shape of body {body!r} is of a kind that Coal's distances lack;"
            " expected spheres, capsules, ellipsoids, cylinders, boxes or meshes"
        )
    return shapes[kind]()
