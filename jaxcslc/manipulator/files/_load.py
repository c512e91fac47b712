"""Entry of the readers: `load_robot`, and the robot that a URDF or MJCF file describes.

The part of the file's tree between base and tips becomes joints (`.._placement`). The bodies that
are fixed to each link become the link's parameters. TOML files go to `_toml`.
"""

from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple, TypeGuard, get_args

import numpy as np
from jaxtyping import Float

from jaxcslc._text_table import first_of

from .._joint import Joint, RobotError
from .._link_parameters import LinkInertia, LinkParameters, fixed_together, seen_from
from .._manipulator import JointLimits, Manipulator, Mimic, Mimics, Source
from .._placement import Axis, modified_dh
from ._mujoco_reader import WORLD, Body, BodyTree, FileJoint, read_bodies
from ._toml import read_toml
from ._urdf import (
    XACRO,
    Edit,
    check_included,
    check_urdf,
    read_xml,
    simplifications,
    urdf_limits,
    urdf_mimics,
)


_MOST_JOINTS = 1000  # loading takes a second, and the time grows with the square
_LISTED = 8  # names in a message; a humanoid has a hundred

Moved = tuple[int, FileJoint]  # a body and one of its joints
Pose = Float[np.ndarray, "4 4"]


class Part(NamedTuple):
    """The part of a file's tree that a robot is.

    **Attributes**

    - `start`: index of the body that it stands on.
    - `moved`: its joints, each with the index of the body that it moves, from the base outwards.
    - `notes`: what was taken as fixed without being asked for, a sentence each.
    - `mimics`: of the joints, those that follow others, each by one that follows none.
    """

    start: int
    moved: list[Moved]
    notes: list[str]
    mimics: tuple[Mimic, ...] = ()


def load_robot(
    path: str | Path,
    *,
    base: str | None = None,
    tip: str | Sequence[str] | None = None,
    fix: str | Sequence[str] = (),
    mimic: Mimics | None = None,
) -> Manipulator:
    """Load a robot from its description: TOML as in `docs/robots.md`, URDF, or MJCF.

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
                f"{path}: base, tip, fix and mimic apply to URDF and MJCF files only; a TOML file"
                " describes one robot"
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
    else:
        check_included(root, path)
    urdf = root.tag == "robot"
    tree = read_bodies(path, urdf=urdf, edits=edits)
    if urdf:  # MuJoCo leaves out the joints that mimic unknown ones
        laws = urdf_mimics(root, path)
        tree = tree._replace(leaders={x.follower: x.leader for x in laws}, mimics=laws)
        limits = urdf_limits(root)
    else:
        limits = {joint.name: joint.limits for joint in tree.joints}
    part = choose_part(tree, path, base, tips, fixed, mimic=mimic)
    links = _linked(tree, part)
    files = [joint for _, joint in part.moved]
    following = {law.follower for law in part.mimics}
    source = Source(
        str(path),
        "urdf" if urdf else "mjcf",
        tuple(joint.name for joint in files),
        tuple(tree.bodies[body].name for body, _ in part.moved),
        links.placements,
        links.carried,
        base,
        tips,
        fixed,
        tuple(joint.name for joint in tree.joints if joint.kind is not None and joint not in files),
        tuple(limits.get(joint.name, JointLimits()) for joint in files),
        part.mimics,
        mimic,
        (
            *(f"{path}, line {edit.line}: {edit.note}" for edit in edits if edit.note),
            *part.notes,
            *_faults(path, links.bodies),
        ),
    )
    sprung = any(joint.stiffness for joint in files)
    return Manipulator(
        name=root.attributes.get("name") or root.attributes.get("model") or path.stem,
        joints=links.joints,
        inertia=tuple(LinkInertia("full", motor=joint.name not in following) for joint in files),
        gravity=_gravity(tree, part.start),
        friction=("viscous", "dry", "spring", "offset") if sprung else ("viscous", "dry"),
        links=links.parameters,
        viscous=_unless_zero([joint.damping * (joint.name not in following) for joint in files]),
        dry=_unless_zero([joint.friction_loss * (joint.name not in following) for joint in files]),
        source=source,
    )


class _Linked(NamedTuple):
    """The links of a robot: rows, parameters, and how they lie in the file's bodies.

    - `bodies`: those that move.
    - `parameters`: None if those of one body are a mesh's, which is not read.
    - `placements`, `carried`: as of `Source`.
    """

    joints: tuple[Joint, ...]
    bodies: list[Body]
    parameters: tuple[LinkParameters, ...] | None
    placements: tuple[Pose, ...]
    carried: tuple[LinkParameters | None, ...]


def _linked(tree: BodyTree, part: Part) -> _Linked:
    """Return rows and parameters of a part's links: what each body is, and what is fixed to it."""
    moved, poses = part.moved, _poses(tree, part.start)
    last: dict[int, int] = {}  # number of the last joint on each body
    axes: list[Axis] = []
    for number, (body, joint) in enumerate(moved):
        carrier = next((last[b] for b in tree.path(body) if b in last), -1)
        last[body] = number
        rotation, origin = poses[body][:3, :3], poses[body][:3, 3]
        place = origin + rotation @ joint.anchor, rotation @ joint.axis
        axes.append(Axis(joint.kind or "R", carrier, *place, -joint.zero))
    rows, frames = modified_dh(axes)
    attached: list[list[int]] = [[] for _ in moved]  # bodies that are fixed to each link
    for i in range(len(tree.bodies)):
        if i not in last and part.start in tree.path(i):
            carrier = next((last[b] for b in tree.path(i) if b in last), None)
            if carrier is not None:
                attached[carrier].append(i)
    links: list[LinkParameters] = []
    placements: list[Pose] = []
    carried: list[LinkParameters | None] = []
    for number, (body, joint) in enumerate(moved):
        back = np.linalg.inv(frames[number])
        placements.append(back @ poses[body])
        fixed = [(tree.bodies[i].inertia, poses[i]) for i in attached[number]]
        attachments = [seen_from(x, back @ pose) for x, pose in fixed if _has_mass(x)]
        carried.append(fixed_together(attachments) if attachments else None)
        # Of several joints on a body the last carries it; the links between them have no mass.
        inertia = tree.bodies[body].inertia if last[body] == number else None
        bare = [] if inertia is None else [seen_from(inertia, placements[-1])]
        whole = fixed_together([*bare, *attachments])
        links.append(
            LinkParameters(whole.mass, whole.centre_of_gravity, whole.inertia, joint.armature)
        )
    bodies = [tree.bodies[i] for i in (*last, *(i for fixed in attached for i in fixed))]
    complete = all(body.inertia is not None for body in bodies)
    parameters = tuple(links) if complete else None
    return _Linked(rows, bodies, parameters, tuple(placements), tuple(carried))


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


