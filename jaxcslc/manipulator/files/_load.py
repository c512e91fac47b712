"""Entry of the readers: `load_robot`, and the robot that a URDF or MJCF file describes.

The chosen part of the file's tree becomes joints (`.._placement`). The bodies that are fixed to
each link become the link's parameters. TOML files go to `_toml`.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeGuard, get_args

import numpy as np
from jaxtyping import Float

from .._errors import RobotError
from .._link_parameters import LinkInertia, LinkParameters, fixed_together, seen_from
from .._manipulator import Manipulator
from .._placement import Axis, modified_dh
from .._source import JointLimits, Mimics, Source
from ._mujoco_reader import Body, BodyTree, read_bodies
from ._part import MIMIC, Moved, Part, part_of
from ._toml import read_toml
from ._urdf import (
    XACRO,
    Edit,
    check_urdf,
    simplifications,
    urdf_limits,
    urdf_mimic_laws,
    urdf_mimics,
)
from ._xml import read_xml


Pose = Float[np.ndarray, "4 4"]


def load_robot(
    path: str | Path,
    *,
    base: str | None = None,
    tip: str | Sequence[str] | None = None,
    fix: str | Sequence[str] = (),
    mimic: Mimics | None = None,
) -> Manipulator:
    """A robot from its description: TOML as in `docs/robots.md`, URDF, or MJCF.

    URDF and MJCF are read by MuJoCo; meshes are not read. Chains and trees of revolute and
    prismatic joints with any axes become modified Denavit-Hartenberg rows; bodies that are fixed
    together become one link. `robot.links` holds what the file says of the links, None if that is
    impossible; `viscous` and `dry` damping and friction loss, where it has any; `robot.source` how
    the robot's frames lie in the file's bodies; `robot.notes` what was not taken as it stands.
    Joints of URDF and MJCF count from the base outwards, in the order of the file. Angles within
    1e-5 rad of a multiple of 90° are taken as that: files round.

    **Arguments**

    - `path`: a `.toml`, `.urdf`, `.xml` or `.mjcf` file.
    - `base`, `tip`: bodies (links, in URDF) between which the robot is; by default the whole
      tree. Several tips, as of two arms, make a tree. Joints elsewhere are fixed at zero, and what
      they carry is part of the link.
    - `fix`: names of joints to fix at zero, or of bodies, for all joints that move the body and
      what it carries, as in `"gripper"`; `*` stands for any letters. Joints that mimic a fixed
      one are fixed too, and so is the base of a robot that floats.
    - `mimic`: what becomes of joints that mimic others that move, which are an error otherwise.
      `"fix"` fixes them and what they follow at zero. `"couple"` keeps them, without motors and
      friction of their own: `robot.source.mimics` says what they follow, and the robot's network
      has motion and torque of the others, `robot.independent_joints`.

    **Raises**

    - `RobotError`: one line that names the file, the joint or body, and what was expected: for ball
      and free joints, closed loops and joints that mimic others, where they are part of the robot.
    - `MissingExtraError`: for URDF and MJCF, without MuJoCo (the extra `urdf`).

    >>> import tempfile
    >>> arm = '''<robot name="arm"> <link name="floor"/> <link name="bar"> <inertial>
    ...   <origin xyz="0.5 0 0"/> <mass value="2"/>
    ...   <inertia ixx="0.1" iyy="0.2" izz="0.2" ixy="0" ixz="0" iyz="0"/> </inertial> </link>
    ... <joint name="hinge" type="continuous"> <parent link="floor"/> <child link="bar"/>
    ...   <axis xyz="0 1 0"/> </joint> </robot>'''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "arm.urdf"
    ...     _ = path.write_text(arm)
    ...     robot = load_robot(path)
    >>> robot.kinds, robot.source.joints, float(robot.links[0].mass)
    ('R', ('hinge',), 2.0)
    """
    if mimic is not None and mimic not in get_args(Mimics):
        raise ValueError(f"mimic: expected {' or '.join(get_args(Mimics))}, got {mimic!r}")
    path = Path(path)
    suffix = path.suffix.lower()
    tips = (tip,) if isinstance(tip, str) else tuple(tip or ())
    fixed = (fix,) if isinstance(fix, str) else tuple(fix)
    if suffix == ".toml":
        if base is not None or tips or fixed or mimic:
            raise RobotError(
                f"{path}: base, tip, fix and mimic are of URDF and MJCF files; TOML has one robot"
            )
        return read_toml(path)
    if suffix == ".xacro":
        raise RobotError(f"{path}: {XACRO}")
    if suffix not in (".urdf", ".xml", ".mjcf"):
        raise RobotError(f"{path}: expected a robot file ending in .toml, .urdf or .xml")
    root = read_xml(path)
    edits: list[Edit] = []
    if root.tag == "robot":
        check_urdf(root, path)
        edits = simplifications(root)
    elif root.tag != "mujoco":
        raise RobotError(
            f"{path}: expected <robot> (URDF) or <mujoco> (MJCF) at the top, got <{root.tag}>"
        )
    urdf = root.tag == "robot"
    tree = read_bodies(path, urdf=urdf, edits=edits)
    if urdf:  # MuJoCo leaves out the joints that mimic unknown ones
        constraints = tuple((MIMIC, pair) for pair in urdf_mimics(root, path))
        laws = tuple(urdf_mimic_laws(root, path)) if mimic == "couple" else ()
        tree = tree._replace(constraints=constraints, mimics=laws)
    name = root.attributes.get("name") or root.attributes.get("model") or path.stem
    notes = [f"{path}, line {edit.line}: {edit.note}" for edit in edits if edit.note]
    part = part_of(tree, path, base, tips, fixed, mimic=mimic)
    robot = _robot(tree, path, name, base, tips, fixed, mimic, notes, part, urdf=urdf)
    if not urdf or robot.source is None:
        return robot
    limits = urdf_limits(root)
    listed = tuple(limits.get(joint, JointLimits()) for joint in robot.source.joints)
    return dataclasses.replace(robot, source=dataclasses.replace(robot.source, limits=listed))


def _robot(
    tree: BodyTree,
    path: Path,
    name: str,
    base: str | None,
    tips: tuple[str, ...],
    fix: tuple[str, ...],
    mimic: Mimics | None,
    notes: Sequence[str],
    part: Part,
    *,
    urdf: bool,
) -> Manipulator:
    start, moved = part.start, part.moved
    poses = _poses(tree, start)
    numbers: dict[int, int] = {}  # of the last joint on each body
    axes: list[Axis] = []
    for number, (body, joint) in enumerate(moved):
        carrier = numbers.get(body, -2)
        if carrier == -2:
            carrier = next((numbers[b] for b in tree.path(body) if b in numbers), -1)
        numbers[body] = number
        rotation, origin = poses[body][:3, :3], poses[body][:3, 3]
        axes.append(
            Axis(
                joint.kind or "R",
                carrier,
                origin + rotation @ joint.anchor,
                rotation @ joint.axis,
                -joint.zero,
            )
        )
    rows, frames = modified_dh(axes)
    attached = _attached(tree, start, numbers)
    links, placements, carried = _links(tree, moved, numbers, attached, poses, frames)
    files = [joint for _, joint in moved]
    friction = ("viscous", "dry")
    following = {law.follower for law in part.mimics}
    if any(joint.stiffness for joint in files):
        friction = (*friction, "spring", "offset")
    return Manipulator(
        name=name,
        joints=rows,
        inertia=tuple(LinkInertia("full", motor=joint.name not in following) for joint in files),
        gravity=_gravity(tree, start),
        friction=friction,
        links=links,
        viscous=_unless_zero([joint.damping * (joint.name not in following) for joint in files]),
        dry=_unless_zero([joint.friction_loss * (joint.name not in following) for joint in files]),
        source=Source(
            str(path),
            "urdf" if urdf else "mjcf",
            tuple(joint.name for joint in files),
            tuple(tree.bodies[body].name for body, _ in moved),
            placements,
            carried,
            base,
            tips,
            fix,
            tuple(
                joint.name
                for body in tree.bodies
                for joint in body.joints
                if joint.kind is not None and joint not in files
            ),
            mimics=part.mimics,
            mimic=mimic,
            limits=() if urdf else tuple(joint.limits for joint in files),
            notes=(*notes, *part.notes, *_faults(tree, path, numbers, attached)),
        ),
    )


def _poses(tree: BodyTree, start: int) -> list[Pose]:
    """Return the pose of every body's frame in the base's frame, at joint position zero."""
    world: list[Pose] = []
    for body in tree.bodies:
        world.append(world[body.parent] @ body.pose if body.parent >= 0 else body.pose)
    back = np.linalg.inv(world[start])
    return [back @ pose for pose in world]


def _gravity(tree: BodyTree, start: int) -> tuple[float, float, float]:
    rotation = np.eye(3)
    for body in tree.path(start):
        rotation = tree.bodies[body].pose[:3, :3] @ rotation
    # Rounding of rotations would make a component of what is none, and a symbol of it.
    x, y, z = (float(g) for g in np.round(rotation.T @ np.array(tree.gravity), 12) + 0.0)
    return x, y, z


def _attached(tree: BodyTree, start: int, numbers: Mapping[int, int]) -> dict[int, list[int]]:
    """Bodies that are fixed to each link, or fixed at zero on it."""
    attached: dict[int, list[int]] = {number: [] for number in range(max(numbers.values()) + 1)}
    for i in range(len(tree.bodies)):
        if i not in numbers and start in tree.path(i):
            for carrier in tree.path(i):
                if carrier in numbers:
                    attached[numbers[carrier]].append(i)
                    break
    return attached


def _links(
    tree: BodyTree,
    moved: Sequence[Moved],
    numbers: Mapping[int, int],
    attached: Mapping[int, Sequence[int]],
    poses: Sequence[Pose],
    frames: Sequence[Pose],
) -> tuple[tuple[LinkParameters, ...] | None, tuple[Pose, ...], tuple[LinkParameters | None, ...]]:
    """Parameters of every link in its frame, poses of the bodies' frames, and what is fixed to it.

    No parameters at all if those of one body are a mesh's, which is not read.
    """
    complete = all(body.inertia is not None for body in _bodies(tree, numbers, attached))
    links: list[LinkParameters] = []
    placements: list[Pose] = []
    carried: list[LinkParameters | None] = []
    for number, (body, joint) in enumerate(moved):
        back = np.linalg.inv(frames[number])
        placements.append(back @ poses[body])
        # Of several joints on a body the last carries it; the links between them have no mass.
        fixed = [(tree.bodies[i].inertia, poses[i]) for i in attached[number]]
        attachments = [seen_from(x, back @ pose) for x, pose in fixed if _has_mass(x)]
        carried.append(fixed_together(attachments) if attachments else None)
        inertia = tree.bodies[body].inertia if numbers[body] == number else None
        bare = [] if inertia is None else [seen_from(inertia, placements[-1])]
        whole = fixed_together([*bare, *attachments])
        links.append(
            LinkParameters(whole.mass, whole.centre_of_gravity, whole.inertia, joint.armature)
        )
    return tuple(links) if complete else None, tuple(placements), tuple(carried)


def _bodies(
    tree: BodyTree, numbers: Mapping[int, int], attached: Mapping[int, Sequence[int]]
) -> Iterator[Body]:
    for body in [*numbers, *(i for bodies in attached.values() for i in bodies)]:
        yield tree.bodies[body]


def _faults(
    tree: BodyTree, path: Path, numbers: Mapping[int, int], attached: Mapping[int, Sequence[int]]
) -> Iterator[str]:
    """A note on the bodies that cannot exist, if there are any."""
    faulty = [body for body in _bodies(tree, numbers, attached) if body.fault]
    if faulty:
        others = f" (and {len(faulty) - 1} other bodies)" if len(faulty) > 1 else ""
        yield (
            f"{path}, body {faulty[0].name!r}{others}: {faulty[0].fault}; no link parameters are"
            " taken from this file"
        )


def _has_mass(inertia: LinkParameters | None) -> TypeGuard[LinkParameters]:
    return inertia is not None and bool(inertia.mass or np.any(inertia.inertia))


def _unless_zero(values: Sequence[float]) -> tuple[float, ...] | None:
    return tuple(values) if any(values) else None
