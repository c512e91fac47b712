"""The study of torque alignments: the four ways to record a torque, and what it counts."""

from typing import Any

import numpy as np
from numpy.testing import assert_allclose

import jaxcslc as jc
from scripts.studies.alignment import study
from scripts.studies.alignment.study import RIGHT


def test_held_demands_act_half_a_sample_late(rng: np.random.Generator) -> None:
    time = 0.002 * np.arange(50)
    demand = rng.normal(size=(50, 2))
    ways = study.conventions(jc.Recording(time, rng.normal(size=(50, 2)), demand))
    assert set(ways) == set(RIGHT)
    # The mean of a held demand over the interval about each sample, by quadrature.
    fine = np.repeat(demand, 10, axis=0)
    acting = np.stack([fine[10 * n - 5 : 10 * n + 5].mean(axis=0) for n in range(1, 50)])
    assert_allclose(ways["sampled"].torque[1:], acting)
    averaged = np.stack([np.convolve(x, [0.25, 0.5, 0.25], "valid") for x in acting.T], axis=1)
    assert_allclose(ways["averaged"].torque[2:-1], averaged)
    assert [ways[name].torque_measured for name in RIGHT] == [False, True, False, True]


def test_counts_what_was_right() -> None:
    def row(selected: str, epsilon: float) -> dict[str, Any]:
        costs = {
            "mean": {"viscous": 0.01, "epsilon": 0.2},
            "sample": {"viscous": 0.1, "epsilon": epsilon},
        }
        which = {"selected": selected, "lowest": "sample", "right": "mean"}
        return {"case": "demo", "convention": "held"} | which | costs

    line = study.summary([row("mean", 0.1), row("sample", 0.3)], "demo", "held")
    assert (line["recordings"], line["right"], line["right, by score alone"]) == (2, 1, 0)
    assert_allclose(line["viscous error [%]"], 10.0)
    assert_allclose(line["ε over right one's"], 1.5)
