"""The tutorial's commands run one after the other, and print what the page says they print."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.conftest import run


PAGE = (Path(__file__).parents[1] / "docs" / "tutorial.md").read_text("utf-8")
# As slow as everything else together; other tests run these commands on smaller robots.
ELSEWHERE = ("excite", "results_offset", "results_static")


def steps() -> Iterator[tuple[str, str]]:
    """Commands, and the texts that follow them."""
    blocks = re.findall(r"```(sh|text)\n(.*?)```", PAGE, re.DOTALL)
    command = ""
    for kind, block in blocks:
        if kind == "sh":
            command = block
        else:
            yield command, block


def skeleton(text: str) -> str:
    """Text with each number as one sign and each run of spaces as one."""
    return re.sub(r"\s+", " ", re.sub(r"-?\d+(\.\d+)?(e[-+]?\d+)?", "#", text)).strip()


def test_the_tutorial(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (recordings, control) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    exec(compile(recordings, "tutorial.md", "exec"), {})
    printed: dict[str, str] = {}
    for block in re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL):
        for line in block.splitlines():
            if not any(word in line for word in ELSEWHERE):
                result = run(*line.split()[1:])
                assert result.exit_code == 0, result.output
                printed[block] = printed.get(block, "") + result.output
    assert sum(bool(output) for output in printed.values()) == 4
    for command, text in steps():
        lines = [skeleton(line) for line in printed[command].splitlines()]
        for line in text.splitlines():
            # What another recording would have printed, shown beside.
            assert skeleton(line) in lines or "in degrees" in line, line
    exec(compile(control, "tutorial.md", "exec"), {})
