"""The examples of the README, and those of pages that promise to run, run as they stand."""

import re
import shlex
import shutil
from pathlib import Path
from typing import Any, cast

import click
import numpy as np
import pytest
import typer

import jaxcslc as jc
from jaxcslc.cli._app import app
from tests.conftest import run


ROOT = Path(__file__).parents[1]


def examples_of(page: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", (ROOT / page).read_text("utf-8"), re.DOTALL)


def test_the_examples_of_the_readme_run_and_agree(capsys: pytest.CaptureFixture[str]) -> None:
    """`identify` and the way step by step give the same coefficients."""
    names: dict[str, Any] = {}
    steps: dict[str, Any] = {}
    at_once, by_steps = examples_of("README.md")
    exec(compile(at_once, "README.md", "exec"), names)
    report = capsys.readouterr().out
    assert "kM26" in report and "torque error" in report
    exec(compile(by_steps, "README.md", "exec"), steps)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 43
    assert lines[25].startswith("kM26 = ") and lines[25].endswith("kg m²")
    np.testing.assert_allclose(steps["fit"].k, names["report"].k, rtol=1e-12, atol=1e-15)


def test_each_example_of_networks_runs_by_itself(
    capsys: pytest.CaptureFixture[str],
) -> None:
    printed: list[str] = []
    for example in examples_of("docs/networks.md"):
        exec(compile(example, "docs/networks.md", "exec"), {})
        printed.append(capsys.readouterr().out)
    training, size, order, computed, reidentified, several, side_by_side, pruned = printed
    assert "stop set" in training or "not ended" in training
    assert size == "25 21 ('network 1', 'network 2')\n"
    assert order == "43 28 8\n"
    errors = [float(error) for error in re.findall(r"weights: (\S+) m/s", computed)]
    assert len(errors) == 2 and errors[0] < errors[1] / 2
    assert float(reidentified) < 1e-3
    assert "8 of 25 weights" in several
    assert "8 of 43 weights: 8 no further reduction" in side_by_side
    assert float(side_by_side.split()[-3]) < 0.01  # N m between trained and solved
    assert re.search(r"of 25 weights removed", pruned)


def test_each_example_of_friction_runs_by_itself(
    capsys: pytest.CaptureFixture[str],
) -> None:
    printed: list[str] = []
    for example in examples_of("docs/friction.md"):
        exec(compile(example, "docs/friction.md", "exec"), {})
        printed.append(capsys.readouterr().out)
    names, load, pre_sliding, slopes, reidentified = printed
    assert 0.018 < float(pre_sliding[1:].split("]")[0]) < 0.022
    assert names == "('ks6', 'kvp3', 'kvn3')\n"
    assert load.startswith("[ 0.5") and "0.15" in load
    assert slopes.startswith("[5.")
    assert "0.03" in reidentified  # dry friction of 0.05, cleaned


def test_each_example_of_payload_runs_by_itself(
    capsys: pytest.CaptureFixture[str],
) -> None:
    printed: list[str] = []
    for example in examples_of("docs/payload.md"):
        exec(compile(example, "docs/payload.md", "exec"), {})
        printed.append(capsys.readouterr().out)
    assert "'pIxx', " in printed[0]
    assert "PayloadFit(1.5" in printed[1] and "LinkParameters(" in printed[1]


def test_each_example_of_control_runs_by_itself(
    capsys: pytest.CaptureFixture[str],
) -> None:
    printed: list[str] = []
    for example in examples_of("docs/control.md"):
        exec(compile(example, "docs/control.md", "exec"), {})
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


def command_lines() -> list[str]:
    """Every `jaxcslc` line of the README's shell blocks."""
    blocks = re.findall(r"```sh\n(.*?)```", (ROOT / "README.md").read_text("utf-8"), re.DOTALL)
    return [line for line in "".join(blocks).splitlines() if "jaxcslc " in line]


RATES = np.array([1.9, 3.1])  # of two joints [rad/s]
ARM = """gravity = [0, -9.81, 0]
[[joint]]
link = { mass = 2.0, centre_of_gravity = [0.2, 0, 0], inertia_tensor = [0.02, 0.03, 0.03] }
[[joint]]
a = 0.4
link = { mass = 1.0, centre_of_gravity = [0.15, 0, 0], inertia_tensor = [0.01, 0.02, 0.02] }
"""
LIMITS = "[joints]\nposition = [-2, 2]\nvelocity = 4\ntorque = 60\n"
PANDA = """<robot name="panda"><link name="panda_link0"/>
<link name="panda_link8"><inertial><mass value="1"/><origin xyz="0.1 0 0"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j" type="continuous"><parent link="panda_link0"/><child link="panda_link8"/>
<axis xyz="0 1 0"/></joint></robot>"""


def prepare_folder(folder: Path) -> None:
    """The robots and recordings that the README's lines name, small ones."""
    (folder / "arm.toml").write_text(ARM)
    (folder / "panda.urdf").write_text(PANDA)
    (folder / "limits.toml").write_text(LIMITS)
    network = jc.derive(jc.load_robot(folder / "arm.toml"), lengths="numeric")
    network = network.with_payload()
    time = 0.01 * np.arange(1500)
    for seed, (name, mass) in enumerate((("train", 0.0), ("validation", 0.0), ("loaded", 1.5))):
        rng = np.random.default_rng(seed)
        angle = np.outer(time, RATES) + seed
        q, qd = 1.2 * np.sin(angle), 1.2 * RATES * np.cos(angle)
        qdd = -(RATES**2) * q
        body = jc.LinkParameters(mass, np.array([0.3, 0.0, 0.0]), np.zeros((3, 3)))
        links = network.robot.links or ()
        k = network.coefficients_from(links, payload=body, viscous=[0.5, 0.3], dry=[0.4, 0.2])
        torque = np.asarray(network.torque(k, q, qd, qdd)) + 0.01 * rng.standard_normal(q.shape)
        jc.save_recording(jc.Recording(time, q, torque), folder / f"{name}.csv")


def test_the_commands_of_the_readme_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Line by line in one folder, where robots and recordings of these names are."""
    prepare_folder(tmp_path)
    monkeypatch.chdir(tmp_path)
    for line in command_lines():
        arguments = shlex.split(line, comments=True)[1:]
        if arguments[0] == "compare":
            shutil.copytree("results", "results_friday")
        if "build/demo" in line:  # of a demo that takes minutes
            continue
        result = run(*arguments)
        assert result.exit_code == 0, f"{line}: {result.output} {result.exception}"
    for name in (
        "comparison.html",
        "arm_identified.toml",
        "arm.c",
        "motion.csv",
        "payload/payload.json",
    ):
        assert Path(name).exists(), name


def test_the_commands_of_the_readme_have_their_options() -> None:
    """Every line names a command and options that exist."""
    commands = cast("click.Group", typer.main.get_command(app)).commands
    lines = command_lines()
    assert len(lines) >= 6
    for line in lines:
        _, command, *arguments = shlex.split(line, comments=True)
        known = {name for option in commands[command].params for name in option.opts}
        used = {argument for argument in arguments if argument.startswith("-")}
        assert used <= known, line
