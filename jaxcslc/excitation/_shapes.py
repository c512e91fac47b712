"""Shapes of a robot and of its surroundings, as a model of MuJoCo.

Shapes are those for collisions of the robot's file. A body without any gets capsules from its joint
to the joints and frames that it carries; the last one to twice its centre of gravity. A base
without shapes is a column from the floor up to the first joint.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from .._environment import require
from .._text_table import first_of
from ..manipulator import Manipulator, link_poses
from ._limits import Surroundings


# Radius of capsules over the length of the arm from its first joint: Panda 48 mm, UR5 64 mm, PUMA
# 560 62 mm. With the clearance, their own bodies are within it but for elbows and hands.
_SLENDERNESS = 0.055
_SAME_PLACE = 1e-6  # [m]
_THICK = 1.0  # of walls and floors [m]
_WIDE = 20.0
LISTED = 6  # names in a note
_POSES = 100  # random poses, for what is so by design

_MESH = re.compile(r"""(<mesh\b[^>]*?\bfilename\s*=\s*)(["'])(.*?)\2""")
_COLLISION = re.compile(r"<collision\b.*?</collision\s*>", re.DOTALL)
_VISUAL = re.compile(r"<visual\b.*?</visual\s*>|<visual\b[^>]*/>", re.DOTALL)
_ROOT = re.compile(r"<robot\b[^>]*>")
_COMPILER = (
    '<mujoco><compiler strippath="false" fusestatic="false" discardvisual="false"/></mujoco>'
)
# What would hinder compiling, and moves no body.
_UNNEEDED = (
    *("equalities", "actuators", "sensors", "keys", "excludes", "pairs", "tendons", "tuples"),
    *("skins", "flexes"),
)
_READ = (".stl", ".obj", ".msh")


class Geometry(NamedTuple):
    """A robot's shapes and obstacles.

    **Attributes**

    - `model`: MuJoCo's, whose bodies are the robot's and whose world holds the obstacles.
    - `joints`: (n,) indices of the robot's joints in the model.
    - `floor`: words for the floor; empty without one.
    - `notes`: sentences on the shapes.
    """

    model: Any
    joints: np.ndarray
    floor: str
    notes: tuple[str, ...]


def compiled_geometry(robot: Manipulator, surroundings: Surroundings) -> Geometry:
    """Return a model of a robot's shapes and of obstacles.

    Obstacles are in the frame of the file's root, or in frame 0 of robots from tables.

    **Raises**

    - `ValueError`: a wrong number of radii, shapes that MuJoCo cannot compile.
    - `RobotError`: a length without value.
    - `MissingExtraError`: without MuJoCo.
    """
    mujoco: Any = require("mujoco", "urdf")
    source = robot.source
    of_file = source is not None and source.format != "toml" and surroundings.radius is None
    notes: list[str] = []
    spec: Any = None
    model: Any = None
    names: Sequence[str] = [f"joint {i + 1}" for i in range(robot.joint_count)]
    placements: Sequence[np.ndarray] = [np.eye(4)] * robot.joint_count
    if source is not None and of_file:
        try:
            spec = _spec_of_file(Path(source.path), source.format == "urdf", notes)
            model = _compiled(spec)
            names, placements = source.joints, source.placements
        except ValueError as error:
            text = " ".join(str(error).split()).removeprefix("Error: ")
            notes = [f"shapes of the robot's file cannot be read: {text}"]
    if model is None:
        spec = _spec_of_rows(mujoco, robot)
        model = _compiled(spec)
    joints = np.array([int(model.joint(name).id) for name in names], int)
    base = _base(mujoco, model, joints)
    floor, hanging, words = surroundings.floor, False, ""
    if floor == "base":
        floor, hanging = None if base.has_plane else base.height, base.hanging
        words = " (the base's foot)"
    if floor is not None:
        words = f"{'a ceiling' if hanging else 'a floor'} at z = {floor:.4g} m{words}"
    else:
        words = "the floor of the robot's file" * base.has_plane
    centres = [
        (np.linalg.inv(placement) @ [*link.centre_of_gravity, 1.0])[:3]
        for placement, link in zip(placements, robot.links or (), strict=False)
    ]
    skeleton = _Skeleton.of(model, joints, centres, floor)
    radii = skeleton.radii(surroundings.radius)
    notes += skeleton.add_capsules(spec, radii)
    _add_obstacles(spec, surroundings, floor, hanging=hanging)
    return Geometry(_compiled(spec), joints, words, tuple(notes))


def random_poses(model: Any, joints: np.ndarray) -> Float[np.ndarray, "poses joints"]:
    """Return random poses within the ranges of a model's joints; one turn where there is none."""
    low, high = model.jnt_range[joints].T
    free = low >= high
    low, high = np.where(free, -np.pi, low), np.where(free, np.pi, high)
    return np.random.default_rng(0).uniform(low, high, (_POSES, len(joints)))


def _compiled(spec: Any) -> Any:
    for body in spec.bodies[1:]:
        # Masses do not matter here, and MuJoCo compiles no moving body without.
        body.mass, body.inertia, body.explicitinertial = 1.0, np.ones(3), True
        body.ipos, body.fullinertia = np.zeros(3), [np.nan, 0, 0, 0, 0, 0]
    return spec.compile()


def _spec_of_file(path: Path, urdf: bool, notes: list[str]) -> Any:
    """Return a file's shapes for collisions, and add notes on those that cannot be read."""
    mujoco: Any = require("mujoco", "urdf")
    if urdf:
        unread: dict[str, list[str]] = {}
        text = _VISUAL.sub("", path.read_text(encoding="utf-8"))
        text = _COLLISION.sub(lambda match: _readable(match[0], path, unread), text)
        spec = mujoco.MjSpec.from_string(_ROOT.sub(lambda x: x[0] + _COMPILER, text, count=1))
        for why, meshes in unread.items():
            distinct = list(dict.fromkeys(meshes))
            notes.append(f"meshes that {why}: {first_of(distinct, 2)}")
    else:
        spec = mujoco.MjSpec.from_file(str(path))
        for geom in list(spec.geoms):
            if not (geom.contype or geom.conaffinity):  # it is to be seen only
                spec.delete(geom)
    for kind in _UNNEEDED:
        for element in list(getattr(spec, kind)):
            spec.delete(element)
    return spec


def _readable(shape: str, urdf: Path, unread: dict[str, list[str]]) -> str:
    """Return a URDF's shape with the path of its mesh, or nothing where that cannot be read.

    Packages of ROS are looked for in folders above the URDF.
    """
    match = _MESH.search(shape)
    if match is None:
        return shape
    name = match[3]
    relative = name.removeprefix("file://").removeprefix("package://")
    candidates = [Path(relative), urdf.parent / relative]
    if name.startswith("package://"):
        without_package = Path(*Path(relative).parts[1:])
        for folder in urdf.resolve().parents:
            candidates += [folder / relative, folder / without_package]
    file = next((path for path in candidates if path.is_file()), None)
    if file is None:
        unread.setdefault("were not found in a folder above the URDF", []).append(name)
        return ""
    if file.suffix.lower() not in _READ:
        why = f"cannot be read (only {', '.join(_READ)})"
        unread.setdefault(why, []).append(file.name)
        return ""
    return _MESH.sub(lambda _: f"{match[1]}{match[2]}{file.resolve()}{match[2]}", shape)


def _spec_of_rows(mujoco: Any, robot: Manipulator) -> Any:
    """Return a robot's links as bodies without shapes, in the frames of its table."""
    spec = mujoco.MjSpec()
    bodies: list[Any] = []
    poses = link_poses(robot, np.zeros(robot.joint_count))
    for i, (joint, parent) in enumerate(zip(robot.joints, robot.parents, strict=True)):
        carrier = spec.worldbody if parent < 0 else bodies[parent]
        pose = poses[i] if parent < 0 else np.linalg.inv(poses[parent]) @ poses[i]
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, pose[:3, :3].ravel())
        body = carrier.add_body(name=f"link {i + 1}", pos=pose[:3, 3], quat=quaternion)
        kinds = mujoco.mjtJoint
        body.add_joint(
            name=f"joint {i + 1}",
            type=kinds.mjJNT_HINGE if joint.kind == "R" else kinds.mjJNT_SLIDE,
            axis=[0, 0, 1],
        )
        bodies.append(body)
    return spec


