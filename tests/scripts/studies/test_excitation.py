"""The study of designs: its tables, on rows that are made up."""

import argparse
from typing import Any

import numpy as np

from scripts.studies.excitation.motions import knowledge, network, thesis_coefficients
from scripts.studies.excitation.study import (
    QUANTITIES,
    _tasks,
    compare_text,
    page_table,
    sequence_text,
    tables,
)


def compared(name: str, number: int, value: float) -> dict[str, Any]:
    row = dict.fromkeys(QUANTITIES, value)
    return {"part": "compare", "name": name, "number": number, **row}


def test_ratios_are_seed_by_seed() -> None:
    rows = [compared("overall", seed, 1.0 + seed) for seed in range(3)]
    rows += [compared("thesis", seed, 2.0 * (1.0 + seed)) for seed in range(3)]
    lines = compare_text(rows).splitlines()
    assert [line.split()[0] for line in lines[1:]] == ["overall", "thesis"]
    assert lines[2].count("2.00 (2.00 to 2.00)") == len(QUANTITIES)
    _, ours, other = page_table(rows)
    assert ours[:4] == ["designed: overall", "3", "2.000", "2e+02 %"]
    assert other[2] == "4.000; 2.00 (2.00 to 2.00)"
    assert page_table(rows, inverse=True)[2][2] == "4.000; 0.50 (0.50 to 0.50)"


def test_a_trial_run_compares_one_design_with_motions_that_need_none() -> None:
    counts = {"arms": 0, "sequences": 0, "repeats": 0, "pandas": 0, "fits": 0, "auto": 0}
    counts |= {"directional": 0}
    options = argparse.Namespace(quick=True, seeds=1, directions=1, **counts)
    tasks = _tasks(options, with_panda=False)
    names = ("overall", "random Fourier", "thesis")
    assert tasks == [(part, name, 0) for part in ("compare", "directions") for name in names]
    options.quick = False
    assert len(_tasks(options, with_panda=False)) == 12
    options.directional = 1
    names = ("overall", "D-optimal", "condition number", "random Fourier", "thesis")
    assert _tasks(options, with_panda=False)[12:] == [("directional", name, 0) for name in names]


def test_friction_of_each_direction_has_the_thesis_coefficients_as_its_mean() -> None:
    net, k = network(directional=True), knowledge(directional=True).k
    np.testing.assert_allclose(thesis_coefficients(net) @ k, knowledge().k)
    changed = k.copy()
    changed[net.names.index("kdp2")] += 1.0
    changed[net.names.index("kdn2")] -= 1.0  # an offset
    np.testing.assert_allclose(thesis_coefficients(net) @ changed, knowledge().k)
    np.testing.assert_array_equal(thesis_coefficients(network()), np.eye(network().size))


def test_arms_beyond_a_limit_are_counted() -> None:
    rows = [
        {"part": "arms", "name": "", "number": 0, "worst": [0.9, 1.002], "infeasible": []},
        {"part": "arms", "name": "", "number": 1, "worst": [1.0], "infeasible": ["torque"]},
    ]
    (text,) = tables(rows)
    assert "2 arms, 3 designs, 1 wishes infeasible" in text
    assert "over 100.1 %: 1" in text


def test_pandas_are_summed_up() -> None:
    row = {"condition": 90.0, "scaled condition": 14.0, "seconds": 30.0, "scale": 1.0}
    rows = [{"part": "panda", "name": "", "number": i, "feasible": i > 0, **row} for i in (0, 1)]
    (text,) = tables(rows)
    assert text.startswith("Panda: 1 of 2 seeds feasible; condition 90 to 90, median 90")


def test_seconds_of_one_motion_are_over_those_of_the_sequence() -> None:
    rows: list[dict[str, Any]] = [
        {"part": "sequence", "name": "", "number": i, "seconds": {"in sequence": x, "worst": 3 * x}}
        for i, x in enumerate((6.0, 9.0, 12.0))
    ]
    assert sequence_text(rows).splitlines()[2].endswith("27  3.00 (3.00 to 3.00)")
    assert tables(rows) == [sequence_text(rows)]
