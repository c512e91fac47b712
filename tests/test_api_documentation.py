"""The pages of `docs/api` list every public name, and no other."""

import importlib
import re
import types
from pathlib import Path

import pytest

from scripts.tools.api_names import description, with_descriptions
from scripts.tools.docstring_examples import fenced


ROOT = Path(__file__).parents[1]
PAGES = sorted(path.stem for path in (ROOT / "docs" / "api").glob("*.md"))


def public_names(package: str) -> set[str]:
    """Names in `__all__`, or all names; packages have pages of their own."""
    module = importlib.import_module(package)
    names = getattr(module, "__all__", [name for name in dir(module) if name[0] != "_"])
    return {name for name in names if not isinstance(getattr(module, name), types.ModuleType)}


@pytest.mark.parametrize("page", PAGES)
def test_lists_what_the_package_exports(page: str) -> None:
    text = (ROOT / "docs" / "api" / f"{page}.md").read_text("utf-8")
    if page == "jaxcslc":
        assert set(re.findall(r"`jc\.(\w+)`", text)) == public_names("jaxcslc")
        return
    package = "sim" if page == "sim" else f"jaxcslc.{page}"
    listed = re.findall(rf"^::: {re.escape(package)}\.(\w+)$", text, re.MULTILINE)
    assert set(listed) == public_names(package)


@pytest.mark.parametrize("page", PAGES)
def test_every_name_is_described_in_one_line(page: str) -> None:
    package = page if page in ("jaxcslc", "sim") else f"jaxcslc.{page}"
    described = {name: description(package, name) for name in public_names(package)}
    wrong = {
        name: text for name, text in described.items() if not re.fullmatch(r".{10,}[.?]", text)
    }
    assert wrong == {}, "expected a docstring, or a string below the constant"


def test_descriptions_are_put_into_the_pages() -> None:
    of_package = with_descriptions((ROOT / "docs" / "api" / "checks.md").read_text("utf-8"))
    assert "| [`check`][jaxcslc.checks.check] | " in of_package
    of_all = with_descriptions((ROOT / "docs" / "api" / "jaxcslc.md").read_text("utf-8"))
    text = description("jaxcslc.network", "derive")
    assert f"| [`jc.derive`][jaxcslc.network.derive] | {text} | [network](network.md) |" in of_all


def test_every_package_has_its_page() -> None:
    """Except the command, and packages that only other packages use."""
    folders = {path.parent.name for path in (ROOT / "jaxcslc").glob("*/__init__.py")}
    packages = {
        name for name in folders if hasattr(importlib.import_module(f"jaxcslc.{name}"), "__all__")
    }
    assert folders - packages == {"cli", "codegen"}
    assert packages == set(PAGES) - {"jaxcslc", "sim"}


def test_examples_are_fenced() -> None:
    assert fenced("Adds.\n\n>>> 1 + 1\n2\n\nMore.") == (
        "Adds.\n\n```pycon\n>>> 1 + 1\n2\n```\n\nMore."
    )
