"""What masks leave out: nine sets of masks on two short recordings, judged beside the truth."""

import csv
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxcslc as jc
from jaxcslc.training import inverse_dynamics
from scripts.studies.training import masks
from tests import arms


def test_cases_are_what_they_say() -> None:
    network = inverse_dynamics(arms.pendulum("viscous"))
    motion, fast = np.ones((2, 1)), np.array([[True], [False]])
    patterns = jc.Patterns(np.arange(2.0), motion, motion, motion, motion, fast[::-1], fast)
    every, none = np.ones((2, 1), bool), np.zeros((2, 1), bool)
    expected = {
        ("yes", "everything"): (none, none),
        ("yes", "friction only"): (fast[::-1], none),
        ("yes", "nothing"): (fast[::-1], fast[::-1]),
        ("no", "everything"): (fast, fast),
        ("no", "friction only"): (every, fast),
        ("no", "nothing"): (every, every),
    }
    assert len(masks.CASES) == len(masks.BACKLASH) * len(masks.SLOW)
    for case in masks.CASES:
        if case.backlash == "shuffled":
            continue
        learnt = dict(zip(network.groups, case.masks(network, patterns), strict=True))
        rigid, friction = expected[case.backlash, case.slow]
        assert_array_equal(learnt["gravity"], rigid)
        assert_array_equal(learnt["viscous"], friction)


def test_shuffled_masks_lose_as_many_pairs(rng: np.random.Generator) -> None:
    network = inverse_dynamics(arms.pendulum("viscous"))
    motion, kept = rng.normal(size=(50, 1)), rng.random((50, 1)) < 0.4
    every = np.ones((50, 1), bool)
    patterns = jc.Patterns(np.arange(50.0), motion, motion, motion, motion, kept, every)
    shuffled = masks.Case("shuffled", "nothing").masks(network, patterns)
    assert np.any(shuffled != kept)
    assert_array_equal(shuffled.sum(axis=(1, 2)), np.full(len(network.groups), kept.sum()))


def test_the_truth_has_no_errors(rng: np.random.Generator) -> None:
    """Without noise every set of masks finds the true coefficients, and no residual is left."""
    cslc = arms.pendulum("viscous", "dry")
    k = np.array([0.5, 0.3, -0.1, 0.4, 0.6])
    q, qd, qdd = rng.uniform(-2.0, 2.0, (3, 60, 1))
    torque = np.asarray(cslc.torque(k, q, qd, qdd))
    patterns = jc.Patterns(
        np.arange(60.0), q, qd, qdd, torque, rng.random((60, 1)) < 0.8, np.abs(qd) > 0.5
    )
    for learnt in masks.coefficients_of(inverse_dynamics(cslc), patterns).values():
        assert_allclose(learnt, k, rtol=1e-9)
    figures = masks.residual_figures(cslc, patterns, k, qd)
    assert_allclose(figures["all pairs"], 0.0, atol=1e-12)
    assert_allclose(figures["share of slow pairs"], np.mean(np.abs(qd) <= 0.5))
    assert figures["slow pairs of wrong sign"] == [0.0]
    wrong = np.array([0.0, 0.0, 0.0, 0.0, 2.0])  # of Coulomb friction
    errors = masks.errors_of_torque(cslc, patterns, wrong)
    assert_allclose((errors["friction"], errors["rigid"]), (2.0, 0.0))


def test_a_short_study_goes_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--machines", "A", "--samples", "800", "--seeds", "1", "-o", str(tmp_path)]
    assert masks.main(options) == 0
    printed = capsys.readouterr().out
    assert "PUMA A, 1 of 1 seeds" in printed
    with (tmp_path / "masks_a.csv").open() as file:
        table = list(csv.DictReader(file))
    assert [row["slow pairs left out of"] for row in table] == 3 * list(masks.SLOW)
    # The true coefficients are better than those of a second and a half.
    assert all(float(row["ε over true"].split(" ")[0]) > 1.0 for row in table)
    assert masks.main(options) == 0  # from its rows
    assert printed.splitlines()[1:] == capsys.readouterr().out.splitlines()[1:]


def test_a_wrong_threshold_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        masks.main(["--threshold", "1"])
    said = capsys.readouterr().err.splitlines()[-1]
    assert said.endswith("--threshold is 1.0; expected more than 0 and less than 1")