UNUSED_LINKS = "no link parameters are taken from this file"
"""The end of a note on bodies that cannot exist."""


def _faults(path: Path, bodies: Sequence[Body]) -> Iterator[str]:
    """A note on the bodies that cannot exist, if there are any."""
    faulty = [body for body in bodies if body.fault]
    if faulty:
        others = f" (and {len(faulty) - 1} other bodies)" if len(faulty) > 1 else ""
        yield (f"{path}, body {faulty[0].name!r}{others}: {faulty[0].fault}; {UNUSED_LINKS}")


def _has_mass(inertia: LinkParameters | None) -> TypeGuard[LinkParameters]:
    return inertia is not None and bool(inertia.mass or np.any(inertia.inertia))


def _unless_zero(values: Sequence[float]) -> tuple[float, ...] | None:
    return tuple(values) if any(values) else None


def choose_part(
    tree: BodyTree,
    path: Path,
    base: str | None,
    tips: Sequence[str],
    fix: Sequence[str],
    *,
    mimic: str | None = None,
) -> Part:
    """The joints between `base` and `tips`, those in `fix` and floating bases apart.

    A joint that mimics a fixed one is fixed too. `mimic` says what becomes of others that mimic:
    they are an error, or fixed with what they follow (`"fix"`), or kept (`"couple"`).

    **Raises** `RobotError` for names that are not in the file, joints of kinds that are not
    modelled, joints that mimic, and closed loops.
    """
    names = [body.name for body in tree.bodies]

    def index(name: str, what: str) -> int:
        if name not in names:
            raise RobotError(
                f"{path}: {what} {name!r} is not among its bodies: {first_of(names, _LISTED)}"
            )
        return names.index(name)

    start = 0 if base is None else index(base, "base")
    ends = set(range(len(names)))
    if tips:
        ways = {tip: list(tree.path(index(tip, "tip"))) for tip in tips}
        for tip, way in ways.items():
            if start not in way:
                raise RobotError(f"{path}: base {base!r} is not between the world and tip {tip!r}")
        ends = {body for way in ways.values() for body in way}
    fixed = _fixed(tree, path, fix)
    if mimic == "fix":
        fixed |= set(tree.leaders.values())
    moved: list[Moved] = []
    notes: list[str] = []
    for body in sorted(ends & tree.carried_by(start) - {start}):
        for joint in tree.bodies[body].joints:
            if joint.name in fixed:
                continue
            if joint.type == "free" and tree.bodies[body].parent == 0:
                notes.append(f"{path}: body {names[body]!r} floats; it is taken as fixed")
            else:
                moved.append((body, joint))
    remaining = _without_followers_of_fixed(tree, path, moved)
    kept = {joint.name for _, joint in remaining}
    for _, joint in moved:
        if joint.name not in kept:
            notes.append(
                f"{path}: joint {joint.name!r} follows one that is fixed; it is fixed at zero too"
            )
    moved = remaining
    if not moved:
        part = f" between base {names[start]!r} and tip {' or '.join(map(repr, tips)) or None}"
        reasons = "; ".join(note.removeprefix(f"{path}: ") for note in notes)
        raise RobotError(
            f"{path}: has no joint{part if tips or base else ''} that moves"
            + (f" ({reasons})" if reasons else "")
        )
    if len(moved) > _MOST_JOINTS:
        raise RobotError(
            f"{path}: has {len(moved)} joints that move; expected at most {_MOST_JOINTS} (choose a"
            " part of the tree with base and tip)"
        )
    mimics = _to_independent(tree, moved) if mimic == "couple" else ()
    _only_what_is_modelled(tree, moved, path, {mimic.follower for mimic in mimics})
    return Part(start, moved, notes, mimics)


