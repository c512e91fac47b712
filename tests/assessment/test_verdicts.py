"""Verdicts on coefficients, and how correlated they are."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.report import coefficient_rows, coefficient_text, degree_of_excitation, verdicts
from jaxcslc.uncertainty import SHOWN_SCALE, TORQUE_SCALE, SystematicError
from tests import arms


ORDINARY = jc.LeastSquares(joint_weights="equal", errors="independent")


@pytest.fixture(scope="module")
def arm() -> jc.CSLC:
    """One joint with an upright axis: inertia, viscous and dry friction."""
    return arms.turntable()


def patterns_of(
    network: jc.CSLC, k: list[float], qd: np.ndarray, qdd: np.ndarray, noise: np.ndarray | float
) -> jc.Patterns:
    q, qd, qdd = np.zeros((len(qd), 1)), qd[:, None], qdd[:, None]
    torque = np.asarray(network.torque(jnp.array(k), q, qd, qdd)) + noise
    everything = np.ones(q.shape, bool)
    return jc.Patterns(np.arange(float(len(q))), q, qd, qdd, torque, everything, everything)


def words(network: jc.CSLC, patterns: jc.Patterns) -> list[str]:
    fit = ORDINARY.fit(network, patterns)
    excitation = degree_of_excitation(network, patterns)
    return [verdict.kind for verdict in verdicts(network, fit, excitation)]


def test_each_word(arm: jc.CSLC, rng: np.random.Generator) -> None:
    qd, qdd = rng.normal(size=(2, 400))
    noise = rng.normal(size=(400, 1))
    assert words(arm, patterns_of(arm, [5.0, 0.4, 0.0], qd, qdd, noise)) == [
        "well determined",
        "poorly determined",
        "indistinguishable from zero",
    ]
    assert words(arm, patterns_of(arm, [-5.0, 5.0, 5.0], qd, qdd, noise))[0] == "wrong sign"
    still = patterns_of(arm, [5.0, 1.0, 1.0], np.zeros(400), qdd, noise)
    assert words(arm, still) == ["well determined", "not determined", "not determined"]


def test_a_torque_scale_that_nothing_confirms_qualifies_what_follows_it(
    arm: jc.CSLC, rng: np.random.Generator
) -> None:
    qd, qdd = rng.normal(size=(2, 400))
    fit = ORDINARY.fit(arm, patterns_of(arm, [5.0, 4.0, 3.0], qd, qdd, 0.1))
    follows = np.abs(np.asarray(fit.k)) * [0.02, 0.1, 0.0]
    for shown, first in (({}, ""), ({SHOWN_SCALE: "± 30 %"}, " up to scale")):
        judged = verdicts(arm, fit, systematic=SystematicError({TORQUE_SCALE: follows}, shown))
        assert [verdict.kind for verdict in judged] == [
            f"well determined{first}",
            "systematic error",
            "well determined",
        ]


def test_reasons_name_what_stands_in(arm: jc.CSLC, rng: np.random.Generator) -> None:
    """Velocities of nearly one modulus: dry and viscous friction look alike."""
    qd = np.sign(rng.normal(size=400)) * (2.0 + 0.05 * rng.normal(size=400))
    patterns = patterns_of(
        arm, [5.0, 1.0, 1.0], qd, rng.normal(size=400), rng.normal(size=(400, 1))
    )
    fit, excitation = (
        ORDINARY.fit(arm, patterns),
        degree_of_excitation(arm, patterns),
    )
    judged = verdicts(arm, fit, excitation)
    assert re.fullmatch(
        r"standard error [\d.]+ (% of|times) the value"
        r" \(increased [\d.]+ times by correlation with other coefficients\)",
        judged[1].reason,
    )
    assert "correlation" not in judged[0].reason
    assert excitation.worst_combination in ("kd1 - 2*kv1", "kv1 - 0.5*kd1") or all(
        name in excitation.worst_combination for name in ("kd1", "kv1")
    )


def test_inflation_is_what_the_others_cost(puma: jc.CSLC, rng: np.random.Generator) -> None:
    """Oracle: one over 1 - R² of each column on the others, about zero."""
    q, qd, qdd = rng.normal(size=(3, 300, 6))
    everything = np.ones(q.shape, bool)
    patterns = jc.Patterns(np.arange(300.0), q, qd, qdd, q, everything, everything)
    excitation = degree_of_excitation(puma, patterns)
    rows = np.asarray(puma.regressor(q, qd, qdd)).reshape(-1, 43)
    for i in (0, 5, 30, 42):
        others = np.delete(rows, i, axis=1)
        residual = rows[:, i] - others @ np.linalg.lstsq(others, rows[:, i], rcond=None)[0]
        assert_allclose(
            excitation.variance_inflation[i],
            (rows[:, i] @ rows[:, i]) / (residual @ residual),
            rtol=1e-6,
        )
    assert_allclose(excitation.length, np.linalg.norm(rows, axis=0), rtol=1e-8)
    table = excitation.to_pandas()
    assert tuple(table.index) == puma.names


def test_inflation_of_what_is_untold(arm: jc.CSLC, rng: np.random.Generator) -> None:
    patterns = patterns_of(arm, [1.0, 1.0, 1.0], np.zeros(50), rng.normal(size=50), 0.0)
    excitation = degree_of_excitation(arm, patterns)
    assert np.isinf(np.asarray(excitation.variance_inflation)).tolist() == [False, True, True]
    assert excitation.worst_combination in ("kv1", "kd1")


def test_columns_of_the_table(arm: jc.CSLC, rng: np.random.Generator) -> None:
    qd, qdd = rng.normal(size=(2, 400))
    patterns = patterns_of(arm, [5.0, 0.4, 0.0], qd, qdd, rng.normal(size=(400, 1)))
    fit = ORDINARY.fit(arm, patterns)
    rows = coefficient_rows(arm, fit, excitation=degree_of_excitation(arm, patterns), level=0.9)
    ends = [[float(row["low"]), float(row["high"])] for row in rows]
    assert_allclose(ends, fit.confidence_interval(0.9))
    assert all(float(row["variance_inflation"]) >= 1.0 for row in rows)
    table, *reasons = coefficient_text(rows).split("\n\n")
    header = table.splitlines()[0]
    assert all(name in header for name in ("low", "high", "verdict"))
    doubtful = [str(row["name"]) for row in rows if row["verdict"] != "well determined"]
    assert doubtful and reasons[0].splitlines()[0] == "not well determined:"
    assert [line.split(":")[0].strip() for line in reasons[0].splitlines()[1:]] == doubtful


def test_a_fit_of_another_network(
    arm: jc.CSLC, puma: jc.CSLC, puma_k: jax.Array, rng: np.random.Generator
) -> None:
    del puma_k
    qd, qdd = rng.normal(size=(2, 400))
    fit = ORDINARY.fit(arm, patterns_of(arm, [1.0, 1.0, 1.0], qd, qdd, 0.0))
    with pytest.raises(ValueError, match="the fit has 3 coefficients from 'kB1', the network has"):
        verdicts(puma, fit)


def test_nothing_is_well_determined_at_a_meaningless_condition(
    arm: jc.CSLC, rng: np.random.Generator
) -> None:
    """Viscous and dry friction differ by 1e-9 of themselves: small standard errors say nothing."""
    qd = np.sign(rng.normal(size=400)) * (2.0 + 1e-9 * rng.normal(size=400))
    patterns = patterns_of(arm, [5.0, 1e3, 1e3], qd, rng.normal(size=400), 0.0)
    fit = jc.LeastSquares().fit(arm, patterns)
    assert float(fit.condition) > 1e8
    judged = verdicts(arm, fit)
    assert "well determined" not in [verdict.kind for verdict in judged]
    assert "condition number" in judged[0].reason
