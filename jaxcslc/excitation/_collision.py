"""Distances of a robot's bodies from each other and from obstacles, by MuJoCo.

Shapes are those of the robot's URDF or MJCF file, or capsules along its links. The search takes
distances as linear about a motion (`Contacts`); the dense check bounds them at all times
(`clearance`).
"""

import dataclasses
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from .._environment import require
from ..manipulator import Manipulator
from ._families import AbstractFamily, Parameters, sample_times
from ._limits import Surroundings
from ._search import Contacts, padded_contacts


# Of the search: what it keeps beside the clearance, and how far it looks [m].
_BESIDE, _FAR = 0.004, 0.15
# Of the check: first and last interval [s].
_COARSE, _FINE = 0.02, 0.00125
_POSES, _ALWAYS = 100, 0.9  # random poses; bodies that touch in most of them are joined


@dataclasses.dataclass(frozen=True, eq=False)
class CollisionBodies:
    """The shapes of a robot and of what surrounds it, and their distances.

    Bodies that a joint connects may touch, and those that touch in nearly every pose: their shapes
    overlap by design.

    **Attributes**

    - `data`: MuJoCo's, of a model whose bodies are the robot's and whose world holds the obstacles.
    - `joints`: of each joint, its index in the model.
    - `pairs`: (pairs, 2) geometries whose distance counts.
    - `levers`: (pairs, n) how far a unit of a joint's motion moves points of one body of a pair
      against those of the other, at most [m/rad or 1].
    - `wanted`: (pairs,) the least distance [m]: the clearance, or half of the distance of bodies
      that are that near in most poses by design.
    """

    data: Any
    joints: np.ndarray
    pairs: np.ndarray
    levers: Float[np.ndarray, "pairs joints"]
    wanted: Float[np.ndarray, " pairs"]

    @classmethod
    def of(cls, robot: Manipulator, surroundings: Surroundings) -> "CollisionBodies":
        """Make the bodies of a robot's file, or capsules along its links.

        **Raises**

        - `ValueError`: a robot without shapes and without radius, a mesh that cannot be read.
        - `MissingExtraError`: without MuJoCo.
        """
        if len(robot.independent_joints) < robot.joint_count:
            raise ValueError(
                f"surroundings: {robot.name!r} has joints that follow others, whose shapes are not"
                " moved; expected them fixed (--mimic fix), or limits without [surroundings]"
            )
        mujoco: Any = require("mujoco", "urdf")
        model, joints = compiled_geometry(robot, surroundings)
        pairs = _candidate_pairs(model, surroundings)
        everything = cls(mujoco.MjData(model), joints, pairs, np.zeros((0, 0)), np.zeros(0))
        usual, apart = everything._usual_distances(2.0 * surroundings.clearance + 1e-3)
        wanted = np.minimum(surroundings.clearance, usual[apart] / 2)
        pairs = pairs[apart]
        return cls(everything.data, joints, pairs, _levers(model, joints, pairs), wanted)

    def distances(
        self, q: Float[np.ndarray, " joints"], farthest: float
    ) -> tuple[Float[np.ndarray, " pairs"], Float[np.ndarray, "pairs 6"]]:
        """Compute the distances of all pairs in a pose, at most `farthest` [m], and nearest points.

        `data` is then that of the pose.
        """
        mujoco: Any = require("mujoco", "urdf")
        data, model = self.data, self.data.model
        data.qpos[model.jnt_qposadr[self.joints]] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        first, second = self.pairs.T
        gap = np.linalg.norm(data.geom_xpos[first] - data.geom_xpos[second], axis=1)
        gap -= model.geom_rbound[first] + model.geom_rbound[second]
        distance, ends = np.full(len(self.pairs), farthest), np.zeros((len(self.pairs), 6))
        for i in np.flatnonzero(gap < farthest):
            a, b = (int(g) for g in self.pairs[i])
            distance[i] = mujoco.mj_geomDistance(model, data, a, b, farthest, ends[i])
        return distance, ends

    def contacts(self, q: Float[np.ndarray, "samples joints"], beside: float = _BESIDE) -> Contacts:
        """Return small distances and their slopes along a motion on a grid.

        **Arguments**

        - `q`: positions on the grid.
        - `beside`: is kept in addition to the clearance [m].
        """
        rows: list[tuple[int, float, np.ndarray]] = []
        for sample, pose in enumerate(q):
            distance, ends = self.distances(pose, _FAR)
            for i in np.flatnonzero(distance < _FAR):
                way = ends[i, 3:] - ends[i, :3]
                length = float(np.linalg.norm(way))
                if length < 1e-9:
                    continue
                direction = np.sign(distance[i] or 1.0) * way / length
                share = self.wanted[i] / self.wanted.max()
                beyond = float(distance[i]) - self.wanted[i] - share * beside
                rows.append((sample, beyond, direction @ self._approach(self.pairs[i], ends[i])))
        sample = np.array([row[0] for row in rows], int)
        return padded_contacts(
            Contacts(
                sample,
                np.array([row[1] for row in rows]),
                np.array([row[2] for row in rows]).reshape(-1, q.shape[1]),
                q[sample],
            )
        )

    def _approach(
        self, pair: np.ndarray, ends: Float[np.ndarray, "6"]
    ) -> Float[np.ndarray, "3 joints"]:
        """Return the Jacobian of the way between the nearest points of a pair, in `data`'s pose."""
        mujoco: Any = require("mujoco", "urdf")
        model = self.data.model
        jacobians = np.zeros((2, 3, model.nv))
        for point, geom, jacobian in zip(ends.reshape(2, 3), pair, jacobians, strict=True):
            body = int(model.geom_bodyid[geom])
            mujoco.mj_jac(model, self.data, jacobian, None, point, body)
        return (jacobians[1] - jacobians[0])[:, model.jnt_dofadr[self.joints]]

    def clearance(self, family: AbstractFamily, parameters: Parameters) -> tuple[float, str]:
        """Compute what is left of the clearance along a whole motion [m], and between which bodies.

        Between two instants no distance of a pair is less than the mean of those at both, less half
        of what the joints between its bodies can move any of their points meanwhile. Where that is
        not enough, the interval is halved.
        """
        if not len(self.pairs):
            return _FAR, "no bodies"
        parameters = np.asarray(parameters, float)
        time = sample_times(family.duration, 1.0 / _COARSE)
        positions = np.asarray(family.derivative(parameters, time))
        beyond = self._beyond(positions)
        name = self._pair_name(int(beyond.min(0).argmin()))
        lowest = float(beyond.min())
        if lowest < 0.0:
            return lowest, name
        speed = np.abs(np.asarray(family.derivative(parameters, time, 1)))
        acceleration = family.bound(parameters, 2)
        start, end, before, after = time[:-1], time[1:], beyond[:-1], beyond[1:]
        fastest = np.maximum(speed[:-1], speed[1:])
        while len(start):
            span = (end - start)[:, None]
            # No joint is faster meanwhile than at the ends and what acceleration adds.
            travel = span * (fastest + span / 2 * acceleration) @ self.levers.T
            sure = ((before + after - travel) / 2).min(1)
            if span[0, 0] <= _FINE:
                lowest = min(lowest, float(sure.min()))
                break
            open_ = sure < 0.0
            lowest = min(lowest, float(sure[~open_].min(initial=np.inf)))
            start, end, before, after = (x[open_] for x in (start, end, before, after))
            middle = (start + end) / 2
            positions = np.asarray(family.derivative(parameters, middle))
            between = self._beyond(positions)
            fastest = np.concatenate([fastest[open_]] * 2)
            start, end = np.concatenate([start, middle]), np.concatenate([middle, end])
            before, after = np.concatenate([before, between]), np.concatenate([between, after])
        return lowest, name

    def _beyond(
        self, positions: Float[np.ndarray, "poses joints"]
    ) -> Float[np.ndarray, "poses pairs"]:
        """Compute the distances of pairs less what is wanted [m]; those far away are alike."""
        far = _FAR + float(self.wanted.max())
        distances = [self.distances(pose, far)[0] for pose in positions]
        return np.reshape(distances, (len(positions), len(self.pairs))) - self.wanted

    def _pair_name(self, pair: int) -> str:
        return " and ".join(_geom_name(self.data.model, int(geom)) for geom in self.pairs[pair])

    def _usual_distances(self, farthest: float) -> tuple[np.ndarray, np.ndarray]:
        """Return each pair's median distance over random poses, and which do not touch in most.

        Distances are up to `farthest` [m]. Pairs of the same two bodies are joined together.
        """
        model = self.data.model
        rng = np.random.default_rng(0)
        low, high = model.jnt_range[self.joints].T
        free = low >= high
        low, high = np.where(free, -np.pi, low), np.where(free, np.pi, high)
        distance = np.stack(
            [self.distances(rng.uniform(low, high), farthest)[0] for _ in range(_POSES)]
        )
        always = np.mean(distance <= 0.0, axis=0) >= _ALWAYS

        def key(pair: np.ndarray) -> tuple[int, ...]:
            bodies = model.geom_bodyid[pair]
            return tuple(
                sorted(int(x) if x else -int(g) for x, g in zip(bodies, pair, strict=True))
            )

        joined = {key(pair) for pair in self.pairs[always]}
        apart = np.array([key(pair) not in joined for pair in self.pairs], bool)
        return np.median(distance, axis=0), apart


