"""Functions of the command stay short."""

import ast
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
