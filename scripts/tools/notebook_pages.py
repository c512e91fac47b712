"""Shows the notebooks as pages of the documentation site.

`mkdocs.yml` names this file as a hook. Notebooks and the README lie outside of docs/: links to
notebooks lead to their pages on the site, and to the files in a clone.
"""

import base64
import re
from pathlib import Path
from typing import Any

import nbformat
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files


NOTEBOOKS = Path(__file__).parents[2] / "notebooks"
_TO_NOTEBOOK = re.compile(r"\]\(\.\./notebooks/(\w+)\.ipynb\)")
_TO_DOCS = re.compile(r"\]\(\.\./docs/")
_FRAME = re.compile(r'<table border="1" class="dataframe">(.*?</table>)', re.DOTALL)  # of pandas
_TO_README = re.compile(r"\[([^\]]*)\]\(\.\./README\.md[^)]*\)")


def page_of(notebook: nbformat.NotebookNode, name: str) -> tuple[str, dict[str, bytes]]:
    """A notebook as Markdown, and its pictures by file name.

    **Arguments**

    - `name`: of the notebook, with which its pictures' names begin.
    """
    parts: list[str] = []
    pictures: dict[str, bytes] = {}
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            parts.append(_TO_DOCS.sub("](../", cell.source))
            continue
        parts.append(_fenced(cell.source, "python"))
        for output in cell.outputs:
            if output.output_type == "stream":
                parts.append(_fenced(output.text, "text"))
            elif "image/png" in output.get("data", {}):
                file = f"{name}_{len(pictures) + 1}.png"
                pictures[file] = base64.b64decode(output.data["image/png"])
                parts.append(f"![output of the cell above]({file})")
            elif table := _FRAME.search(output.get("data", {}).get("text/html", "")):
                parts.append(f"<table>{table[1]}")  # without a class the theme styles it
            elif "text/plain" in output.get("data", {}):
                parts.append(_fenced(output.data["text/plain"], "text"))
    return "\n\n".join(parts) + "\n", pictures


def site_links(markdown: str) -> str:
    """A page of docs/ whose links to notebooks lead to their pages, and none to the README.

    >>> site_links("[a](../notebooks/b.ipynb), [c](../README.md#d), [e](f.md)")
    '[a](notebooks/b.md), c, [e](f.md)'
    """
    return _TO_README.sub(r"\1", _TO_NOTEBOOK.sub(r"](notebooks/\1.md)", markdown))


def _fenced(text: str, language: str) -> str:
    return f"```{language}\n{text.rstrip()}\n```"


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Adds the pages and pictures of all notebooks."""
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        text, pictures = page_of(nbformat.read(path, as_version=4), path.stem)
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=text))
        for name, picture in pictures.items():
            files.append(File.generated(config, f"notebooks/{name}", content=picture))
    return files


def on_page_markdown(markdown: str, **page: Any) -> str:
    """Links of a page, as `site_links` has them."""
    del page
    return site_links(markdown)