class _Base(NamedTuple):
    """Floor that a robot stands on.

    - `height`: of the base's foot [m]: where its shapes end, or 0 without shapes.
    - `hanging`: True if the moving bodies are below the base.
    - `has_plane`: True if the file has a floor.
    """

    height: float
    hanging: bool
    has_plane: bool


def _base(mujoco: Any, model: Any, joints: np.ndarray) -> _Base:
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    of_base = model.body_weldid[model.geom_bodyid] == 0
    planes = model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)
    ends = [0.0, 0.0]
    if (solid := np.flatnonzero(of_base & ~planes)).size:
        upwards = data.geom_xmat[solid, 6:]
        middle = data.geom_xpos[solid, 2] + np.sum(upwards * model.geom_aabb[solid, :3], 1)
        half = np.sum(np.abs(upwards) * model.geom_aabb[solid, 3:], 1)
        ends = [float((middle - half).min()), float((middle + half).max())]
    moving = model.body_weldid != 0
    heights: list[float] = []
    for pose in random_poses(model, joints):
        data.qpos[model.jnt_qposadr[joints]] = pose
        mujoco.mj_kinematics(model, data)
        heights.append(float(data.xpos[moving, 2].mean()))
    hanging = bool(np.mean(heights) < ends[0] - _SAME_PLACE)
    return _Base(ends[hanging], hanging, bool(np.any(of_base & planes)))


