"""References of the thesis page: public names, files of the repository, and pages of docs/."""

import functools
import importlib
import re
from pathlib import Path

from markdown.extensions.toc import slugify


ROOT = Path(__file__).parents[3]
_NAME = re.compile(r"(?:jaxcslc|sim)(?:\.\w+)+")
_LISTED = re.compile(r"^::: (\S+)$", re.MULTILINE)
_FENCED = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
_HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)


def link(reference: str) -> str:
    """A reference as Markdown of a page of docs/.

    **Raises**

    - `ValueError`: there is no such name, file, page or heading.
    """
    if _NAME.fullmatch(reference):
        return _name_link(reference)
    path, _, anchor = reference.partition("#")
    if not (ROOT / path).is_file():
        raise ValueError(f"{reference}: no such file or public name")
    if path.startswith("docs/") and path.endswith(".md"):
        headings = _headings(ROOT / path)
        if anchor and anchor not in headings:
            known = ", ".join(headings)
            raise ValueError(f"{reference}: no such heading; expected one of {known}")
        page = path.removeprefix("docs/")
        title = headings[anchor] if anchor else next(iter(headings.values()))
        return f"[{title}]({page}{'#' + anchor if anchor else ''})"
    if anchor:
        raise ValueError(f"{reference}: expected no anchor behind a file that is no page of docs/")
    return f"[`{path}`](../{path})" if path.startswith("notebooks/") else f"`{path}`"


def _name_link(reference: str) -> str:
    """Link to the API page of a public name, or of the class that has a member of this name."""
    parts = reference.split(".")
    depth = 1 if parts[0] == "sim" else 2
    package, name, members = ".".join(parts[:depth]), parts[depth], parts[depth + 1 :]
    page = f"api/{parts[depth - 1]}.md"
    value = getattr(importlib.import_module(package), name, None)
    for member in members:
        fields = getattr(value, "__dataclass_fields__", {})
        value = getattr(value, member, fields.get(member))
    if value is None:
        raise ValueError(f"{reference}: no such public name")
    if f"{package}.{name}" not in _listed(page):
        raise ValueError(f"{reference}: docs/{page} does not list {package}.{name}")
    shown = ".".join([*(("sim",) if package == "sim" else ()), name, *members])
    return f"[`{shown}`]({page}#{package}.{name})"


@functools.cache
def _listed(page: str) -> frozenset[str]:
    return frozenset(_LISTED.findall((ROOT / "docs" / page).read_text(encoding="utf-8")))


@functools.cache
def _headings(path: Path) -> dict[str, str]:
    """Headings of a page by their anchors, as the documentation site makes them."""
    text = _FENCED.sub("", path.read_text(encoding="utf-8"))
    return {slugify(_plain(title), "-"): _plain(title) for title in _HEADING.findall(text)}


def _plain(title: str) -> str:
    return re.sub(r"[`*]", "", title)
