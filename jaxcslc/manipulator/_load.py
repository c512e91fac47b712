import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeGuard

import numpy as np
from jaxtyping import Float

from ._errors import RobotError
from ._inertia import LinkInertia
from ._link_parameters import LinkParameters, fixed_together, seen_from
from ._manipulator import Manipulator
from ._mujoco_reader import Body, BodyTree, FileJoint, read_bodies
from ._placement import Axis, modified_dh
from ._source import JointLimits, Source
from ._toml import read_toml
from ._urdf_checks import check_urdf, urdf_limits
from ._xml import read_xml


Pose = Float[np.ndarray, "4 4"]
Moved = tuple[int, FileJoint]  # a body and one of its joints


def load_robot(path: str | Path, *, base: str | None = None, tip: str | None = None) -> Manipulator:
    """A robot from its description: TOML as in `docs/robots.md`, URDF, or MJCF.

    URDF and MJCF are read by MuJoCo; meshes are not read. Chains and trees of revolute and
    prismatic joints with any axes become modified Denavit-Hartenberg rows; bodies that are fixed
    together become one link. `robot.links` holds what the file says of the links, `viscous` and
    `dry` damping and friction loss, where it has any, and `robot.source` how the robot's frames
    lie in the file's bodies. Joints of URDF and MJCF count from the base outwards, in the order of
    the file. Angles within 1e-5 rad of a multiple of 90° are taken as that: files round.

    **Arguments**

    - `path`: a `.toml`, `.urdf`, `.xml` or `.mjcf` file.
    - `base`, `tip`: bodies (links, in URDF) between which the robot is; by default the whole
      tree. Joints elsewhere are fixed at zero, and what they carry is part of the link.

    **Raises**

    - `RobotError`: one line that names the file, the joint or body, and what was expected: for ball
      and free joints, closed loops, joints that mimic others and inertias that no body has, where
      they are part of the robot.
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
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".toml":
        if base is not None or tip is not None:
            raise RobotError(f"{path}: base and tip are of URDF and MJCF files; TOML has one robot")
        return read_toml(path)
    if suffix not in (".urdf", ".xml", ".mjcf"):
        raise RobotError(f"{path}: expected a robot file ending in .toml, .urdf or .xml")
    root = read_xml(path)
    if root.tag == "robot":
        check_urdf(root, path)
    elif root.tag != "mujoco":
        raise RobotError(
            f"{path}: expected <robot> (URDF) or <mujoco> (MJCF) at the top, got <{root.tag}>"
        )
    urdf = root.tag == "robot"
    tree = read_bodies(path, urdf=urdf)
    name = root.attributes.get("name") or root.attributes.get("model") or path.stem
    robot = _robot(tree, path, name, base, tip, urdf=urdf)
    if not urdf or robot.source is None:
        return robot
    limits = urdf_limits(root)
    listed = tuple(limits.get(joint, JointLimits()) for joint in robot.source.joints)
    return dataclasses.replace(robot, source=dataclasses.replace(robot.source, limits=listed))


def _robot(
    tree: BodyTree, path: Path, name: str, base: str | None, tip: str | None, *, urdf: bool
) -> Manipulator:
    start, moved = _moving(tree, path, base, tip)
    _only_what_is_represented(tree, moved, path)
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
    for body in _bodies(tree, numbers, attached):
        if body.fault:
            raise RobotError(f"{path}, body {body.name!r}: {body.fault}")
    links, placements, carried = _links(tree, moved, numbers, attached, poses, frames)
    files = [joint for _, joint in moved]
    friction = ("viscous", "dry")
    if any(joint.stiffness for joint in files):
        friction = (*friction, "spring", "offset")
    return Manipulator(
        name=name,
        joints=rows,
        inertia=tuple(LinkInertia("full") for _ in rows),
        gravity=_gravity(tree, start),
        friction=friction,
        links=links,
        viscous=_unless_zero([joint.damping for joint in files]),
        dry=_unless_zero([joint.friction_loss for joint in files]),
        source=Source(
            str(path),
            "urdf" if urdf else "mjcf",
            tuple(joint.name for joint in files),
            tuple(tree.bodies[body].name for body, _ in moved),
            placements,
            carried,
            base,
            tip,
        ),
    )


def _moving(
    tree: BodyTree, path: Path, base: str | None, tip: str | None
) -> tuple[int, list[Moved]]:
    """The body that is the robot's base, and the robot's joints, in order."""
    names = [body.name for body in tree.bodies]

    def index(name: str, what: str) -> int:
        if name not in names:
            raise RobotError(f"{path}: {what} {name!r} is not among its bodies: {', '.join(names)}")
        return names.index(name)

    start = 0 if base is None else index(base, "base")
    ends = range(len(names)) if tip is None else list(tree.path(index(tip, "tip")))
    if tip is not None and start not in ends:
        raise RobotError(f"{path}: base {base!r} is not between the world and tip {tip!r}")
    moved = [
        (body, joint)
        for body in sorted(ends)
        if body != start and start in tree.path(body)
        for joint in tree.bodies[body].joints
    ]
    if not moved:
        part = f" between base {names[start]!r} and tip {tip!r}" if tip or base else ""
        raise RobotError(f"{path}: has no joint{part} that moves")
    return start, moved


def _only_what_is_represented(tree: BodyTree, moved: Sequence[Moved], path: Path) -> None:
    for _, joint in moved:
        if joint.fault:
            raise RobotError(f"{path}, joint {joint.name!r}: {joint.fault}")
        if joint.kind is None:
            raise RobotError(
                f"{path}: joint {joint.name!r} is a {joint.type} joint; only revolute and prismatic"
                " ones are modelled (choose a part of the tree with base and tip)"
            )
    joints = {joint.name for _, joint in moved}
    bodies = {tree.bodies[body].name for body, _ in moved}
    for kind, (first, second) in tree.constraints:
        if kind.endswith("'joint'"):
            if first in joints:
                raise RobotError(
                    f"{path}: joint {first!r} mimics {second!r}; joints that follow others are not"
                    " modelled (choose a part of the tree with base and tip)"
                )
        elif {first, second} & (bodies | joints):
            raise RobotError(
                f"{path}: {kind} between {first!r} and {second!r} closes a loop; only chains and"
                " trees are modelled"
            )


def _poses(tree: BodyTree, start: int) -> list[Pose]:
    """Of every body's frame in the base's, at zero."""
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


def _has_mass(inertia: LinkParameters | None) -> TypeGuard[LinkParameters]:
    return inertia is not None and bool(inertia.mass or np.any(inertia.inertia))


def _unless_zero(values: Sequence[float]) -> tuple[float, ...] | None:
    return tuple(values) if any(values) else None
