"""XML robot files: a reader that trusts nothing, and what MuJoCo does not do for URDF.

No document types, no entities, bounded size. Of URDF: checks of the tree, joint limits, laws of
joints that follow others, and what is left out before MuJoCo reads the rest (`_mujoco_reader`).
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple
from xml.parsers import expat

from .._joint import LARGEST, RobotError
from .._manipulator import JointLimits, Mimic


# Robots nest their bodies a few dozen deep (every joint of a chain is two levels in MJCF), and
# their files have thousands of elements; MuJoCo's own parser overflows the stack far beyond that.
# Its time grows with the square of the number of bodies: 3,000 take a few seconds.
_DEEPEST, _MOST_ELEMENTS, _MOST_BODIES = 256, 200_000, 3000
# Where bodies and joints are: MuJoCo computes with any number, and poses become NaN without a word.
_PLACEMENT = {"xyz", "rpy", "pos", "axis", "quat", "euler", "axisangle", "xyaxes", "zaxis"}
START_TAG = re.compile(rb"""<(?:[^"'>]|"[^"]*"|'[^']*')*>""")


@dataclass(eq=False)
class Element:
    """An element of an XML file: its tag, its attributes, where it is and what is in it."""

    tag: str
    attributes: Mapping[str, str]
    line: int
    start: int  # bytes from the beginning of the file to "<"
    end: int = -1  # to behind its last ">"
    children: "list[Element]" = field(default_factory=list["Element"])

    def all(self, tag: str) -> "list[Element]":
        """Children of a tag."""
        return [child for child in self.children if child.tag == tag]

    def first(self, tag: str) -> "Element | None":
        return next(iter(self.all(tag)), None)


def read_xml(path: Path) -> Element:
    """Return the root element of an XML file, read without trusting it.

    No document type and no entities, internal or external, and neither more elements nor deeper
    ones than a robot can have.

    **Raises** `RobotError`, in one line, naming file and line.
    """
    try:
        return parse_xml(path.read_bytes(), str(path))
    except FileNotFoundError:
        raise RobotError(f"{path}: no such robot file") from None
    except OSError as error:
        raise RobotError(f"{path}: cannot be read: {error}") from None


def parse_xml(text: bytes, where: str) -> Element:
    """Parse the bytes of an XML file as `read_xml` does; `where` names them in errors."""
    parser = expat.ParserCreate()
    top = Element("", {}, 0, 0)
    stack, copies, count, bodies = [top], [1], 0, 0

    def start(tag: str, attributes: Mapping[str, str]) -> None:
        nonlocal count, bodies
        copies.append(copies[-1] * _copies(tag, attributes))
        count += copies[-1]
        if len(stack) > _DEEPEST:
            raise RobotError(f"{line()}: elements nest deeper than {_DEEPEST}; no robot does")
        if count > _MOST_ELEMENTS:
            raise RobotError(f"{line()}: more than {_MOST_ELEMENTS} elements; no robot has so many")
        bodies += copies[-1] if tag in ("link", *_BODIES) else 0
        if bodies > _MOST_BODIES:
            raise RobotError(f"{line()}: more than {_MOST_BODIES} bodies; no robot has so many")
        for name, value in attributes.items():
            # MuJoCo would write a log file into the current folder.
            if "nan" in value.lower().split():
                raise RobotError(f"{line()}: {name} of {tag} is {value!r}; expected numbers")
            if name in _PLACEMENT and not all(map(_is_moderate, value.split())):
                raise RobotError(
                    f"{line()}: {name} of {tag} is {value!r}; expected numbers up to {LARGEST:g}"
                )
        element = Element(tag, attributes, parser.CurrentLineNumber, parser.CurrentByteIndex)
        stack[-1].children.append(element)
        stack.append(element)

    def end(_: str) -> None:
        element = stack.pop()
        copies.pop()
        tag = START_TAG.match(text, element.start)
        if tag is not None and tag[0].endswith(b"/>"):  # empty: expat's index is of little use
            element.end = tag.end()
        else:
            element.end = text.index(b">", parser.CurrentByteIndex) + 1

    def forbid(what: str) -> Callable[..., None]:
        def raise_error(*_: object) -> None:
            raise RobotError(f"{line()}: {what}; expected none in a robot file")

        return raise_error

    def line() -> str:
        return f"{where}, line {parser.CurrentLineNumber}"

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.StartDoctypeDeclHandler = forbid("has a document type declaration (<!DOCTYPE ...>)")
    parser.EntityDeclHandler = forbid("declares an entity")
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise RobotError(f"{where}: not valid XML: {error}") from None
    (root,) = top.children
    return root


def _copies(tag: str, attributes: Mapping[str, str]) -> int:
    """Return the number of copies that an element makes of each of its children, itself included.

    Of bodies that MuJoCo makes in a grid: the size of the grid.
    """
    if tag not in ("replicate", "composite", "flexcomp"):
        return 1
    # As C reads whole numbers: signs, and what follows the digits is left.
    counts = [re.match(r"[+-]?\d{1,9}", text) for text in attributes.get("count", "").split()]
    return max(1, math.prod(int(count[0]) for count in counts if count))


def check_included(root: Element, path: Path) -> None:
    """Check the files that an MJCF file includes or attaches, as parts of it.

    **Raises** `RobotError` as `read_xml` for each of them, for a file that includes itself, and for
    more elements or bodies in all of them than a robot can have.
    """
    elements = bodies = 0

    def visit(element: Element, file: Path, copies: int, around: tuple[Path, ...]) -> None:
        nonlocal elements, bodies
        for child in element.children:
            number = copies * _copies(child.tag, child.attributes)
            elements += number
            bodies += number if child.tag in _BODIES else 0
            for name, count, most in (
                ("elements", elements, _MOST_ELEMENTS),
                ("bodies", bodies, _MOST_BODIES),
            ):
                if count > most:
                    raise RobotError(f"{file}, line {child.line}: more than {most} {name}")
            if child.tag in ("include", "model") and (included := _beside(child, file, path)):
                if included in around or len(around) > _MOST_INCLUDED:
                    fault = "includes itself" if included in around else "is one include too deep"
                    raise RobotError(f"{file}, line {child.line}: {included} {fault}")
                visit(read_xml(included), included, number, (*around, included))
            visit(child, file, number, around)

    visit(root, path, 1, (path.resolve(),))


_BODIES = ("body", "composite", "flexcomp")
_MOST_INCLUDED = 16  # files in each other; robots of MuJoCo's menagerie have two


def _beside(element: Element, *files: Path) -> Path | None:
    """Return the file that an element names, next to one of the files; None if there is none."""
    name = element.attributes.get("file")
    found = (file.parent / name for file in files) if name else ()
    return next((path.resolve() for path in found if path.is_file()), None)


def _is_moderate(text: str) -> bool:
    try:
        return abs(float(text)) <= LARGEST
    except ValueError:
        return True  # not a number: MuJoCo says so


XACRO = "is for xacro; expected a URDF without macros, as `xacro FILE.xacro > FILE.urdf` writes it"

_READ = ("link", "joint", "inertial", "origin", "mass", "inertia", "axis", "mimic", "dynamics")
_KINDS = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")


def check_urdf(root: Element, path: Path) -> None:
    """Check that a URDF's links and joints are one tree.

    **Raises** `RobotError` for cycles, loops, several trees, names that are missing or used twice,
    and macros of xacro.
    """
    _check_no_macros(root, path)
    links = _named(root.all("link"), path)
    joints = _named(root.all("joint"), path)
    carried_by: dict[str, str] = {}  # joint that carries each link
    parents: dict[str, str] = {}
    for name, joint in joints.items():
        at = f"{path}, line {joint.line}, joint {name!r}"
        kind = joint.attributes.get("type", "")
        if kind not in _KINDS:
            raise RobotError(f"{at}: expected a type out of {', '.join(_KINDS)}, got {kind!r}")
        for tag in ("parent", "child", "origin", "axis"):
            if (count := len(joint.all(tag))) > 1:
                raise RobotError(f"{at}: has {count} elements <{tag}>; expected one")
        ends: dict[str, str] = {}
        for end in ("parent", "child"):
            ends[end] = _end(joint, end)
            if ends[end] not in links:
                raise RobotError(f"{at}: its {end} {ends[end]!r} is not a link of this file")
        child = ends["child"]
        if child in carried_by:
            raise RobotError(
                f"{at}: carries link {child!r}, which joint {carried_by[child]!r} carries too:"
                " closed loops are not modelled"
            )
        carried_by[child], parents[child] = name, ends["parent"]
    roots = [name for name in links if name not in parents]
    if links and not roots:
        raise RobotError(f"{path}: its joints form a cycle: no link is the base of the others")
    if len(roots) > 1:
        raise RobotError(
            f"{path}: expected one tree, but no joint carries {' or '.join(map(repr, roots[:4]))}"
        )
    reached: set[str] = set(roots)
    for name in links:  # every link's way down must end at the root
        way: set[str] = set()
        while name not in reached:
            if name in way:
                raise RobotError(
                    f"{path}: joint {carried_by[name]!r} is part of a cycle: its link {name!r}"
                    " carries itself"
                )
            way.add(name)
            name = parents[name]
        reached |= way
    for name, joint in joints.items():
        kind = joint.attributes["type"]
        if kind in ("planar", "floating") and (parent := _end(joint, "parent")) not in roots:
            raise RobotError(
                f"{path}, line {joint.line}, joint {name!r}: is {kind}, and is carried by"
                f" {parent!r}; only revolute and prismatic joints are modelled"
            )


def _end(joint: Element, end: str) -> str:
    """Name of a joint's parent or child."""
    element = joint.first(end)
    return element.attributes.get("link", "") if element else ""


def _check_no_macros(root: Element, path: Path) -> None:
    """Check that there are no elements of xacro: what they stand for would be ignored."""
    elements = [root]
    while elements:
        element = elements.pop()
        values = element.attributes.values()
        if element.tag.startswith("xacro:") or any("${" in x or "$(" in x for x in values):
            raise RobotError(f"{path}, line {element.line}: <{element.tag}> {XACRO}")
        elements += [child for child in element.children if child.tag in _READ or ":" in child.tag]


def urdf_mimics(root: Element, path: Path) -> list[Mimic]:
    """Return the laws by which joints of a URDF follow others.

    **Raises** `RobotError` for one that mimics itself, over others or not, and for a multiplier or
    offset that is no finite number.
    """
    laws: dict[str, Mimic] = {}
    for joint in root.all("joint"):
        mimic = joint.first("mimic")
        if mimic is None or joint.attributes["type"] == "fixed":
            continue
        name = joint.attributes["name"]
        numbers: list[float] = []
        for attribute, usual in (("multiplier", 1.0), ("offset", 0.0)):
            text = mimic.attributes.get(attribute)
            number = usual if text is None else _number(text)
            if number is None:
                raise RobotError(
                    f"{path}, line {mimic.line}, joint {name!r}: expected a finite number for the"
                    f" {attribute} of <mimic>, got {text!r}"
                )
            numbers.append(number)
        laws[name] = Mimic(name, mimic.attributes.get("joint", ""), *numbers)
    for name, law in laws.items():
        way, leader = {name}, law.leader
        while leader in laws:
            if leader in way:
                raise RobotError(
                    f"{path}: joint {name!r} mimics {law.leader!r}, and so in the end itself"
                )
            way.add(leader)
            leader = laws[leader].leader
    return list(laws.values())


def urdf_limits(root: Element) -> dict[str, JointLimits]:
    """The limits of a URDF's joints, by name, without numbers that are none.

    Lower and upper limits of zero, as some exporters write for joints without limits, are none.
    """
    limits: dict[str, JointLimits] = {}
    for joint in root.all("joint"):
        element = joint.first("limit")
        if element is None:
            continue
        low, high, speed, torque = (
            _number(element.attributes.get(name))
            for name in ("lower", "upper", "velocity", "effort")
        )
        revolves = joint.attributes.get("type") == "continuous" or low == high
        limits[joint.attributes.get("name", "")] = JointLimits(
            low=-math.inf if revolves or low is None else low,
            high=math.inf if revolves or high is None else high,
            speed=speed or math.inf,
            torque=torque or math.inf,
        )
    return limits


def _number(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _named(elements: list[Element], path: Path) -> dict[str, Element]:
    named: dict[str, Element] = {}
    for element in elements:
        at, name = f"{path}, line {element.line}", element.attributes.get("name", "")
        if not name:
            raise RobotError(f"{at}: a {element.tag} has no name")
        if name in named:
            raise RobotError(
                f"{at}: {element.tag} {name!r} is named twice, first on line {named[name].line}"
            )
        named[name] = element
    return named


_TYPE = re.compile(rb"""(?<=\s)type\s*=\s*("[^"]*"|'[^']*')""")
_ONCE = ("origin", "mass", "inertia")
_FLOATING = ("floating", "planar")


class Edit(NamedTuple):
    """Part of a URDF that is omitted before it is read, with a note for the user.

    **Attributes**

    - `start`, `end`: bytes of the file, from "<" to behind ">".
    - `line`: on which it starts.
    - `note`: None if it is nothing that a user of the result needs to know.
    - `fixed`: the element is a joint that becomes a fixed one, and stays.
    """

    start: int
    end: int
    line: int
    note: str | None = None
    fixed: bool = False


def simplifications(root: Element) -> list[Edit]:
    """Return the parts to leave out of a URDF that `check_urdf` has checked, in order.

    Geometry, which is not read; repeated numbers of an inertia, of which the first are taken;
    joints by which the whole robot floats, which become fixed ones.
    """
    children = {child.attributes.get("link") for child in _ends(root, "child")}
    base = {name for link in root.all("link") if (name := link.attributes["name"]) not in children}
    edits = [edit for link in root.all("link") for edit in _in_link(link)]
    for joint in root.all("joint"):
        kind, parent, child = joint.attributes.get("type"), *map(joint.first, ("parent", "child"))
        if kind in _FLOATING and parent and child and parent.attributes.get("link") in base:
            note = (
                f"joint {joint.attributes['name']!r} is {kind}: link"
                f" {child.attributes['link']!r} is taken as fixed to the base"
            )
            edits.append(Edit(joint.start, joint.end, joint.line, note, fixed=True))
    return sorted(edits)


def simplified(text: bytes, edits: Sequence[Edit]) -> bytes:
    """The text after these edits; lines keep their numbers."""
    parts: list[bytes] = []
    position = 0
    for edit in edits:
        element = text[edit.start : edit.end]
        kept = _TYPE.sub(b'type="fixed"', element, count=1) if edit.fixed else _lines(element)
        parts += [text[position : edit.start], kept]
        position = edit.end
    return b"".join([*parts, text[position:]])


def _lines(element: bytes) -> bytes:
    return b"\n" * element.count(b"\n")


def _ends(root: Element, end: str) -> Iterator[Element]:
    for joint in root.all("joint"):
        element = joint.first(end)
        if element is not None:
            yield element


def _in_link(link: Element) -> Iterator[Edit]:
    for element in (*link.all("visual"), *link.all("collision")):
        yield Edit(element.start, element.end, element.line)
    first, *others = [*link.all("inertial"), None]
    name = link.attributes["name"]
    for element in others:
        if element is not None:
            yield _repeated(element, f"link {name!r}")
    if first is not None:
        for tag in _ONCE:
            for element in first.all(tag)[1:]:
                yield _repeated(element, f"the inertial of link {name!r}")


def _repeated(element: Element, where: str) -> Edit:
    note = f"<{element.tag}> is repeated in {where}; the first one is taken"
    return Edit(element.start, element.end, element.line, note)
