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


def test_the_file_describes_the_same_system(
    blocks: dict[str, list[str]], system: System, tmp_path: Path
) -> None:
    path = tmp_path / "cartpole.toml"
    path.write_text(blocks["toml"][0], encoding="utf-8")
    from_file = load_system(path)
    assert from_file.separation.regressor == system.separation.regressor
    assert from_file.separation.coefficients[0].expression == "m*l"
    assert from_file.column_names == ("x", "pole_angle", "pole_gyro", "force")
