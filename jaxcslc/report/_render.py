"""HTML of a page, from templates."""

import contextlib
import importlib.util
import itertools
import os
import pickle
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax

from .._environment import require
from ._blocks import Page


if TYPE_CHECKING:
    import jinja2


_MISSING = "Pictures need the extra 'report': pip install 'jaxcslc[report]'"


def render(page: Page, *, interactive: bool | None = None) -> str:
    """A page as one HTML file, that needs nothing beside it but files that it names.

    Texts are escaped: a robot may have any name.

    **Arguments**

    - `page`: with its sections.
    - `interactive`: draw charts with plotly.js, which is then part of the page (5 MB); without it
      they are static pictures by matplotlib. By default if plotly is installed; without
      matplotlib too, a line says how to install it.

    **Returns** the file's text.

    **Raises**

    - `MissingExtraError`: `interactive` without plotly.

    >>> from jaxcslc.report import Page, Paragraph, Section, render
    >>> section = Section("Errors", "", (Paragraph("below 1 N m"),))
    >>> page = Page("Arm <1>", "", "", "plain", (), (section,))
    >>> "<h1>Arm &lt;1&gt;</h1>" in render(page, interactive=False)
    True
    """
    if interactive is None:
        interactive = importlib.util.find_spec("plotly") is not None
    return _template().render(
        page=page,
        script=require("plotly.offline", "report").get_plotlyjs() if interactive else None,
        pictures=importlib.util.find_spec("matplotlib") is not None,
        missing=_MISSING,
        number=itertools.count(1).__next__,
    )


@cache
def _template() -> "jinja2.Template":
    import jinja2  # most users write no page

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
        bytecode_cache=_bytecode_cache(),
    )
    return environment.get_template("page.html")


def _bytecode_cache() -> "jinja2.BytecodeCache | None":
    """Return a cache of compiled templates, next to JAX's compiled programs on disk."""
    import jinja2

    config: Any = jax.config
    folder = config.jax_compilation_cache_dir
    if not folder:
        return None
    with contextlib.suppress(OSError):
        Path(folder).mkdir(parents=True, exist_ok=True)
    if not os.access(folder, os.W_OK):
        return None

    class Kept(jinja2.FileSystemBytecodeCache):
        def load_bytecode(self, bucket: "jinja2.bccache.Bucket") -> None:
            try:
                super().load_bytecode(bucket)
            except (pickle.UnpicklingError, EOFError, ValueError, TypeError):  # cut off
                bucket.reset()

    return Kept(folder, "jaxcslc-%s.jinja")
