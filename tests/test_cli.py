"""The command line: what it writes, and what it says of wrong input."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import jaxcslc as jc
import sim
from jaxcslc.manipulator import fixed_together
from jaxcslc.report import compare_reports
from scripts.tools.invoke import Result
from tests.conftest import run


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Short training and comparison recordings of the simulated PUMA 560, as CSV."""
    folder = tmp_path_factory.mktemp("recordings")
    machine = sim.puma560()
    paths = folder / "train.csv", folder / "compare.csv"
    for path, trajectory in zip(paths, (sim.training(), sim.comparison()), strict=True):
        jc.save_recording(sim.simulate(machine, trajectory, seed=3).recording, path)
    return paths


@pytest.fixture(scope="module")
def identified(
    recordings: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Result, Path]:
    output = tmp_path_factory.mktemp("identify") / "results"
    train, compare = recordings
    return run("identify", "puma560", train, "--validate", compare, "-o", output), output


class TestIdentify:
    def test_prints_coefficients_and_errors(self, identified: tuple[Result, Path]) -> None:
        result, _ = identified
        assert result.exit_code == 0, result.output
        for text in ("settings: ", "kM26", "kd6", "determined", "rank 49 of 49", "RMS error"):
            assert text in result.output

    def test_writes_what_a_user_goes_on_with(self, identified: tuple[Result, Path]) -> None:
        _, output = identified
        names = {path.name for path in output.iterdir()} - {".jaxcslc"}
        assert names == {
            *("index.html", "coefficients.csv", "identification.json", "charts.json"),
            *("errors_training.csv", "torque_training.csv"),
            *("errors_validation.csv", "torque_validation.csv"),
        }
        document = json.loads((output / "identification.json").read_text())
        assert len(document["k"]) == len(document["names"]) == 49
        assert np.shape(document["covariance"]) == (49, 49)
        rms = np.array(document["torque_error_rms"]["validation"])
        assert np.all(rms < [1.0, 1.5, 0.8, 0.3, 0.3, 0.3])
        for name in ("training", "validation"):
            table = np.genfromtxt(output / f"torque_{name}.csv", delimiter=",", names=True)
            error = table["measured_1"] - table["predicted_1"]
            kept = error[table["mask_1"] > 0]
            assert np.sqrt(np.mean(kept**2)) == pytest.approx(
                document["torque_error_rms"][name][0], rel=1e-6
            )

    def test_page_says_how_to_repeat_it(
        self, identified: tuple[Result, Path], recordings: tuple[Path, Path]
    ) -> None:
        _, output = identified
        page = (output / "index.html").read_text("utf-8")
        train, compare = recordings
        assert f"jaxcslc identify puma560 {train} --validate {compare} -o {output}" in page
        assert "Identification of PUMA 560" in page and "trials" in page

    def test_a_result_agrees_with_itself(
        self, identified: tuple[Result, Path], tmp_path: Path
    ) -> None:
        _, output = identified
        result = run("compare", output, output, "-o", tmp_path / "same.html")
        assert result.exit_code == 0, result.output
        assert "agree within their uncertainty" in result.output
        assert "kM26" in (tmp_path / "same.html").read_text("utf-8")
        for wrong in ([output, tmp_path / "none"], [output, output, "-o", tmp_path]):
            refused = run("compare", *wrong)
            assert refused.exit_code == 2 and len(refused.stderr.strip().splitlines()) == 1

    def test_settings_can_be_passed(
        self, identified: tuple[Result, Path], recordings: tuple[Path, Path], tmp_path: Path
    ) -> None:
        """The settings that one run printed give the same coefficients in the next."""
        _, output = identified
        before = json.loads((output / "identification.json").read_text())
        repeated = run(
            *("identify", "puma560", recordings[0], "-o", tmp_path / "again"),
            *("--settings", output / "identification.json"),
        )
        assert repeated.exit_code == 0, repeated.output
        after = json.loads((tmp_path / "again" / "identification.json").read_text())
        np.testing.assert_allclose(after["k"], before["k"], rtol=1e-9, atol=1e-12)
        assert after["settings"] == before["settings"]


