"""Names and comments of generated C that are made of texts of strangers."""

import dataclasses
import re
import shutil
import subprocess
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.codegen import comment_text, identifier, is_identifier
from jaxcslc.excitation._output import c_text


PIECES = (
    *("*", "/", "*/", "/*", "\\", "\n", "\r", "?", "??/", '"', "'", "#", "%s", "{", "}", ";"),
    *("6", "arm", "ROBOT", "int", "return", "math", " ", "\t", "\0", "\x1b[2J", "²", "ü", "𝑞", " "),
    *("#include </etc/passwd>", "int injected(void){return 1;}", "\u2028", "\x85", "_", "-"),
)
NAMES = ("", "6dof arm", "**/ /", "*\\", "*\\\n/ int injected; /*", "/*/", "*??/\n/", "int", "math")


def hostile_names(count: int, rng: np.random.Generator) -> list[str]:
    lengths = rng.integers(0, 8, count)
    return [*NAMES, *("".join(rng.choice(PIECES, length)) for length in lengths)]


def compiled(source: str, folder: Path) -> list[str]:
    """Compile C with all warnings as errors; return the symbols that it defines."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("cc: there is no C compiler")
    (folder / "code.c").write_text(source, encoding="ascii")
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wno-unused", "-trigraphs"]
    command = [compiler, *flags, "-c", "code.c", "-o", "code.o"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    listed = subprocess.run(
        ["nm", "code.o"], cwd=folder, check=True, capture_output=True, text=True
    )
    return [line.split()[-1] for line in listed.stdout.splitlines() if " U " not in line]


def test_ten_thousand_hostile_comments_and_names(tmp_path: Path, rng: np.random.Generator) -> None:
    lines: list[str] = []
    for number, name in enumerate(hostile_names(10_000, rng)):
        text, made = comment_text(name), identifier(name)
        assert re.fullmatch("[ -~]*", text)
        assert is_identifier(made)
        lines += [f"/* {text}", f"{text} */", f"int {made}_{number}(void);"]
    lines += ["int documented(void);", "int documented(void) { return 0; }"]
    assert compiled("\n".join(lines), tmp_path) == ["documented"]


@pytest.mark.parametrize("name", NAMES)
def test_files_of_a_robot_with_a_hostile_name(name: str, tmp_path: Path) -> None:
    robot = dataclasses.replace(jc.examples.pendulum(), name=name)
    network = jc.derive(robot, lengths="numeric")
    code = jc.c_code(network, jnp.array([0.5, 0.3, 0.0, 0.2, 0.05]))
    symbols = compiled(code.source.replace(f'#include "{code.name}.h"', code.header), tmp_path)
    assert {symbol for symbol in symbols if not symbol.endswith("_of")} == {
        f"{code.name}_{operation}" for operation in code.operations
    }
    time = np.arange(3) * 0.1
    assert compiled(c_text(network, time, time[:, None]), tmp_path) in (
        [],
        [f"{identifier(name)}_motion"],
    )
