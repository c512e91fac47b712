import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from ._xml import Element


_TYPE = re.compile(rb"""(?<=\s)type\s*=\s*("[^"]*"|'[^']*')""")
_ONCE = ("origin", "mass", "inertia")
_FLOATING = ("floating", "planar")


class Edit(NamedTuple):
    """What of a URDF is left out before it is read, and what to say about it.

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
    """What to leave out of a URDF that was checked (`check_urdf`), in order.

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
