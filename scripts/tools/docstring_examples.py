"""Fences the examples of docstrings for the documentation site.

Docstrings hold examples as plain `>>>` lines, which `help()` shows as they are and pytest runs. In
Markdown such lines would be quotations. `mkdocs.yml` names this file as an extension of griffe, the
reader of docstrings.
"""

import re
from typing import Any

import griffe


# From a prompt at the start of a line to the next empty line, or to the end.
_EXAMPLE = re.compile(r"^>>> .*?(?=\n\n(?!>>>)|\Z)", re.MULTILINE | re.DOTALL)


def fenced(docstring: str) -> str:
    """The docstring with its examples in fences.

    >>> print(fenced("Adds.\\n\\n>>> 1 + 1\\n2"))
    Adds.
    <BLANKLINE>
    ```pycon
    >>> 1 + 1
    2
    ```
    """
    if "```" in docstring:
        return docstring
    return _EXAMPLE.sub(lambda match: f"```pycon\n{match.group()}\n```", docstring)


class FencedExamples(griffe.Extension):
    """Applies `fenced` to every docstring that griffe reads."""

    def on_object(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        del kwargs
        if obj.docstring is not None:
            obj.docstring.value = fenced(obj.docstring.value)
