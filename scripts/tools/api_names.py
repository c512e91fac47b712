"""Add to pages of docs/api a table of their names, each with a description of one line.

`mkdocs.yml` names this file as a hook. Descriptions are the first sentences of docstrings, or of
the strings below constants.
"""

import ast
import importlib
import inspect
import itertools
import re
from functools import cache
from pathlib import Path
from typing import Any


ROOT = Path(__file__).parents[2]
_LISTED = re.compile(r"^::: ((?:jaxcslc|sim)[\w.]*)\.(\w+)$", re.MULTILINE)
_ROW = re.compile(r"^\| \[`jc\.(\w+)`\]\[([\w.]+)\.\w+\] \| (.+) \|$", re.MULTILINE)


def description(package: str, name: str) -> str:
    """Return the first sentence of what documents a public name; empty if nothing does.

    >>> description("jaxcslc.manipulator", "load_robot")[:4]
    'Load'
    """
    value = getattr(importlib.import_module(package), name)
    # Compiled and cached functions have a module as well; constants and aliases of types have none.
    if callable(value) and str(getattr(value, "__module__", "")).startswith(("jaxcslc", "sim")):
        text = inspect.getdoc(value) or ""
    else:
        text = _below_assignments(package).get(name, "")
    return first_sentence(text)


def first_sentence(text: str) -> str:
    """Return the first sentence of a docstring, in one line.

    >>> first_sentence("Joins a, b, e.g. c.\\n\\nMore.")
    'Joins a, b, e.g. c.'
    """
    paragraph = " ".join(text.strip().partition("\n\n")[0].split())
    match = re.match(r".*?[a-z0-9)`\]]\.(?= [A-Z])", paragraph)
    return match.group(0) if match else paragraph


@cache
def _below_assignments(package: str) -> dict[str, str]:
    """Strings below assignments of a package's modules, by the name that is assigned."""
    texts: dict[str, str] = {}
    for path in sorted((ROOT / package.replace(".", "/")).rglob("*.py")):
        body = ast.parse(path.read_text("utf-8")).body
        for statement, after in itertools.pairwise(body):
            names: list[ast.expr] = []
            if isinstance(statement, ast.Assign):
                names = statement.targets
            elif isinstance(statement, ast.AnnAssign):
                names = [statement.target]
            if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
                for target in names:
                    if isinstance(target, ast.Name) and isinstance(after.value.value, str):
                        texts[target.id] = after.value.value
    return texts


def with_descriptions(markdown: str) -> str:
    """Return a page of docs/api with a table of its names, or with descriptions in its own."""
    if _ROW.search(markdown):
        markdown = markdown.replace(
            "| name | page |\n|---|---|", "| name | description | page |\n|---|---|---|"
        )
        return _ROW.sub(
            lambda row: (
                f"| [`jc.{row[1]}`][{row[2]}.{row[1]}] | {_cell(row[2], row[1])} | {row[3]} |"
            ),
            markdown,
        )
    listed = _LISTED.findall(markdown)
    rows = [f"| [`{name}`][{where}.{name}] | {_cell(where, name)} |" for where, name in listed]
    start = _LISTED.search(markdown)
    if start is None or len(rows) < 2:
        return markdown
    table = "\n".join(["| name | description |", "|---|---|", *rows])
    return f"{markdown[: start.start()]}{table}\n\n{markdown[start.start() :]}"


def _cell(package: str, name: str) -> str:
    return description(package, name).replace("|", "\\|")


def on_page_markdown(markdown: str, *, page: Any, **rest: Any) -> str:
    """Add descriptions to pages of the API."""
    del rest
    return with_descriptions(markdown) if page.file.src_uri.startswith("api/") else markdown
