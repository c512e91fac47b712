"""The tutorial's commands run one after the other, and print what the page says they print."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.cli._example import next_commands
from tests.conftest import run
from tests.test_examples import assert_truth_is_found


PAGE = (Path(__file__).parents[1] / "docs" / "tutorial.md").read_text("utf-8")
NUMBER = r"-?\d+(\.\d+)?(e[-+]?\d+)?"
# A minute: its own tests run it. What the page has of it is compared with the report that it reads.
ELSEWHERE = "jaxcslc excite"


def steps() -> Iterator[tuple[str, str]]:
    """Commands, and the texts that follow them."""
    command = ""
    for kind, block in re.findall(r"```(sh|text|python)\n(.*?)```", PAGE, re.DOTALL):
        if kind != "text":
            command = block if kind == "sh" else ""
        elif command:
            yield command, block


def skeleton(text: str) -> str:
    """Text with each number as one sign and each run of spaces as one."""
    return re.sub(r"\s+", " ", re.sub(NUMBER, "#", text)).strip()


def numbers(text: str) -> list[float]:
    """Every number of a text, in order."""
    return [float(match[0]) for match in re.finditer(NUMBER, text)]


def is_shown(line: str, printed: list[str]) -> bool:
    """Return whether a line was printed: the same words, and the same numbers within a tenth."""
    same = (other for other in printed if skeleton(other) == skeleton(line))
    return any(np.allclose(numbers(line), numbers(other), rtol=0.1, atol=1e-9) for other in same)


def write_in_degrees(source: Path, target: Path) -> None:
    """Write the log of `source` with its positions in degrees."""
    header, *rows = (line.split(",") for line in source.read_text().splitlines())
    values = np.array(rows, dtype=float)
    positions = [name.startswith("actual_q_") for name in header]
    values[:, positions] = np.degrees(values[:, positions])
    np.savetxt(target, values, delimiter=",", header=",".join(header), comments="")


def test_the_tutorial(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    printed: dict[str, str] = {}
    for block in re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL):
        for line in block.splitlines():
            program, *arguments = shlex.split(line)
            if program == "cd":
                monkeypatch.chdir(arguments[0])
            elif ELSEWHERE not in line:
                result = run(*arguments)
                assert result.exit_code == 0, result.output
                printed[block] = printed.get(block, "") + result.output
    following = next_commands(Path("ur5"), "ur5.urdf")
    assert {command for command in following if command not in PAGE} == set()
    assert_truth_is_found(Path())
    write_in_degrees(Path("train.csv"), Path("degrees.csv"))
    spoilt = run("check", "ur5.urdf", "degrees.csv").output
    for command, text in steps():
        if ELSEWHERE in command:
            report = jc.load_report("results")
            for name, percent in re.findall(r"(k[A-Za-z]+\d+): standard error (\S+) %", text):
                entry = report[name]
                shown_error = 100 * float(entry["standard_error"]) / abs(entry.value)
                assert shown_error == pytest.approx(float(percent), rel=0.1), name
            continue
        shown = printed[command] + spoilt * (" check " in command)
        for line in text.splitlines():
            assert is_shown(line, shown.splitlines()), line
    names: dict[str, Any] = {}
    comparison, prediction = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    exec(compile(comparison, "tutorial.md", "exec"), names)
    assert f"{names['inside']} of {len(names['truth'])} true values" in PAGE
    exec(compile(prediction, "tutorial.md", "exec"), names)
    assert np.all(np.isfinite(names["torque"]))