def _geom_name(model: Any, geom: int) -> str:
    """Return the name of a geometry's body, of those of the world its own."""
    body = int(model.geom_bodyid[geom])
    return model.geom(geom).name if body == 0 else model.body(body).name


def _candidate_pairs(model: Any, surroundings: Surroundings) -> np.ndarray:
    """Return pairs of geometries of bodies that no joint connects, and of bodies and obstacles."""
    weld = model.body_weldid
    parent = weld[model.body_parentid]
    ignored = {frozenset(pair) for pair in surroundings.ignore}
    pairs: list[tuple[int, int]] = []
    for a in range(model.ngeom):
        for b in range(a + 1, model.ngeom):
            first, second = (int(weld[model.geom_bodyid[g]]) for g in (a, b))
            if first == second:
                continue
            names = frozenset(_geom_name(model, g) for g in (a, b))
            obstacle = any(model.geom(g).name.startswith("obstacle") for g in (a, b))
            joined = not obstacle and (parent[first] == second or parent[second] == first)
            if joined or names in ignored or not (obstacle or surroundings.self_collision):
                continue
            pairs.append((a, b))
    return np.array(pairs, int).reshape(-1, 2)


def _levers(model: Any, joints: np.ndarray, pairs: np.ndarray) -> Float[np.ndarray, "pairs joints"]:
    """Bound how far a unit of a joint's motion moves two geometries against each other."""
    of_geom = np.stack([_levers_of(model, joints, geom) for geom in range(model.ngeom)])
    first, second = of_geom[pairs[:, 0]], of_geom[pairs[:, 1]]
    # Joints that carry both move them alike.
    return np.where((first > 0) & (second > 0), 0.0, np.maximum(first, second))


