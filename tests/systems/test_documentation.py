"""The page on systems shows what its code prints, and its file describes the same system."""

import re
from pathlib import Path
from typing import Any

import pytest

from jaxcslc.systems import System, load_system


PAGE = Path(__file__).parents[2] / "docs" / "systems.md"


@pytest.fixture(scope="module")
def blocks() -> dict[str, list[str]]:
    """The fenced blocks of the page, by language."""
    by_language: dict[str, list[str]] = {}
    for language, text in re.findall(r"```(\w+)\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL):
        by_language.setdefault(language, []).append(text)
    return by_language


@pytest.fixture(scope="module")
def system(blocks: dict[str, list[str]]) -> System:
    names: dict[str, Any] = {}
    described, _ = blocks["python"][0].split("print(system)")
    exec(described, names)
    return names["system"]


def test_the_page_shows_what_is_printed(blocks: dict[str, list[str]], system: System) -> None:
    assert blocks["text"][0].strip() == str(system)


def test_the_blocks_run_one_after_another(
    blocks: dict[str, list[str]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for block in blocks["python"]:
        exec(compile(block, PAGE.name, "exec"), names)
    report, search = names["report"], names["search"]
    truth = {"k1": 0.075, "b": 0.6, "k3": 0.0225, "k4": 1.25}
    for name, value, (low, high) in zip(
        report.network.names, report.k, report.fit.confidence_interval(0.999), strict=True
    ):
        assert low < truth[name] < high, (name, value)
    assert not report.warnings and abs(float(search.values["n"]) - 0.5) < 1e-4


def test_the_file_describes_the_same_system(
    blocks: dict[str, list[str]], system: System, tmp_path: Path
) -> None:
    path = tmp_path / "cartpole.toml"
    path.write_text(blocks["toml"][0], encoding="utf-8")
    from_file = load_system(path)
    assert from_file.separation.regressor == system.separation.regressor
    assert from_file.separation.coefficients[0].expression == "m*l"
    assert from_file.column_names == ("x", "pole_angle", "pole_gyro", "force")
