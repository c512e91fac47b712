"""A real Panda's possible parameters, where its data lie beside the project."""

import csv
import dataclasses
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import jaxcslc as jc
from scripts.examples import franka_panda_physical
from tests import arms


_DATA = Path(__file__).parents[4] / "shared" / "data" / "franka_panda"


def test_reads_the_authors_symbols() -> None:
    """Sums of moments, first moments and masses, brackets included."""
    links = tuple(
        jc.LinkParameters(float(i), np.array([0.1, 0.2, 0.3]), np.diag([1.0, 2.0, 3.0]) * i)
        for i in range(1, 8)
    )

    network = arms.panda()
    fit: Any = SimpleNamespace(
        k=np.ones(network.size),
        covariance=np.eye(network.size),
        undetermined=np.zeros((0, network.size)),
    )
    possible = jc.physical_parameters(network, fit)
    parameters = dataclasses.replace(possible, links=links, friction={"dry": np.arange(7.0)})
    assert franka_panda_physical.value_of("0.1(m3 + m4) -c2x m2", parameters) == pytest.approx(
        0.7 - 0.2
    )
    expected = float(links[1].inertia_at_frame[0, 0]) - 2 * float(links[2].inertia_at_frame[0, 2])
    assert franka_panda_physical.value_of("J2xx -2.0 Jxz3", parameters) == pytest.approx(expected)
    assert franka_panda_physical.value_of("fc,3", parameters) == 2.0
    with pytest.raises(ValueError, match="cannot read 'J2xx"):
        franka_panda_physical.value_of("J2xx + oops", parameters)


@pytest.mark.skipif(not _DATA.is_dir(), reason="the Panda's recording is not beside the project")
def test_possible_parameters_predict_as_well(tmp_path: Path) -> None:
    """Raw torque of the last third, every joint: within 5 % of least squares."""
    assert franka_panda_physical.main([str(_DATA), "-o", str(tmp_path / "out")]) == 0
    with (tmp_path / "out" / "held_out.csv").open() as file:
        rows = list(csv.DictReader(file))
    (ratio,) = (r for r in rows if r["torque"] == "raw" and r["parameters"] == "ratio")
    assert all(float(ratio[f"joint_{joint}"]) < 1.05 for joint in range(1, 8))
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["distance"] > 0
    with (tmp_path / "out" / "links.csv").open() as file:
        assert all(float(row["mass"]) > 0 for row in csv.DictReader(file))


def test_a_folder_without_the_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        franka_panda_physical.main([str(tmp_path)])
    assert end.value.code == 2
    assert "not found" in capsys.readouterr().err
