"""Blocks of pages of the documentation run as they stand, each in an empty folder of its own."""

import dataclasses
import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

import jaxcslc as jc
from jaxcslc.least_squares import settings_from


DOCS = Path(__file__).parents[1] / "docs"
# Blocks that take longer: that each defines and imports what it uses is checked without running it.
SLOW = (
    "simulator.md",
    "recordings.md",
    "checks.md",
    "likelihood.md",
    "ultrasound.md",
    "peral.md",
)
# Run in `test_readme.py`, which looks at what they print.
PRINTING = ("networks.md", "friction.md", "payload.md", "control.md")
PAGES = (
    "robots.md",
    "uncertainty.md",
    "export.md",
    "settings.md",
    "report.md",
    "excitation.md",
    "comparison.md",
    "preparation.md",
)


def blocks(page: str, language: str) -> list[str]:
    text = (DOCS / page).read_text("utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


@pytest.mark.parametrize("page", PAGES)
def test_python(
    page: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    examples = blocks(page, "python")
    assert examples
    for number, example in enumerate(examples):
        folder = tmp_path / str(number)
        folder.mkdir()
        monkeypatch.chdir(folder)
        exec(compile(example, f"docs/{page}", "exec"), {})
    assert capsys.readouterr().out == ("True\n" if page == "settings.md" else "")


def test_names_are_defined_where_they_are_used(tmp_path: Path) -> None:
    for page in (*PAGES, *PRINTING, *SLOW):
        for number, example in enumerate(blocks(page, "python"), start=1):
            (tmp_path / f"{Path(page).stem}_{number}.py").write_text(example, encoding="utf-8")
    line = [sys.executable, "-m", "ruff", "check", "--isolated", "--no-cache", "--select", "F821"]
    done = subprocess.run([*line, tmp_path], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    assert len(list(tmp_path.iterdir())) > 25


def test_robots_are_as_the_page_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(blocks("robots.md", "python")[0], names)
    load = jc.load_robot
    assert load("arms.xml", tip=["left hand", "right arm"]).parents == (-1, 0, 1, 0)
    assert load("arms.xml", fix="* hand").joint_names == ("waist", "left elbow", "right elbow")
    part = load("arms.xml", base="torso", tip="left hand")
    assert part.joint_names == ("left elbow", "left wrist")


def test_the_page_of_settings_has_every_entry() -> None:
    (example,) = blocks("settings.md", "json")
    settings = settings_from(json.loads(example))
    assert settings.solver.loss == "huber" and settings.preparation.torque_lag == 0.002
    text = (DOCS / "settings.md").read_text("utf-8")
    for kind in (jc.Preparation, jc.LeastSquares):
        for field in dataclasses.fields(kind):
            assert f"| `{field.name}` |" in text
    for kind in (jc.AveragedSplines, jc.Butterworth, jc.recordings.SavitzkyGolay):
        for field in dataclasses.fields(kind):
            assert f"`{field.name}`" in text
    for name in ("averaged_splines", "butterworth", "savitzky_golay", "central_differences"):
        assert f"| `{name}` |" in text


def test_the_page_of_installation_has_every_extra() -> None:
    project = tomllib.loads((DOCS.parent / "pyproject.toml").read_text("utf-8"))["project"]
    rows = re.findall(r"^\| (`.+`) \|", (DOCS / "install.md").read_text("utf-8"), re.MULTILINE)
    named = {name for row in rows for name in re.findall(r"`(.+?)`", row)}
    assert named == set(project["optional-dependencies"]) - {"all"}
