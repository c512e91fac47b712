"""Modules say what they hold, by names that exist; functions of the command stay short."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path


ROOT = Path(__file__).parents[1]
MOST_LINES_OF_FUNCTION = 60  # of the command, docstrings left out


def files_of(folder: str) -> list[Path]:
    return sorted((ROOT / folder).rglob("*.py"))


def lines_of_functions(source: str) -> Iterator[tuple[str, int]]:
    """Functions with the number of their lines, docstring left out."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            words = ast.get_docstring(node, clean=False)
            assert node.end_lineno is not None
            documented = 0 if words is None else words.count("\n") + 1
            yield node.name, node.end_lineno - node.lineno + 1 - documented


def test_functions_of_the_command_are_short() -> None:
    """The command parses, calls one function and prints: what takes longer is the library's."""
    long = {
        f"{path.name}: {name}"
        for path in files_of("jaxcslc/cli")
        for name, lines in lines_of_functions(path.read_text("utf-8"))
        if lines > MOST_LINES_OF_FUNCTION
    }
    assert long == set()


def test_every_module_says_what_it_holds() -> None:
    silent = {
        str(path.relative_to(ROOT))
        for path in files_of("jaxcslc")
        if ast.get_docstring(ast.parse(path.read_text("utf-8"))) is None
    }
    assert silent <= {"jaxcslc/__main__.py"}


def test_docstrings_of_packages_name_modules_that_exist() -> None:
    """A map that names a module which was renamed misleads whoever follows it."""
    missing = {
        f"{path.relative_to(ROOT)}: {name}"
        for path in files_of("jaxcslc")
        if path.name == "__init__.py"
        for name in modules_named(ast.get_docstring(ast.parse(path.read_text("utf-8"))) or "")
        if not any(path.parent.rglob(f"{name}.py"))
    }
    assert missing == set()


def modules_named(text: str) -> set[str]:
    return set(re.findall(r"(?<![\w.])_[a-z]\w+", text))


def test_modules_are_found_in_text() -> None:
    assert modules_named("`_search`: a loop. a._b ──► _band") == {"_search", "_band"}
