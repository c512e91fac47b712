"""Notebooks as pages of the site: every cell and output is there, and links lead somewhere."""

import base64
import re
from pathlib import Path

import nbformat
import pytest

from scripts.tools.notebook_pages import NOTEBOOKS, page_of, site_links


ROOT = Path(__file__).parents[3]
DOCS = ROOT / "docs"
FRAME = '<table border="1" class="dataframe">'  # as pandas writes it
CELLS = "<tr><td>1</td></tr></table>"


def test_cells_and_outputs_become_markdown() -> None:
    v4 = nbformat.v4
    outputs = [
        v4.new_output("stream", text="2\n"),
        v4.new_output("display_data", {"image/png": base64.b64encode(b"PNG").decode()}),
        v4.new_output("execute_result", {"text/plain": "3"}, execution_count=1),
        v4.new_output(
            "display_data", {"text/plain": "x", "text/html": f"<div>{FRAME}{CELLS}</div>"}
        ),
    ]
    cells = [
        v4.new_markdown_cell("# Title\n\n[control](../docs/control.md#saturation)"),
        v4.new_code_cell("print(1 + 1)", outputs=outputs),
    ]
    text, pictures = page_of(v4.new_notebook(cells=cells), "sums")
    assert text == (
        "# Title\n\n[control](../control.md#saturation)\n\n```python\nprint(1 + 1)\n```\n\n"
        "```text\n2\n```\n\n![output of the cell above](sums_1.png)\n\n```text\n3\n```\n\n"
        f"<table>{CELLS}\n"
    )
    assert pictures == {"sums_1.png": b"PNG"}


@pytest.mark.parametrize("path", sorted(NOTEBOOKS.glob("*.ipynb")), ids=lambda path: path.stem)
def test_every_notebook_has_its_page(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    text, pictures = page_of(notebook, path.stem)
    assert f"notebooks/{path.stem}.md" in (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    assert all(picture.startswith(b"\x89PNG") for picture in pictures.values())
    for target in re.findall(r"\]\(\.\./([\w/]+\.md)\)", text):
        assert (DOCS / target).is_file()


def test_links_of_pages_stay_on_the_site() -> None:
    for path in DOCS.glob("*.md"):
        text = re.sub(r"```.*?```", "", path.read_text("utf-8"), flags=re.DOTALL)
        for target in re.findall(r"\]\(([^)#]+)[^)]*\)", site_links(text)):
            if target.startswith(("http:", "https:")):
                continue
            notebook = target.startswith("notebooks/")
            file = ROOT / target.replace(".md", ".ipynb") if notebook else DOCS / target
            assert file.is_file(), f"{path.name}: {target}"