def _levers_of(model: Any, joints: np.ndarray, geom: int) -> Float[np.ndarray, " joints"]:
    """Bound how far a unit of each joint's motion moves points of a geometry."""
    levers = np.zeros(len(joints))
    body = int(model.geom_bodyid[geom])
    reach = float(np.linalg.norm(model.geom_pos[geom]) + model.geom_rbound[geom])
    while body > 0:
        for joint in range(
            model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]
        ):
            column = np.flatnonzero(joints == joint)
            slides = int(model.jnt_type[joint]) == 2
            if column.size:
                anchor = float(np.linalg.norm(model.jnt_pos[joint]))
                levers[column[0]] = 1.0 if slides else reach + anchor
            reach += float(np.abs(model.jnt_range[joint]).max()) if slides else 0.0
        reach += float(np.linalg.norm(model.body_pos[body]))
        body = int(model.body_parentid[body])
    return levers


_MESH = re.compile(r"""(<mesh\b[^>]*?\bfilename\s*=\s*)(["'])(.*?)\2""")
_VISUAL = re.compile(r"<visual\b.*?</visual\s*>|<visual\b[^>]*/>", re.DOTALL)
_ROOT = re.compile(r"<robot\b[^>]*>")
_COMPILER = (
    '<mujoco><compiler strippath="false" fusestatic="false" discardvisual="false"/></mujoco>'
)
_READ = (".stl", ".obj", ".msh")
_THICK = 1.0  # of walls and floors [m]
_WIDE = 20.0


