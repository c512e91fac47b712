"""Stored tables of the demo agree with what the present code computes.

The pages of the experiment and of the thesis are written from stored tables. This test repeats the
cheap part of the demo: recordings, settings, the direct solve, systematic errors and ε. It trains
nothing. Tolerances lie far above what another processor changes (a relative 1e-8 in systematic
errors, of the fit even less), and far below what a number on a page shows.
"""

import argparse
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
import sim
from jaxcslc.least_squares import Identification
from jaxcslc.uncertainty import SystematicError, systematic_error
from scripts.studies.puma560 import experiment
from scripts.studies.puma560.machines import as_in_the_thesis, fitted, machines
from scripts.studies.truth import published_coefficients, true_coefficients
from scripts.tools.thesis import results


ADVICE = (
    "the stored tables are out of date: run `make demo`, then"
    " `.venv/bin/python -m scripts.tools.thesis.page --collect build` and"
    " `.venv/bin/python -m scripts.tools.thesis.experiment_page`"
)
SEED = 1  # of the stored run
# Pages show four digits. Of coefficients, what matters is small next to the standard error.
RELATIVE = 1e-4
OF_STANDARD_ERROR = 1e-3


@dataclass(frozen=True)
class Repeated:
    """A machine of the demo, recorded and fitted again."""

    letter: str
    machine: sim.Machine
    training: jc.Recording
    comparison: jc.Recording
    patterns: jc.Patterns
    fit: Identification
    systematic: SystematicError


@pytest.fixture(scope="module", params=["A", "B"])
def repeated(
    request: pytest.FixtureRequest, puma: jc.CSLC, tmp_path_factory: pytest.TempPathFactory
) -> Repeated:
    name = f"PUMA {request.param}"
    machine = machines()[name]
    options = argparse.Namespace(
        seed=SEED,
        seeds=1,
        samples=sim.adjusted_training().samples,
        quick=False,
        output=tmp_path_factory.mktemp("d"),
    )
    (recordings,) = experiment.recorded(options, {name: machine}, {})[name]
    training, comparison = (simulated.recording for simulated in recordings)
    settings, patterns, fit = fitted(puma, training, quick=False)
    systematic = systematic_error(puma, training, settings, fit)
    return Repeated(request.param, machine, training, comparison, patterns, fit, systematic)


def column(table: str, name: str) -> np.ndarray:
    return np.array([float(row[name]) for row in results.rows("demo", f"{table}.csv")])


def test_greatest_torques(repeated: Repeated) -> None:
    name = f"PUMA {repeated.letter}"
    peaks = np.abs(repeated.comparison.torque).max(axis=0)
    assert_allclose(column("peaks", f"{name} [N m]"), peaks, rtol=RELATIVE, err_msg=ADVICE)
    demands = np.abs(repeated.training.torque).max(axis=0)
    stored = column("demands", f"{name}, training [N m]")
    assert_allclose(stored, demands, rtol=RELATIVE, err_msg=ADVICE)
    limits = column("demands", "limit of linearity [N m]")
    assert_allclose(limits, repeated.machine.linear_torque, rtol=RELATIVE, err_msg=ADVICE)


def test_coefficients_and_their_errors(repeated: Repeated, puma: jc.CSLC) -> None:
    table = f"coefficients_{repeated.letter.lower()}"
    error = np.asarray(repeated.fit.standard_error)
    computed = {
        "value": repeated.fit.k,
        "true": true_coefficients(puma, repeated.machine),
        "standard_error": error,
        "systematic_error": repeated.systematic.total,
    }
    for name, values in computed.items():
        off = np.abs(column(table, name) - np.asarray(values)) / error
        assert off.max() < OF_STANDARD_ERROR, f"{name}: {ADVICE}"


def test_errors_of_the_comparison(repeated: Repeated, puma: jc.CSLC) -> None:
    published = published_coefficients(puma)
    vectors = {
        "Ar+LS": published,
        "Ar+Rg": jc.regress_friction(puma, repeated.patterns, published),
        "CSLC": repeated.fit.k,
        "true": true_coefficients(puma, repeated.machine),
    }
    rows = jc.compare(puma, as_in_the_thesis(repeated.comparison), vectors).rows()
    stored = {row[""]: row for row in results.rows("demo", f"errors_{repeated.letter.lower()}.csv")}
    for row in rows:
        for model in vectors:
            then, now = float(stored[str(row[""])][model]), float(row[model])
            assert_allclose(then, now, rtol=RELATIVE, err_msg=ADVICE)
