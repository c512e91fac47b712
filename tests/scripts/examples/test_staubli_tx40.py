"""A real log: the TX40's, where its data lie beside the project."""

from pathlib import Path

import numpy as np
import pytest

from scripts.examples import staubli_tx40


_ROOT = Path(__file__).parents[3]
_DATA = _ROOT.parent / "shared" / "data" / "staubli_tx40"


def test_gears(tmp_path: Path) -> None:
    """Power is the same on both sides; the motor of joint 6 turns with joint 5."""
    rng = np.random.default_rng(0)
    motor, torque = rng.normal(size=(2, 50, 6))
    for name, table in (("pos_read_data.csv", motor), ("curr_data.csv", torque)):
        np.savetxt(tmp_path / name, table, delimiter=",", header="a,b,c,d,e,f")
    recording = staubli_tx40.read_recording(tmp_path)
    steps = np.diff(recording.position, axis=0)
    assert np.allclose(
        np.sum(recording.torque[1:] * steps, axis=1),
        np.sum(torque[1:] * np.diff(motor, axis=0), axis=1),
    )
    assert np.allclose(np.diff(motor[:, 5]), 32 * (steps[:, 4] + steps[:, 5]))


def test_folders_without_the_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert staubli_tx40.main([str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "pos_read_data.csv: not found" in line
    (tmp_path / "pos_read_data.csv").write_text("a,b\n1,x\n")
    assert staubli_tx40.main([str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "expected a CSV table of numbers" in line


def test_bad_options(capsys: pytest.CaptureFixture[str]) -> None:
    for option in (["--step", "0"], ["--friction-models", "9"], ["--cutoffs", "-1"]):
        with pytest.raises(SystemExit):
            staubli_tx40.main(option)
        assert "error: --" in capsys.readouterr().err


@pytest.mark.skipif(not _DATA.is_dir(), reason="the TX40's log is not beside the project")
def test_every_joint_is_below_the_peer(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One friction model with fixed settings."""
    options = ["--friction-models", "1", "--cutoffs", "60", "--rest", "0.01", "--step", "25"]
    assert staubli_tx40.main([str(_DATA), "-o", str(tmp_path), *options]) == 0
    assert "every joint below every row of the peer's: yes" in capsys.readouterr().out
    rows = (tmp_path / "held_out.csv").read_text().splitlines()
    assert rows[0] == "model,joint 1,joint 2,joint 3,joint 4,joint 5,joint 6,sum"
    assert float(rows[-1].rpartition(",")[2]) < 16.0
