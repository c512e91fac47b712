import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from ..manipulator import Element


_ATTRIBUTE = re.compile(rb"""(\s+)([^\s=/>"']+)\s*=\s*("[^"]*"|'[^']*')""")
_START = re.compile(rb"""<(?:[^"'>]|"[^"]*"|'[^']*')*>""")


@dataclass(eq=False)
class _Change:
    element: Element
    attributes: dict[str, str] = field(default_factory=dict[str, str])
    removed: set[str] = field(default_factory=set[str])
    children: list[bytes] = field(default_factory=list[bytes])


class XmlEdits:
    """Changes of an XML text that leave all other bytes as they are.

    Attributes are set, taken away or added in their element's tag; new elements go before an
    element's first child. Comments, whitespace, quotes and the order of attributes stay.

    >>> from jaxcslc.manipulator import parse_xml
    >>> text = b'<a>  <!-- as it was --> <b x = "1"/></a>'
    >>> edits = XmlEdits(text)
    >>> edits.set(parse_xml(text, "example").children[0], {"x": "2", "y": "3"})
    >>> edits.text()
    b'<a>  <!-- as it was --> <b x = "2" y="3"/></a>'
    """

    def __init__(self, text: bytes) -> None:
        self._text = text
        self._changes: dict[int, _Change] = {}

    def set(
        self, element: Element, attributes: Mapping[str, str], *, without: tuple[str, ...] = ()
    ) -> None:
        """Give an element attributes, and take others away."""
        change = self._changes.setdefault(element.start, _Change(element))
        change.attributes |= attributes
        change.removed |= set(without)

    def insert(self, element: Element, child: str) -> None:
        """A new first child, on a separate line if the others are; its further lines are
        indented like its first."""
        change = self._changes.setdefault(element.start, _Change(element))
        change.children.append(child.encode())

    def text(self) -> bytes:
        """The text with all changes made."""
        text = self._text
        for start in sorted(self._changes, reverse=True):
            change = self._changes[start]
            tag = _START.match(text, start)
            assert tag is not None
            new = _with_attributes(tag[0], change)
            if change.children:
                new = self._with_children(new, change)
            text = text[:start] + new + text[tag.end() :]
        return text

    def _with_children(self, tag: bytes, change: _Change) -> bytes:
        outer = _indentation(self._text, change.element.start)
        inner = outer + b"  "
        if change.element.children:
            inner = _indentation(self._text, change.element.children[0].start)
        lines = b"".join(inner + child.replace(b"\n", inner) for child in change.children)
        if tag.endswith(b"/>"):
            name = change.element.tag.encode()
            return tag[:-2].rstrip() + b">" + lines + outer + b"</" + name + b">"
        return tag + lines


def _with_attributes(tag: bytes, change: _Change) -> bytes:
    new = {name.encode(): value.encode() for name, value in change.attributes.items()}
    removed = {name.encode() for name in change.removed}

    def changed(match: re.Match[bytes]) -> bytes:
        name, quoted = match[2], match[3]
        if name in removed:
            return b""
        if name not in new:
            return match[0]
        return match[0][: -len(quoted)] + quoted[:1] + new.pop(name) + quoted[:1]

    tag = _ATTRIBUTE.sub(changed, tag)
    end = b"/>" if tag.endswith(b"/>") else b">"
    body = tag[: -len(end)]
    bare = body.rstrip()
    added = b"".join(b' %s="%s"' % pair for pair in new.items())
    return bare + added + body[len(bare) :] + end


def _indentation(text: bytes, start: int) -> bytes:
    """Line break and spaces before an element; empty if it does not begin a line."""
    before = text[:start]
    space = before[len(before.rstrip()) :]
    return space[space.rfind(b"\n") :] if b"\n" in space else b""
