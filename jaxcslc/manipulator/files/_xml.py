"""XML reader for files that nobody vouches for: no document types, no entities, bounded size."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from .._errors import RobotError


# Robots nest their bodies a few dozen deep (every joint of a chain is two levels in MJCF), and
# their files have thousands of elements; MuJoCo's own parser overflows the stack far beyond that.
# Its time grows with the square of the number of bodies: 3,000 take a few seconds.
_DEEPEST, _MOST_ELEMENTS, _MOST_BODIES = 256, 200_000, 3000
# Where bodies and joints are: MuJoCo computes with any number, and poses become NaN without a word.
_PLACEMENT = {"xyz", "rpy", "pos", "axis", "quat", "euler", "axisangle", "xyaxes", "zaxis"}
_LARGEST = 1e9
_TAG = re.compile(rb"""<(?:[^"'>]|"[^"]*"|'[^']*')*>""")


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
    """The root element of an XML file, read without trusting it.

    No document type and no entities, internal or external, and neither more elements nor deeper
    ones than a robot can have.

    **Raises**

    - `RobotError`: in one line, naming file and line.
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
        bodies += copies[-1] if tag in ("body", "link") else 0
        if bodies > _MOST_BODIES:
            raise RobotError(f"{line()}: more than {_MOST_BODIES} bodies; no robot has so many")
        for name, value in attributes.items():
            # MuJoCo would write a log file into the current folder.
            if "nan" in value.lower().split():
                raise RobotError(f"{line()}: {name} of {tag} is {value!r}; expected numbers")
            if name in _PLACEMENT and not all(map(_is_moderate, value.split())):
                raise RobotError(
                    f"{line()}: {name} of {tag} is {value!r}; expected numbers up to {_LARGEST:g}"
                )
        element = Element(tag, attributes, parser.CurrentLineNumber, parser.CurrentByteIndex)
        stack[-1].children.append(element)
        stack.append(element)

    def end(_: str) -> None:
        element = stack.pop()
        copies.pop()
        tag = _TAG.match(text, element.start)
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
    """Return the number of copies that an element makes of each of its children."""
    count = attributes.get("count", "") if tag == "replicate" else ""
    return max(1, int(count)) if count.isdecimal() and len(count) < 10 else 1


def _is_moderate(text: str) -> bool:
    try:
        return abs(float(text)) <= _LARGEST
    except ValueError:
        return True  # not a number: MuJoCo says so