class _Skeleton(NamedTuple):
    """Lines along an arm at zero, where its joints are, and what has no shapes.

    - `data`: MuJoCo's.
    - `joints`: (n,) indices in the model.
    - `lines`: of each body without shapes, by the number of the joint that moves it, pairs of
      points (start, end) in space [m].
    - `column`: such lines of a base without shapes, from the floor to the first joints.
    - `length`: of the arm, from the first joint to the last [m].
    """

    data: Any
    joints: np.ndarray
    lines: dict[int, list[tuple[np.ndarray, np.ndarray]]]
    column: list[tuple[np.ndarray, np.ndarray]]
    length: float

    @classmethod
    def of(
        cls, model: Any, joints: np.ndarray, centres: Sequence[np.ndarray], floor: float | None
    ) -> "_Skeleton":
        """Make the skeleton of a model.

        - `centres`: of gravity of the bodies that joints move, in the bodies' frames [m], if known.
        - `floor`: its height [m]; None without one.
        """
        mujoco: Any = require("mujoco", "urdf")
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        weld, anchors = model.body_weldid, data.xanchor
        carriers = weld[model.body_parentid[model.jnt_bodyid]]  # of all joints
        shaped = set(weld[model.geom_bodyid].tolist())
        moved = model.jnt_bodyid[joints].tolist()
        last = {body: i for i, body in enumerate(moved)}
        reach = np.zeros(len(joints))
        lines: dict[int, list[tuple[np.ndarray, np.ndarray]]] = {}
        column: list[tuple[np.ndarray, np.ndarray]] = []
        for i, (joint, body) in enumerate(zip(joints, moved, strict=True)):
            start, before = anchors[joint], last.get(int(carriers[joint]))
            foot = np.array([*start[:2], start[2] if floor is None else floor])
            if before is not None:
                reach[i] = reach[before] + np.linalg.norm(start - anchors[joints[before]])
            if before is None and 0 not in shaped and np.any(foot != start):
                column.append((foot, start))
            if body in shaped or last[body] != i:
                continue
            fixed = (weld == body) & (np.arange(model.nbody) != body)
            ends = [*anchors[carriers == body], *data.xpos[fixed]]
            if not ends and centres:
                centre = data.xpos[body] + data.xmat[body].reshape(3, 3) @ centres[i]
                ends = [2 * centre - start]
            apart = [end for end in ends if np.linalg.norm(end - start) > _SAME_PLACE]
            lines[i] = [(start, end) for end in apart or [start]]
        return cls(data, joints, lines, column, float(reach.max()))

    def radii(self, stated: float | tuple[float, ...] | None) -> Float[np.ndarray, " joints"]:
        """Return radii of capsules per joint [m]: stated, else by the length of the arm.

        **Raises** `ValueError` for another number of radii.
        """
        n = len(self.joints)
        usual = _SLENDERNESS * (self.length or 1.0)
        radii = np.atleast_1d(np.asarray(usual if stated is None else stated, float))
        if len(radii) not in (1, n) or not np.all(radii > 0):
            raise ValueError(
                f"surroundings, radius: expected one number above 0 or {n}, got {stated}"
            )
        return np.broadcast_to(radii, (n,))

    def add_capsules(self, spec: Any, radii: Float[np.ndarray, " joints"]) -> list[str]:
        """Give capsules to bodies without shapes, balls where they have no length.

        **Returns** a note on them.
        """
        mujoco: Any = require("mujoco", "urdf")
        model, data = self.data.model, self.data
        bodies = {i: int(model.jnt_bodyid[self.joints[i]]) for i in self.lines}
        wanted = [(bodies[i], radii[i], lines) for i, lines in self.lines.items()]
        for body, radius, lines in [*wanted, (0, radii[0], self.column)]:
            back = data.xmat[body].reshape(3, 3).T
            for line in lines:
                start, end = (back @ (point - data.xpos[body]) for point in line)
                size, kinds = [radius, 0.0, 0.0], mujoco.mjtGeom
                if np.any(start != end):
                    fromto = [*start, *end]
                    spec.bodies[body].add_geom(type=kinds.mjGEOM_CAPSULE, size=size, fromto=fromto)
                else:
                    spec.bodies[body].add_geom(type=kinds.mjGEOM_SPHERE, size=size, pos=start)
        if not bodies:
            return []
        used = sorted({float(f"{1e3 * radii[i]:.3g}") for i in bodies})
        sizes = f"{used[0]:g} to {used[-1]:g}" if len(used) > 1 else f"{used[0]:g}"
        names = [model.body(body).name for body in bodies.values()]
        whole = len(names) == len(set(model.jnt_bodyid[self.joints].tolist()))
        which = "all links" if whole else first_of(names, LISTED)
        return [f"capsules of {sizes} mm radius stand for {which}, for which there are no shapes"]


