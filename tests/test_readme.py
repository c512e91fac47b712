"""The examples of the README, and those of pages that promise to run, run as they stand."""

import re
import shlex
from pathlib import Path
from typing import Any, cast

import click
import numpy as np
import pytest
import typer

from jaxcslc.cli._app import app


ROOT = Path(__file__).parents[1]


def examples_of(page: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", (ROOT / page).read_text("utf-8"), re.DOTALL)


def test_the_examples_of_the_readme_run_and_agree(capsys: pytest.CaptureFixture[str]) -> None:
    """`identify` and the way step by step give the same coefficients."""
    names: dict[str, Any] = {}
    at_once, by_steps = examples_of("README.md")
    exec(compile(at_once, "README.md", "exec"), names)
    report = capsys.readouterr().out
    assert "kM26" in report and "torque error" in report
    exec(compile(by_steps, "README.md", "exec"), names)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 43
    assert lines[25].startswith("kM26 = ") and lines[25].endswith("kg m²")
    np.testing.assert_allclose(names["fit"].k, names["report"].k, rtol=1e-12, atol=1e-15)


def test_the_examples_of_networks_run_one_after_the_other(
    capsys: pytest.CaptureFixture[str],
) -> None:
    namespace: dict[str, object] = {}
    printed: list[str] = []
    for example in examples_of("docs/networks.md"):
        exec(compile(example, "docs/networks.md", "exec"), namespace)
        printed.append(capsys.readouterr().out)
    training, size, reidentified, several, pruned = printed
    assert "stop set" in training or "not ended" in training
    assert size == "25 21 ('network 1', 'network 2')\n"
    assert float(reidentified) < 1e-3
    assert "8 of 25 weights" in several
    assert re.search(r"of 25 weights removed", pruned)


def test_the_examples_of_friction_run_one_after_the_other(
    capsys: pytest.CaptureFixture[str],
) -> None:
    namespace: dict[str, object] = {}
    printed: list[str] = []
    for example in examples_of("docs/friction.md"):
        exec(compile(example, "docs/friction.md", "exec"), namespace)
        printed.append(capsys.readouterr().out)
    names, slopes, reidentified = printed
    assert names == "('ks6', 'kvp3', 'kvn3')\n"
    assert slopes.startswith("[5.")
    assert "0.03" in reidentified  # dry friction of 0.05, cleaned


def test_the_examples_of_payload_run_one_after_the_other(
    capsys: pytest.CaptureFixture[str],
) -> None:
    namespace: dict[str, object] = {}
    printed: list[str] = []
    for example in examples_of("docs/payload.md"):
        exec(compile(example, "docs/payload.md", "exec"), namespace)
        printed.append(capsys.readouterr().out)
    assert "'pIxx', " in printed[0]
    assert "PayloadFit(1.5" in printed[1] and "LinkParameters(" in printed[1]


def test_the_examples_of_control_run_one_after_the_other(
    capsys: pytest.CaptureFixture[str],
) -> None:
    namespace: dict[str, object] = {}
    printed: list[str] = []
    for example in examples_of("docs/control.md"):
        exec(compile(example, "docs/control.md", "exec"), namespace)
        printed.append(capsys.readouterr().out)
    torque, off, faults = printed
    assert torque.startswith("[") and off.count("off by at most 0.00") == 2
    assert faults == "('joint 3: lost samples, detected at 0.010 s',)\n"


def test_the_readme_lists_every_study_and_the_index_every_page() -> None:
    text = (ROOT / "README.md").read_text("utf-8")
    studies = (ROOT / "scripts" / "studies").glob("*/study.py")
    assert [
        path.parent.name for path in studies if f"{path.parent.name}/study.py" not in text
    ] == []
    index = (ROOT / "docs" / "index.md").read_text("utf-8")
    pages = {path.name for path in (ROOT / "docs").glob("*.md")} - {"index.md"}
    assert {page for page in pages if f"({page})" not in index} == set()


def test_the_commands_of_the_readme_have_their_options() -> None:
    """Every `jaxcslc` line of the README's shell blocks names a command and options that exist."""
    commands = cast("click.Group", typer.main.get_command(app)).commands
    blocks = re.findall(r"```sh\n(.*?)```", (ROOT / "README.md").read_text("utf-8"), re.DOTALL)
    lines = [line for line in "".join(blocks).splitlines() if "jaxcslc " in line]
    assert len(lines) >= 6
    for line in lines:
        _, command, *arguments = shlex.split(line, comments=True)
        known = {name for option in commands[command].params for name in option.opts}
        used = {argument for argument in arguments if argument.startswith("-")}
        assert used <= known, line