def compiled_geometry(robot: Manipulator, surroundings: Surroundings) -> tuple[Any, np.ndarray]:
    """Return a MuJoCo model of a robot's shapes and of obstacles, and the indices of its joints.

    Shapes are those for collisions of the robot's URDF or MJCF file; of robots without such a file,
    or where a radius is set, capsules from the origin of each link's frame to those of the frames
    that it carries. Obstacles are in the frame of the file's root, or in frame 0.

    **Raises**

    - `ValueError`: no shapes; a mesh that is not there or in a format that MuJoCo cannot read.
    """
    mujoco: Any = require("mujoco", "urdf")
    source = robot.source
    if surroundings.radius is None:
        if source is None or source.format == "toml":
            raise ValueError(
                f"surroundings: {robot.name!r} has no shapes; expected 'radius' of capsules along"
                " its links, or a URDF or MJCF file with geometry"
            )
        spec = _spec_of_file(Path(source.path), source.format == "urdf")
        names: Sequence[str] = source.joints
    else:
        spec = _spec_of_capsules(mujoco, robot, surroundings.radius)
        names = [f"joint {i + 1}" for i in range(robot.joint_count)]
    if not any(_collides(geom) for geom in spec.geoms):
        raise ValueError(
            f"surroundings: the file of {robot.name!r} has no shapes for collisions; expected"
            " 'radius' of capsules along its links"
        )
    _add_obstacles(mujoco, spec, surroundings)
    for body in spec.bodies[1:]:
        # Masses do not matter here, and MuJoCo compiles no moving body without.
        body.mass, body.inertia, body.explicitinertial = 1.0, np.ones(3), True
        body.ipos, body.fullinertia = np.zeros(3), [np.nan, 0, 0, 0, 0, 0]
    try:
        model = spec.compile()
    except ValueError as error:
        text = " ".join(str(error).split()).removeprefix("Error: ")
        raise ValueError(f"surroundings: shapes of {robot.name!r}: {text}") from None
    return model, np.array([int(model.joint(name).id) for name in names], int)


def _collides(geom: Any) -> bool:
    return bool(geom.contype or geom.conaffinity)


def _spec_of_file(path: Path, urdf: bool) -> Any:
    mujoco: Any = require("mujoco", "urdf")
    try:
        if not urdf:
            spec = mujoco.MjSpec.from_file(str(path))
            for geom in list(spec.geoms):
                if not _collides(geom):
                    spec.delete(geom)
        else:
            text = _VISUAL.sub("", path.read_text(encoding="utf-8"))
            text = _MESH.sub(lambda match: _resolved(match, path), text)
            text = _ROOT.sub(lambda match: match[0] + _COMPILER, text, count=1)
            spec = mujoco.MjSpec.from_string(text)
    except ValueError as error:
        if str(error).startswith("surroundings"):
            raise
        text = " ".join(str(error).split()).removeprefix("Error: ")
        raise ValueError(f"surroundings: shapes of {path}: {text}") from None
    for elements in (spec.equalities, spec.actuators, spec.sensors, spec.keys, spec.excludes):
        for element in list(elements):
            spec.delete(element)
    return spec