class TestExport:
    def test_writes_the_robot_back(self, identified: tuple[Result, Path], tmp_path: Path) -> None:
        """A copy of the robot's file whose numbers are possible and were identified."""
        _, output = identified
        path = tmp_path / "mine.toml"
        result = run("export", "puma560", output / "identification.json", "-o", path)
        assert result.exit_code == 0, result.output
        for text in ("cost of physical consistency", "standard errors", "read again", str(path)):
            assert text in result.output
        robot = jc.load_robot(path)
        assert robot.links is not None and robot.viscous is not None
        for link in robot.links:
            moments = np.sort(np.diag(np.asarray(link.inertia)))
            assert float(link.mass) > 0 and 0 < moments[2] < moments[0] + moments[1]
        identified_k = json.loads((output / "identification.json").read_text())
        index = identified_k["names"].index("kv2")
        assert robot.viscous[1] == pytest.approx(identified_k["k"][index], rel=0.1)
        source = path.read_text()
        assert "# The principal-axis substitution" in source and "[numbering" in source

    def test_writes_c(self, identified: tuple[Result, Path], tmp_path: Path) -> None:
        _, output = identified
        path = tmp_path / "controller.c"
        result = run("export", "puma560", output / "identification.json", "--c", "-o", path)
        assert result.exit_code == 0, result.output
        assert "operations: torque" in result.output
        assert '#include "controller.h"' in path.read_text()
        assert "void puma_560_torque(" in path.with_suffix(".h").read_text()

    @pytest.mark.parametrize(
        ("robot", "name", "words"),
        [
            ("panda", "identification.json", ["expected an identification of this robot"]),
            ("puma560", "none.json", ["none.json", "no such identification"]),
            ("puma560", "coefficients.csv", ["coefficients.csv", "not valid JSON"]),
        ],
    )
    def test_wrong_input_gets_one_line(
        self,
        robot: str,
        name: str,
        words: list[str],
        identified: tuple[Result, Path],
        tmp_path: Path,
    ) -> None:
        _, output = identified
        result = run("export", robot, output / name, "-o", tmp_path / "out.toml")
        assert result.exit_code == 2
        (line,) = result.stderr.strip().splitlines()
        for word in words:
            assert word in line
        assert list(tmp_path.iterdir()) == []

    def test_a_name_of_another_kind(self, identified: tuple[Result, Path], tmp_path: Path) -> None:
        _, output = identified
        for extra, wrong in (([], "out.urdf"), (["--c"], "out.toml")):
            result = run(
                *("export", "puma560", output / "identification.json", *extra),
                *("-o", tmp_path / wrong),
            )
            assert result.exit_code == 2 and "expected a name ending in" in result.stderr
        assert list(tmp_path.iterdir()) == []


class TestReidentify:
    def test_friction_alone(
        self, identified: tuple[Result, Path], recordings: tuple[Path, Path], tmp_path: Path
    ) -> None:
        """From the first second: the rest of the coefficients is as it was, errors included."""
        cells = _cells(recordings[0])
        _write(tmp_path / "short.csv", cells[:500])
        document_path = identified[1] / "identification.json"
        result = run(
            *("identify", "puma560", tmp_path / "short.csv", "--reidentify", "viscous, dry"),
            *("--previous", document_path, "--validate", recordings[1], "-o", tmp_path / "out"),
        )
        assert result.exit_code == 0, result.output
        for text in ("re-identified: viscous, dry", "rank 12 of 12", "before", "validation RMS"):
            assert text in result.output
        before, after = (
            jc.Identification.load(path)
            for path in (document_path, tmp_path / "out" / "identification.json")
        )
        layout = jc.derive(jc.puma560()).layout
        rigid, friction = layout.inertial, layout.friction
        np.testing.assert_array_equal(after.k[rigid], before.k[rigid])
        np.testing.assert_allclose(after.standard_error[rigid], before.standard_error[rigid])
        assert np.all(np.abs(after.k[friction] / before.k[friction] - 1) < 0.1)
        assert not np.any(after.k[friction] == before.k[friction])
        compared = compare_reports(identified[1], tmp_path / "out")
        assert sum(row["standard_errors"] is not None for row in compared.rows) == 12
        _, _, messages = compared.verdict
        texts = [message.text for message in messages]
        assert any("of 12 coefficients differ" in text for text in texts)
        assert any(text.startswith("37 coefficients were not tested") for text in texts)
        assert not any("cannot be compared" in text for text in texts)

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            (["--reidentify", "viscous"], ["--reidentify and --previous", "both or neither"]),
            (["--previous", "KNOWN"], ["--reidentify and --previous", "both or neither"]),
            (["--possible", "often"], ["--physical: expected auto, always, never, got 'often'"]),
            (["--prior", "none.toml"], ["none.toml", "no such"]),
            (["--estimator", "both"], ["--estimator: expected least-squares, maximum-likelihood"]),
            (["--reidentify", "oil", "--previous", "KNOWN"], ["'oil'", "viscous, dry"]),
            (["--reidentify", "dry", "--previous", "none.json"], ["none.json", "no such"]),
            (
                ["--reidentify", "dry", "--previous", "KNOWN", "--friction", "dry"],
                ["not with --previous"],
            ),
        ],
    )
    def test_wrong_input_gets_one_line(
        self,
        options: list[str],
        words: list[str],
        identified: tuple[Result, Path],
        recordings: tuple[Path, Path],
        tmp_path: Path,
    ) -> None:
        document_path = str(identified[1] / "identification.json")
        arguments = [document_path if option == "KNOWN" else option for option in options]
        result = run("identify", "puma560", recordings[1], *arguments, "-o", tmp_path / "o")
        assert result.exit_code == 2
        (line,) = result.stderr.strip().splitlines()
        for word in words:
            assert word in line
        assert not (tmp_path / "o").exists()


