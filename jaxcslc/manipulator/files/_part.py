"""Choice of the part of a file's tree that the robot is: base, tips, fixed and following joints."""

from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple

from .._errors import RobotError
from .._source import Mimic
from ._mujoco_reader import WORLD, BodyTree, FileJoint


_MOST_JOINTS = 1000  # loading takes a second, and the time grows with the square
_LISTED = 8  # names in a message; a humanoid has a hundred

MIMIC = "equality of kind 'joint'"  # the first joint follows the second, or is held if alone
Moved = tuple[int, FileJoint]  # a body and one of its joints


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


def part_of(
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

    **Raises**

    - `RobotError`: for names that are not in the file, joints of kinds that are not modelled,
      joints that mimic, and closed loops.
    """
    names = [body.name for body in tree.bodies]

    def index(name: str, what: str) -> int:
        if name not in names:
            raise RobotError(f"{path}: {what} {name!r} is not among its bodies: {_some(names)}")
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
        fixed |= {leader for _, (_, leader) in _mimics(tree)}
    below = _carried_by(tree, start)
    moved: list[Moved] = []
    notes: list[str] = []
    for body in sorted(ends & below - {start}):
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


def _carried_by(tree: BodyTree, start: int) -> set[int]:
    """A body and all that it carries; parents come first in a tree."""
    below = {start}
    for index, body in enumerate(tree.bodies):
        if body.parent in below:
            below.add(index)
    return below


def _fixed(tree: BodyTree, path: Path, fix: Sequence[str]) -> set[str]:
    """Names of the joints that are to be fixed: named themselves, or on a named body or beyond."""
    fixed: set[str] = set()
    for pattern in fix:
        joints = {
            joint.name
            for body in tree.bodies
            for joint in body.joints
            if fnmatchcase(joint.name, pattern)
        }
        bodies = [i for i, body in enumerate(tree.bodies) if fnmatchcase(body.name, pattern)]
        if not joints and not bodies:
            movable = [joint.name for body in tree.bodies for joint in body.joints]
            raise RobotError(
                f"{path}: fix {pattern!r} is none of its bodies and none of its joints:"
                f" {_some(movable)}"
            )
        for body in bodies:
            beyond = _carried_by(tree, body)
            joints |= {joint.name for i in beyond for joint in tree.bodies[i].joints}
        fixed |= joints
    return fixed


def _without_followers_of_fixed(tree: BodyTree, path: Path, moved: list[Moved]) -> list[Moved]:
    """Remove joints that mimic a joint outside the robot: they do not move either."""
    leaders = {follower: leader for _, (follower, leader) in _mimics(tree)}
    everywhere = {joint.name for body in tree.bodies for joint in body.joints}
    for follower, leader in leaders.items():
        unknown = {follower, leader} - everywhere - {WORLD}
        if unknown and any(follower == joint.name for _, joint in moved):
            raise RobotError(
                f"{path}: joint {follower!r} mimics {leader!r}, which is no joint of this file"
            )
    while True:
        names = {joint.name for _, joint in moved}
        remaining = [
            (body, joint) for body, joint in moved if leaders.get(joint.name, joint.name) in names
        ]
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
    mimics = [pair for _, pair in _mimics(tree) if pair[0] in joints - following]
    if mimics:
        follower, leader = mimics[0]
        leaders = ",".join(dict.fromkeys(leader for _, leader in mimics if leader in joints))
        others = [name for name, _ in mimics[1:]]
        too = f" ({_some(others)} too)" if others else ""
        raise RobotError(
            f"{path}: joint {follower!r} mimics {leader!r}{too}; expected --mimic couple, which"
            " moves them together where the law is linear, or --mimic fix (or --fix"
            f" {leaders or follower}), which fixes both"
        )
    for kind, (first, second) in tree.constraints:
        if kind != MIMIC and {first, second} & (bodies | joints):
            raise RobotError(
                f"{path}: {kind} between {first!r} and {second!r} closes a loop; only chains and"
                " trees are modelled"
            )


def _mimics(tree: BodyTree) -> list[tuple[str, tuple[str, str]]]:
    return [constraint for constraint in tree.constraints if constraint[0] == MIMIC]


def _some(names: Sequence[str]) -> str:
    listed = ", ".join(names[:_LISTED])
    return listed if len(names) <= _LISTED else f"{listed} and {len(names) - _LISTED} others"