def _resolved(match: re.Match[str], urdf: Path) -> str:
    """Return a mesh's file name; packages of ROS are looked for in folders above the URDF."""
    name = match[3]
    relative = name.removeprefix("file://").removeprefix("package://")
    candidates = [Path(relative), urdf.parent / relative]
    if name.startswith("package://"):
        without_package = Path(*Path(relative).parts[1:])
        for folder in urdf.resolve().parents:
            candidates += [folder / relative, folder / without_package]
    file = next((path for path in candidates if path.is_file()), None)
    if file is None:
        raise ValueError(
            f"surroundings: mesh {name!r} of {urdf} is not there; expected it in a folder above the"
            " URDF, or 'radius' of capsules along the links"
        )
    if file.suffix.lower() not in _READ:
        raise ValueError(
            f"surroundings: mesh {file.name!r} of {urdf}: expected {', '.join(_READ)}, or 'radius'"
            " of capsules along the links"
        )
    return f"{match[1]}{match[2]}{file.resolve()}{match[2]}"


def _spec_of_capsules(mujoco: Any, robot: Manipulator, radius: float | tuple[float, ...]) -> Any:
    """Make links as capsules between the origins of their frames."""
    n = robot.joint_count
    radii = np.atleast_1d(np.asarray(radius, float))
    if len(radii) not in (1, n) or not np.all(radii > 0):
        raise ValueError(f"surroundings, radius: expected one number above 0 or {n}, got {radius}")
    radii = np.broadcast_to(radii, (n,))
    spec = mujoco.MjSpec()
    bodies: list[Any] = []
    for i, (joint, parent) in enumerate(zip(robot.joints, robot.parents, strict=True)):
        carrier = spec.worldbody if parent < 0 else bodies[parent]
        pose = _frame(joint)
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, pose[:3, :3].ravel())
        body = carrier.add_body(name=f"link {i + 1}", pos=pose[:3, 3], quat=quaternion)
        kinds = mujoco.mjtJoint
        body.add_joint(
            name=f"joint {i + 1}",
            type=kinds.mjJNT_HINGE if joint.kind == "R" else kinds.mjJNT_SLIDE,
            axis=[0, 0, 1],
        )
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radii[i], 0.0, 0.0])
        if parent >= 0 and np.linalg.norm(pose[:3, 3]) > 1e-6:
            carrier.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                size=[radii[parent], 0.0, 0.0],
                fromto=[0, 0, 0, *pose[:3, 3]],
            )
        bodies.append(body)
    return spec


def _frame(joint: Any) -> np.ndarray:
    """Return the pose of a joint's frame in its parent's at the zero position."""

    def screw(angle: float, length: float, axis: int) -> np.ndarray:
        pose = np.eye(4)
        i, j = [(1, 2), (2, 0), (0, 1)][axis]
        pose[i, i] = pose[j, j] = math.cos(angle)
        pose[i, j], pose[j, i] = -math.sin(angle), math.sin(angle)
        pose[axis, 3] = length
        return pose

    a, b, d = (float(length.value or 0.0) for length in (joint.a, joint.b, joint.d))
    return screw(joint.gamma, b, 2) @ screw(joint.alpha, a, 0) @ screw(joint.theta, d, 2)


def _add_obstacles(mujoco: Any, spec: Any, surroundings: Surroundings) -> None:
    box, sphere = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_SPHERE

    def add(name: str, kind: Any, size: Sequence[float], centre: Sequence[float]) -> None:
        spec.worldbody.add_geom(name=f"obstacle {name}", type=kind, size=size, pos=centre)

    def wall(name: str, axis: int, at: float, sign: int) -> None:
        """Add everything beyond a plane, as a thick box."""
        size, centre = [_WIDE] * 3, [0.0] * 3
        size[axis], centre[axis] = _THICK, at + sign * _THICK
        add(name, box, size, centre)

    if surroundings.floor is not None:
        wall("floor", 2, surroundings.floor, -1)
    if surroundings.workspace is not None:
        low, high = surroundings.workspace
        for axis, letter in enumerate("xyz"):
            wall(f"workspace -{letter}", axis, low[axis], -1)
            wall(f"workspace +{letter}", axis, high[axis], 1)
    for i, (centre, size) in enumerate(surroundings.boxes, 1):
        add(f"box {i}", box, [x / 2 for x in size], centre)
    for i, (centre, radius) in enumerate(surroundings.spheres, 1):
        add(f"sphere {i}", sphere, [float(np.ravel(radius)[0]), 0.0, 0.0], centre)