@pytest.fixture(scope="module")
def loaded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three seconds of the training trajectory with 1.5 kg fixed to the last link."""
    machine = sim.puma560()
    body = jc.LinkParameters(1.5, np.array([0.02, 0.0, 0.1]), 3e-3 * np.eye(3))
    assert machine.robot.links is not None
    links = (*machine.robot.links[:-1], fixed_together([machine.robot.links[-1], body]))
    robot = dataclasses.replace(machine.robot, links=links)
    carrying = dataclasses.replace(machine, robot=robot)
    path = tmp_path_factory.mktemp("loaded") / "loaded.csv"
    performed = sim.simulate(carrying, sim.training(samples=1500), seed=5)
    jc.save_recording(performed.recording, path)
    return path


class TestPayload:
    @pytest.mark.parametrize("together", [False, True])
    def test_finds_the_payload(
        self,
        together: bool,
        loaded: Path,
        identified: tuple[Result, Path],
        recordings: tuple[Path, Path],
        tmp_path: Path,
    ) -> None:
        result = run(
            *("payload", "puma560", loaded, "--previous", identified[1] / "identification.json"),
            *(("--unloaded", recordings[0]) if together else ()),
            *("-o", tmp_path / "out"),
        )
        assert result.exit_code == 0, result.output
        for text in ("10 payload", "possible", "without the payload's part", "95 % intervals"):
            assert text in result.output
        document = json.loads((tmp_path / "out" / "payload.json").read_text())
        physical = document["physical"]
        assert physical["m"]["value"] == pytest.approx(1.5, rel=0.02)
        assert physical["rz"]["value"] == pytest.approx(0.1, abs=2e-3)
        assert physical["m"]["low"] < physical["m"]["value"] < physical["m"]["high"]
        assert np.shape(document["covariance"]) == (10, 10)
        for error, more in zip(*document["torque_error_rms"].values(), strict=True):
            assert error < more
        header, *lines = (tmp_path / "out" / "payload.csv").read_text().splitlines()
        assert header == "name,unit,value,standard_error,low,high,possible" and len(lines) == 10

    def test_wrong_input_gets_one_line(
        self, loaded: Path, identified: tuple[Result, Path], tmp_path: Path
    ) -> None:
        document_path = identified[1] / "identification.json"
        for arguments, words in (
            (
                ["panda", loaded, "--previous", document_path],
                ["expected an identification of this robot"],
            ),
            (["puma560", tmp_path / "none.csv", "--previous", document_path], ["none.csv"]),
            (["puma560", loaded, "--previous", tmp_path / "no.json"], ["no.json", "no such"]),
            (["puma560", loaded, "--previous", loaded], ["loaded.csv", "not valid JSON"]),
        ):
            result = run("payload", *arguments, "-o", tmp_path / "o")
            assert result.exit_code == 2
            (line,) = result.stderr.strip().splitlines()
            for word in words:
                assert word in line
        assert not (tmp_path / "o").exists()


def _cells(path: Path) -> list[list[str]]:
    return [line.split(",") for line in path.read_text().splitlines()]


def _write(path: Path, cells: list[list[str]]) -> None:
    path.write_text("\n".join(",".join(row) for row in cells) + "\n")


def _drop_column(cells: list[list[str]]) -> list[list[str]]:
    at = cells[0].index("position_3")
    return [row[:at] + row[at + 1 :] for row in cells]


def _extra_column(cells: list[list[str]]) -> list[list[str]]:
    return [[*row, "temperature" if i == 0 else "20"] for i, row in enumerate(cells)]


def _cell(row: int, column: str, text: str) -> Callable[[list[list[str]]], list[list[str]]]:
    def change(cells: list[list[str]]) -> list[list[str]]:
        cells[row][cells[0].index(column)] = text
        return cells

    return change


def _fewer_joints(cells: list[list[str]]) -> list[list[str]]:
    kept = [i for i, name in enumerate(cells[0]) if not name.endswith(("_5", "_6"))]
    return [[row[i] for i in kept] for row in cells]


def _standing_still(cells: list[list[str]]) -> list[list[str]]:
    header, first, *others = cells
    stamp = header.index("time")
    return [header, first, *([*first[:stamp], row[stamp], *first[stamp + 1 :]] for row in others)]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        pytest.param(_drop_column, ["position_3"], id="missing column"),
        pytest.param(_extra_column, ["temperature"], id="extra column"),
        pytest.param(_cell(10, "torque_2", "fast"), ["torque_2", "row 10", "fast"], id="text"),
        pytest.param(_cell(12, "position_1", "nan"), ["position_1", "row 12"], id="NaN"),
        pytest.param(_cell(20, "time", "0.0001"), ["time", "row 20"], id="time goes back"),
        pytest.param(
            lambda cells: [*cells[:30], cells[29], *cells[30:]], ["row 30"], id="repeated row"
        ),
        pytest.param(
            _fewer_joints, ["4 position columns", "expected 6"], id="wrong number of joints"
        ),
        pytest.param(lambda cells: cells[:1], ["rows"], id="no rows"),
        pytest.param(
            _standing_still,
            ["none is above the friction threshold at joint 1"],
            id="nothing left after masking",
        ),
    ],
)
def test_a_wrong_recording_gets_one_line_and_leaves_results_alone(
    change: Callable[[list[list[str]]], list[list[str]]],
    words: list[str],
    recordings: tuple[Path, Path],
    tmp_path: Path,
) -> None:
    wrong, output = tmp_path / "wrong.csv", tmp_path / "results"
    _write(wrong, change(_cells(recordings[0])))
    output.mkdir()
    (output / "coefficients.csv").write_text("earlier results\n")
    result = run("identify", "puma560", wrong, "-o", output, "--overwrite")
    assert result.exit_code == 2
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1, result.stderr
    for word in words:
        assert word in lines[0]
    assert [path.name for path in output.iterdir()] == ["coefficients.csv"]
    assert (output / "coefficients.csv").read_text() == "earlier results\n"
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []


@pytest.mark.parametrize(
    ("text", "words"),
    [
        pytest.param("[[joint]\n", ["not valid TOML"], id="unreadable"),
        pytest.param('[[joint]]\nkind = "X"\n', ["joint 1", "kind"], id="unknown kind"),
        pytest.param("[[joint]]\nlenght = 1\n", ["joint 1", "lenght"], id="unknown key"),
        pytest.param(
            '[[joint]]\n[joint.link]\nzero = ["Ixx"]\nequal = [["Ixx", "Iyy"]]\n',
            ["joint 1", "equal and zero"],
            id="contradictory",
        ),
    ],
)
def test_a_wrong_robot_file_gets_one_line(
    text: str, words: list[str], recordings: tuple[Path, Path], tmp_path: Path
) -> None:
    robot = tmp_path / "robot.toml"
    robot.write_text(text)
    for arguments in (["derive", robot], ["identify", robot, recordings[0], "-o", tmp_path / "o"]):
        result = run(*arguments)
        assert result.exit_code == 2
        lines = result.stderr.strip().splitlines()
        assert len(lines) == 1, result.stderr
        for word in (str(robot), *words):
            assert word in lines[0]
    assert not (tmp_path / "o").exists()


def test_files_that_are_not_there(recordings: tuple[Path, Path], tmp_path: Path) -> None:
    result = run("identify", "puma560", tmp_path / "none.csv", "-o", tmp_path / "o")
    assert result.exit_code == 2 and "none.csv" in result.stderr
    result = run("derive", tmp_path / "none.toml")
    assert result.exit_code == 2 and "no such robot file" in result.stderr
    (tmp_path / "file").write_text("not a folder")
    result = run("identify", "puma560", recordings[0], "-o", tmp_path / "file")
    assert result.exit_code == 2 and "expected a folder" in result.stderr
    assert (tmp_path / "file").read_text() == "not a folder"


def test_a_joint_that_stands_still_is_named(
    identified: tuple[Result, Path], recordings: tuple[Path, Path], tmp_path: Path
) -> None:
    """Its coefficients stay undetermined, the others are as accurate, and the command says so."""
    cells = _cells(recordings[0])
    column = cells[0].index("position_6")
    for row in cells[1:]:
        row[column] = "0.3"
    path = tmp_path / "still.csv"
    _write(path, cells)
    settings = identified[1] / "identification.json"
    result = run("identify", "puma560", path, "-o", tmp_path / "out", "--settings", settings)
    assert result.exit_code == 0, result.output
    assert "warning: joint 6 does not move" in result.output
    (verdict,) = [line for line in result.output.splitlines() if line.startswith("kv6 ")]
    assert "not determined" in verdict
    document = json.loads((tmp_path / "out" / "identification.json").read_text())
    assert max(abs(k) for k in document["k"]) < 100
