"""Ctrl-C ends programs of `scripts` in one line, from their first import on."""

import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    ("program", "code", "words"),
    [
        ("import scripts; raise KeyboardInterrupt", 130, "interrupted"),
        (
            "import scripts; raise ImportError('extension') from KeyboardInterrupt()",
            130,
            "interrupted",
        ),
        ("import scripts; raise ValueError('what')", 1, "ValueError: what"),
    ],
)
def test_what_a_program_prints(program: str, code: int, words: str) -> None:
    """Errors other than an interruption keep their traceback."""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == code and words in done.stderr
    assert ("Traceback" in done.stderr) == (code == 1)
