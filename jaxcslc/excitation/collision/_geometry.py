"""Collision shapes of a robot and obstacles, as a MuJoCo model.

Shapes come from the robot's URDF or MJCF file, or are capsules along its links.
"""

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxcslc._environment import require
from jaxcslc.manipulator import Manipulator

from .._limits import Surroundings


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
    """A MuJoCo model of a robot's shapes and of obstacles, and where its joints' positions are.

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
    columns = np.array([int(model.joint(name).qposadr[0]) for name in names], int)
    return model, columns


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
    """A mesh's file name, packages of ROS looked for in the folders above the URDF."""
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
    """Links as capsules between the origins of their frames."""
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
    """The pose of a joint's frame in its parent's at the zero position."""

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
