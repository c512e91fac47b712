"""The examples of the README, and those of pages that promise to run, run as they stand."""

import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.cli._app import command_named
from tests.conftest import run
from tests.test_examples import assert_truth_is_found
from tests.test_tutorial import is_shown


ROOT = Path(__file__).parents[1]


def examples_of(page: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", (ROOT / page).read_text("utf-8"), re.DOTALL)


def test_the_example_of_the_readme_runs(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (example,) = examples_of("README.md")
    exec(compile(example, "README.md", "exec"), {})
    report = capsys.readouterr().out
    assert "kB40" in report and "torque error" in report


def test_each_example_of_networks_runs_by_itself(
    capsys: pytest.CaptureFixture[str],
) -> None:
    printed: list[str] = []
    for example in examples_of("docs/networks.md"):
        exec(compile(example, "docs/networks.md", "exec"), {})
        printed.append(capsys.readouterr().out)
    training, size, order, computed, reidentified, several, side_by_side = printed
    assert "stop set" in training or "not ended" in training
    assert size == "25 21 ('network 1', 'network 2')\n"
    assert order == "43 28 8\n"
    errors = [float(error) for error in re.findall(r"weights: (\S+) m/s", computed)]
    assert len(errors) == 2 and errors[0] < errors[1] / 2
    assert float(reidentified) < 1e-3
    assert "8 of 25 weights" in several
    assert "8 of 43 weights: 8 no further reduction" in side_by_side
    assert float(side_by_side.split()[-3]) < 0.01  # N m between trained and solved


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


def test_the_page_of_programs_lists_every_study_and_the_index_every_page() -> None:
    text = (ROOT / "scripts" / "README.md").read_text("utf-8")
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


def test_the_commands_of_the_readme_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Line by line: the first block as it stands, the second with an arm and its logs."""
    monkeypatch.chdir(tmp_path)
    made = jc.examples.write_example("panda", tmp_path / "own")
    names = jc.load_robot(made.robot).joint_names
    for name, path in (("log", made.train), ("other", made.validation)):
        dense = jc.load_recording(path, joints=7)
        columns = [dense.time[::5], *dense.position[::5].T, *dense.torque[::5].T]
        header = ["t", *(f"{what} of {joint}" for what in ("angle", "moment") for joint in names)]
        np.savetxt(f"{name}.csv", np.stack(columns, 1), delimiter=",", header=",".join(header))
    shutil.copy(made.robot, "arm.urdf")
    printed: list[str] = []
    for line in command_lines():
        if "excite" in line:  # half a minute; its own tests run it
            continue
        monkeypatch.chdir(tmp_path / "panda" if " panda.urdf" in line else tmp_path)
        result = run(*shlex.split(line, comments=True)[1:])
        assert result.exit_code == 0, f"{line}: {result.output} {result.exception}"
        printed += result.output.splitlines()
    assert "mass value" in Path("arm_identified.urdf").read_text()
    assert Path("arm.c").exists() and Path("panda/results/index.html").exists()
    inside = assert_truth_is_found(tmp_path / "panda")
    assert all(inside), "the README says so"
    assert f"all {len(inside)} intervals" in (ROOT / "README.md").read_text("utf-8")
    (shown,) = re.findall(r"```text\n(.*?)```", (ROOT / "README.md").read_text("utf-8"), re.DOTALL)
    assert [line for line in shown.splitlines() if not is_shown(line, printed)] == []


def test_the_check_that_the_page_shows_is_what_it_prints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The log of an example whose elbow torque has the other sign."""
    monkeypatch.chdir(tmp_path)
    made = jc.examples.write_example("ur5", "ur5")
    header, *rows = (line.split(",") for line in made.train.read_text().splitlines())
    elbow = header.index("actual_current_as_torque_2")
    for row in rows:
        row[elbow] = str(-float(row[elbow]))
    Path("sign.csv").write_text("\n".join(",".join(row) for row in (header, *rows)))
    printed = run("check", str(made.robot), "sign.csv").output.splitlines()
    page = (ROOT / "docs" / "checks.md").read_text("utf-8")
    (shown,) = re.findall(r"```text\n(.*?)```", page, re.DOTALL)
    assert [line for line in shown.splitlines() if not is_shown(line, printed)] == []


def test_the_commands_of_the_readme_have_their_options() -> None:
    """Every line names a command and options that exist."""
    lines = command_lines()
    assert len(lines) >= 6
    for line in lines:
        _, command, *arguments = shlex.split(line, comments=True)
        known = {name for some in command_named(command).parameters for name in some.names}
        used = {argument for argument in arguments if argument.startswith("-")}
        assert used <= known, line
