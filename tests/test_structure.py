"""Folders and files stay small, and identifiers are plain technical words."""

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest


ROOT = Path(__file__).parents[1]
PACKAGES = ("jaxcslc", "sim", "scripts")
MOST_FILES = 16  # of a folder, beside its `__init__.py`
MOST_LINES = 400
MOST_LINES_OF_TESTS = 450
MOST_LINES_OF_FUNCTION = 60  # of the command, docstrings left out

# Names that do not say what a thing is.
VAGUE = {
    *("found", "given", "own", "chosen", "each", "rest", "place", "places", "counts_in", "driven"),
    *("sliding", "felt", "told", "TOLD", "waves", "freedom", "bread", "pull", "rubbing"),
    *("Circumstances", "check_words"),
}


def files_of(folder: str) -> list[Path]:
    return sorted((ROOT / folder).rglob("*.py"))


def identifiers(source: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Name):
            yield node.id
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.Attribute):
            yield node.attr
        elif isinstance(node, ast.FunctionDef | ast.ClassDef | ast.AsyncFunctionDef):
            yield node.name


def lines_of_functions(source: str) -> Iterator[tuple[str, int]]:
    """Functions with the number of their lines, docstring left out."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            words = ast.get_docstring(node, clean=False)
            assert node.end_lineno is not None
            documented = 0 if words is None else words.count("\n") + 1
            yield node.name, node.end_lineno - node.lineno + 1 - documented


def is_vague(name: str, source: str) -> bool:
    if name == "given" and "hypothesis" in source:  # its decorator is called so
        return False
    return name in VAGUE or name.lstrip("_").startswith("refuse_")


@pytest.mark.parametrize("package", PACKAGES)
def test_folders_have_few_files(package: str) -> None:
    sizes = Counter(path.parent for path in files_of(package) if path.name != "__init__.py")
    assert {str(folder) for folder, size in sizes.items() if size > MOST_FILES} == set()


@pytest.mark.parametrize("package", [*PACKAGES, "tests"])
def test_files_are_short(package: str) -> None:
    lengths = {path: path.read_text("utf-8").count("\n") for path in files_of(package)}
    most = MOST_LINES_OF_TESTS if package == "tests" else MOST_LINES
    long = {str(path.relative_to(ROOT)) for path, lines in lengths.items() if lines > most}
    assert long == set()


def test_functions_of_the_command_are_short() -> None:
    """The command parses, calls one function and prints: what takes longer is the library's."""
    long = {
        f"{path.name}: {name}"
        for path in files_of("jaxcslc/cli")
        for name, lines in lines_of_functions(path.read_text("utf-8"))
        if lines > MOST_LINES_OF_FUNCTION
    }
    assert long == set()


@pytest.mark.parametrize("package", [*PACKAGES, "tests"])
def test_identifiers_say_what_a_thing_is(package: str) -> None:
    sources = {path.relative_to(ROOT): path.read_text("utf-8") for path in files_of(package)}
    vague = {
        f"{path}: {name}"
        for path, source in sources.items()
        for name in identifiers(source)
        if is_vague(name, source)
    }
    assert vague == set()
