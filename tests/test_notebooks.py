"""Every notebook runs from top to bottom, and what is stored of it is fit to be read by others."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import nbformat
import pytest

from scripts.tools import execute_notebooks


ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
LARGEST = 300_000  # bytes: what a reader on a slow line can wait for


def read(path: Path) -> nbformat.NotebookNode:
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    return notebook


def code(notebook: nbformat.NotebookNode) -> list[nbformat.NotebookNode]:
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def kinds(notebook: nbformat.NotebookNode) -> list[list[tuple[str, ...]]]:
    """What every cell answers: text on which stream, pictures, values."""
    return [
        [
            (out.output_type, out.get("name", ""), *sorted(out.get("data", {})))
            for out in cell.outputs
        ]
        for cell in code(notebook)
    ]


def test_there_are_notebooks() -> None:
    names = "chapter_7 control excitation_loop first_identification friction into_mujoco"
    more = "learning_networks payload reading_the_report servo_arm when_not_to_trust"
    assert [path.stem for path in NOTEBOOKS] == f"{names} {more}".split()


@pytest.mark.parametrize(
    "path", [p for p in NOTEBOOKS if p.stem != "chapter_7"], ids=lambda p: p.stem
)
def test_it_needs_the_package_alone_and_has_something_to_try(path: Path) -> None:
    """Except that of the thesis's experiment, which needs the simulator."""
    notebook = read(path)
    words = "".join(cell.source for cell in notebook.cells if cell.cell_type == "markdown")
    assert 'pip install ".[all]"' in words and "**Try**" in words
    program = "\n".join(cell.source for cell in code(notebook))
    assert not re.search(r"^\s*(?:import|from) (?:sim|scripts|tests)\b", program, re.MULTILINE)
    assert not re.search(r"jaxcslc\S*\._", program), "names of a private module"


@pytest.fixture(scope="module")
def kernel() -> Iterator[Any]:
    """Compiles as the tests do: `conftest.py` sets that in the environment."""
    with execute_notebooks.kernel() as manager:
        yield manager


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs_from_top_to_bottom(path: Path, kernel: Any) -> None:
    executed = execute_notebooks.execute(path, kernel)
    assert kinds(executed) == kinds(read(path)), "renew it: scripts/tools/execute_notebooks.py"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_what_is_stored_is_whole_and_of_no_machine(path: Path) -> None:
    notebook, text = read(path), path.read_text("utf-8")
    cells = code(notebook)
    assert len(text) < LARGEST
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    assert any(cell.outputs for cell in cells)
    assert all(not cell.metadata for cell in notebook.cells)
    assert notebook.metadata.keys() <= {"kernelspec", "language_info"}
    assert notebook.metadata.language_info == {"name": "python"}
    streams = {out.name for cell in cells for out in cell.outputs if out.output_type == "stream"}
    assert streams <= {"stdout"}, "a cell warns"
    written = "".join(
        str(out.get("text", "")) + str(out.get("data", {}).get("text/plain", ""))
        for cell in cells
        for out in cell.outputs
    )
    assert not re.search(r"(?<!\w)/(work|home|root|tmp|Users|usr|opt)/|0x[0-9a-f]{6}", written)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_its_first_code_switches_float64_on(path: Path) -> None:
    assert "jc.enable_x64()" in code(read(path))[0].source


def test_a_cell_that_fails_is_named(tmp_path: Path) -> None:
    broken = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("1 / 0")])
    path = tmp_path / "broken.ipynb"
    nbformat.write(broken, path)
    with pytest.raises(execute_notebooks.CellExecutionError, match="ZeroDivisionError"):
        execute_notebooks.execute(path)


def test_pictures_are_drawn_whatever_the_environment_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MPLBACKEND", "Agg")
    lines = (
        "%matplotlib inline",
        "import matplotlib.pyplot as plt",
        "plt.plot([0, 1])",
        "plt.show()",
    )
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("\n".join(lines))])
    path = tmp_path / "picture.ipynb"
    nbformat.write(notebook, path)
    (outputs,) = kinds(execute_notebooks.execute(path))
    assert ("display_data", "", "image/png", "text/plain") in outputs


def test_no_such_notebook(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        execute_notebooks.main(["nowhere.ipynb"])
    assert "nowhere.ipynb: no such notebook" in capsys.readouterr().err