def _add_obstacles(
    spec: Any, surroundings: Surroundings, floor: float | None, *, hanging: bool
) -> None:
    mujoco: Any = require("mujoco", "urdf")
    box, sphere = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_SPHERE

    def add(name: str, kind: Any, size: Sequence[float], centre: Sequence[float]) -> None:
        spec.worldbody.add_geom(name=f"obstacle {name}", type=kind, size=size, pos=centre)

    def wall(name: str, axis: int, at: float, sign: int) -> None:
        """Add everything beyond a plane, as a thick box."""
        size, centre = [_WIDE] * 3, [0.0] * 3
        size[axis], centre[axis] = _THICK, at + sign * _THICK
        add(name, box, size, centre)

    if floor is not None:
        wall("ceiling" if hanging else "floor", 2, floor, 1 if hanging else -1)
    if surroundings.workspace is not None:
        low, high = surroundings.workspace
        for axis, letter in enumerate("xyz"):
            wall(f"workspace -{letter}", axis, low[axis], -1)
            wall(f"workspace +{letter}", axis, high[axis], 1)
    for i, (centre, size) in enumerate(surroundings.boxes, 1):
        add(f"box {i}", box, [x / 2 for x in size], centre)
    for i, (centre, radius) in enumerate(surroundings.spheres, 1):
        add(f"sphere {i}", sphere, [float(np.ravel(radius)[0]), 0.0, 0.0], centre)