def _to_independent(tree: BodyTree, moved: Sequence[Moved]) -> tuple[Mimic, ...]:
    """The linear laws of joints that follow others, each by one that follows none."""
    joints = {joint.name for _, joint in moved}
    laws = {mimic.follower: mimic for mimic in tree.mimics if mimic.follower in joints}
    mimics: list[Mimic] = []
    for name in laws:
        leader, multiplier, offset = name, 1.0, 0.0
        while leader in laws:
            law = laws[leader]
            leader, offset = law.leader, offset + multiplier * law.offset
            multiplier *= law.multiplier
            if leader == name:
                break
        if leader in joints and leader != name:
            mimics.append(Mimic(name, leader, multiplier, offset))
    return tuple(mimics)


def _fixed(tree: BodyTree, path: Path, fix: Sequence[str]) -> set[str]:
    """Names of the joints that are to be fixed: named themselves, or on a named body or beyond."""
    fixed: set[str] = set()
    for pattern in fix:
        joints = {joint.name for joint in tree.joints if fnmatchcase(joint.name, pattern)}
        bodies = [i for i, body in enumerate(tree.bodies) if fnmatchcase(body.name, pattern)]
        if not joints and not bodies:
            raise RobotError(
                f"{path}: fix {pattern!r} matches no body and no joint; its joints are"
                f" {first_of([joint.name for joint in tree.joints], _LISTED)}"
            )
        beyond = set[int]().union(*map(tree.carried_by, bodies))
        fixed |= joints | {joint.name for i in beyond for joint in tree.bodies[i].joints}
    return fixed


def _without_followers_of_fixed(tree: BodyTree, path: Path, moved: list[Moved]) -> list[Moved]:
    """Remove joints that mimic a joint outside the robot: they do not move either."""
    everywhere = {joint.name for joint in tree.joints}
    for follower, leader in tree.leaders.items():
        unknown = {follower, leader} - everywhere - {WORLD}
        if unknown and any(follower == joint.name for _, joint in moved):
            raise RobotError(
                f"{path}: joint {follower!r} mimics {leader!r}, which is no joint of this file"
            )
    while True:
        names = {joint.name for _, joint in moved}
        remaining = [x for x in moved if tree.leaders.get(x[1].name, x[1].name) in names]
        if len(remaining) == len(moved):
            return moved
        moved = remaining


def _only_what_is_modelled(
    tree: BodyTree, moved: Sequence[Moved], path: Path, following: set[str]
) -> None:
    for _, joint in moved:
        if joint.fault:
            raise RobotError(f"{path}, joint {joint.name!r}: {joint.fault}")
        if joint.kind is None:
            raise RobotError(
                f"{path}: joint {joint.name!r} is a {joint.type} joint; only revolute and prismatic"
                " ones are modelled (fix it, or choose a part of the tree with base and tip)"
            )
    joints = {joint.name for _, joint in moved}
    bodies = {tree.bodies[body].name for body, _ in moved}
    mimics = [pair for pair in tree.leaders.items() if pair[0] in joints - following]
    if mimics:
        follower, leader = mimics[0]
        leaders = ",".join(dict.fromkeys(leader for _, leader in mimics if leader in joints))
        others = [name for name, _ in mimics[1:]]
        too = f" ({first_of(others, _LISTED)} too)" if others else ""
        raise RobotError(
            f"{path}: joint {follower!r} mimics {leader!r}{too}; expected --mimic couple, which"
            " moves them together where the law is linear, or --mimic fix (or --fix"
            f" {leaders or follower}), which fixes both"
        )
    for kind, (first, second) in tree.loops:
        if {first, second} & (bodies | joints):
            raise RobotError(
                f"{path}: {kind} between {first!r} and {second!r} closes a loop; only chains and"
                " trees are modelled"
            )
