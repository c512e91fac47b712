"""Faults that stay possible against integrals, and against fits to recordings with the fault."""

import dataclasses

import numpy as np
import pytest
import scipy

import jaxcslc as jc
from jaxcslc.uncertainty import (
    CLOCK,
    SHOWN_SCALE,
    TOLERANCES,
    TOLERATED,
    TORQUE_SCALE,
    ZEROS,
    Estimate,
    possible_faults,
    possible_size,
)
from scripts.studies.checks.robots import Conditions, arm as arm_of, record
from scripts.studies.checks.spoiler import clean_conditions


QUANTILE = 1.959963984540054  # of a normal distribution, 95 %
LENGTH = 0.4


@pytest.fixture(scope="module")
def arm() -> tuple[jc.CSLC, np.ndarray, jc.Patterns]:
    """Two links in a vertical plane, their coefficients, and noisy torques of a rich motion."""
    robot = jc.Manipulator.from_modified_dh(
        [(0, 0, 0, 0), (0, LENGTH, 0, 0)], gravity=(0, -9.81, 0)
    )
    network = jc.derive(robot.with_friction("viscous"), lengths="numeric")
    k = np.linspace(1.0, 0.3, network.size)
    t = np.linspace(0.0, 20.0, 3000)
    omega, phase = np.array([[1.7, 2.9], [2.3, 4.1]]), np.array([[0.0, 0.3], [1.0, 2.0]])
    angle = omega * t[:, None, None] + phase
    q, qd, qdd = (
        x.sum(axis=1) for x in (np.sin(angle), omega * np.cos(angle), -(omega**2) * np.sin(angle))
    )
    torque = np.array(network.torque(k, q, qd, qdd))
    torque += 0.05 * np.random.default_rng(0).standard_normal(torque.shape)
    whole = np.ones(q.shape, bool)
    return network, k, jc.Patterns(t, q, qd, qdd, torque, whole, whole)


def faulty(patterns: jc.Patterns, fault: str, size: float, joint: int = 0) -> jc.Patterns:
    """What a recorder with the fault has of the same motion."""
    q, qd, qdd, torque = (
        np.asarray(x) for x in (patterns.q, patterns.qd, patterns.qdd, patterns.torque)
    )
    if fault == TORQUE_SCALE:
        return dataclasses.replace(patterns, torque=(1.0 + size) * torque)
    if fault == CLOCK:  # times that are too long
        slow = 1.0 + size
        return dataclasses.replace(patterns, qd=qd / slow, qdd=qdd / slow**2)
    return dataclasses.replace(patterns, q=q + size * np.eye(2)[joint])


def fitted(network: jc.CSLC, patterns: jc.Patterns) -> np.ndarray:
    return np.asarray(jc.LeastSquares().fit(network, patterns).k)


@pytest.mark.parametrize("limit", [0.05, 0.005])
@pytest.mark.parametrize(
    ("value", "error"), [(0.0, np.inf), (0.0, 0.01), (0.3, 0.1), (-0.02, 0.02)]
)
def test_size_holds_95_percent_of_the_posterior(limit: float, value: float, error: float) -> None:
    usual = limit / np.sqrt(3.0)

    def density(fault: np.ndarray) -> np.ndarray:
        prior = 0.95 * scipy.stats.norm.pdf(fault, 0.0, usual)
        prior += 0.05 * scipy.stats.norm.pdf(fault, 0.0, 20.0 * usual)
        seen = 1.0 if np.isinf(error) else scipy.stats.norm.pdf(value, fault, error)
        return prior * seen

    size = possible_size(limit, Estimate(value, error))
    grid = np.linspace(-3.0, 3.0, 30_001)
    values = density(grid)
    inside = np.abs(grid) <= size
    share = np.sum(values[inside]) / np.sum(values)
    np.testing.assert_allclose(share, 0.95, atol=0.02)


@pytest.mark.parametrize("fault", [TORQUE_SCALE, CLOCK, ZEROS])
def test_parts_are_what_a_fit_to_the_faulty_recording_changes_by(
    arm: tuple[jc.CSLC, np.ndarray, jc.Patterns], fault: str
) -> None:
    network, _, patterns = arm
    k, size = fitted(network, patterns), 1e-3
    faults = possible_faults(network, patterns, k, np.ones(network.size, bool))
    joints = range(2) if fault == ZEROS else [0]
    changes = [fitted(network, faulty(patterns, fault, size, joint)) - k for joint in joints]
    directions = np.abs(np.array(changes)) / size
    part = faults.parts[fault] * QUANTILE
    if fault != ZEROS:
        possible = float(np.max(part) / np.max(directions[0]))
        assert 0.0 < possible < 2.0 * TOLERANCES[fault].limit
        np.testing.assert_allclose(
            part, possible * directions[0], rtol=0.02, atol=1e-4 * part.max()
        )
    else:  # every coefficient within what both joints may do at most
        largest = 2.0 * TOLERANCES[fault].limit
        assert np.all(part <= largest * np.sqrt(np.sum(directions**2, axis=0)) * 1.02)
        assert np.any(part > 0.0)


@pytest.mark.parametrize(("fault", "size"), [(CLOCK, 0.05), (ZEROS, 0.08)])
def test_a_fault_that_the_data_show_is_in_the_intervals(
    arm: tuple[jc.CSLC, np.ndarray, jc.Patterns], fault: str, size: float
) -> None:
    network, truth, patterns = arm
    spoilt = faulty(patterns, fault, size)  # of the first joint: others are their bodies'
    fit = jc.LeastSquares().fit(network, spoilt)
    k, every = np.asarray(fit.k), np.ones(network.size, bool)
    statistical = QUANTILE * np.asarray(fit.standard_error)
    assert np.mean(np.abs(k - truth) > statistical) > 0.4
    parts = possible_faults(network, spoilt, k, every).parts
    systematic = QUANTILE * np.sqrt(np.sum([part**2 for part in parts.values()], axis=0))
    # First order, of a fault that is not small.
    assert np.all(np.abs(k - truth) <= 1.15 * np.hypot(statistical, systematic))


def test_data_narrow_a_clock_and_a_zero(arm: tuple[jc.CSLC, np.ndarray, jc.Patterns]) -> None:
    network, _, patterns = arm
    k, every = fitted(network, patterns), np.ones(network.size, bool)
    within = possible_faults(network, patterns, k, every).within
    sizes = {cause: float(within[cause].split("± ")[1].split()[0]) for cause in TOLERATED}
    assert sizes[CLOCK] < 100 * 0.5 * TOLERANCES[CLOCK].limit
    # A factor of all torques changes every coefficient, and no residual.
    np.testing.assert_allclose(
        sizes[TORQUE_SCALE], 100 * possible_size(0.05, Estimate()), rtol=0.05
    )
    known = possible_faults(network, patterns, k, every, scale=Estimate(0.0, 0.01)).within
    assert float(known[TORQUE_SCALE].split()[1]) < 0.5 * sizes[TORQUE_SCALE]


def test_a_scale_that_only_the_tolerance_bounds_is_stated(
    arm: tuple[jc.CSLC, np.ndarray, jc.Patterns],
) -> None:
    network, _, patterns = arm
    k, every = fitted(network, patterns), np.ones(network.size, bool)

    def shown(scale: Estimate | None) -> str | None:
        return possible_faults(network, patterns, k, every, scale=scale).within.get(SHOWN_SCALE)

    assert shown(None) == "nothing"
    # 0.05 + 1.96 · 0.15
    assert shown(Estimate(0.05, 0.15)) == "± 34 %"
    # 0.01 + 1.96 · 0.05, of what may be off by 5 % in standard errors.
    assert shown(Estimate(0.01, 0.05)) == "± 11 %"
    assert shown(Estimate(0.01, 0.04)) is None


def test_what_is_known_is_not_moved(arm: tuple[jc.CSLC, np.ndarray, jc.Patterns]) -> None:
    network, k, patterns = arm
    free = np.arange(network.size) > 0
    parts = possible_faults(network, patterns, k, free).parts
    assert all(part[0] == 0.0 and np.any(part[1:] > 0.0) for part in parts.values())


def test_a_report_says_how_far_and_keeps_the_standard_error(
    arm: tuple[jc.CSLC, np.ndarray, jc.Patterns], tmp_path: object
) -> None:
    network, _, patterns = arm
    recording = jc.Recording(
        np.asarray(patterns.time), np.asarray(patterns.q), np.asarray(patterns.torque)
    )
    report = jc.identify(network, recording, settings=jc.Settings(), possible="never", checks=False)
    assert set(report.systematic.within) == {TORQUE_SCALE, CLOCK, ZEROS, SHOWN_SCALE}
    assert "Nothing excludes a larger one." in report.verdict
    assert "coefficients well determined up to scale" in report.verdict
    row = report["kv1"]
    assert row["standard_error"] == float(report.fit.standard_error[network.names.index("kv1")])
    part = report.systematic.parts[TORQUE_SCALE][network.names.index("kv1")]
    assert row["systematic_error"] >= part > 0.02 * row.value
    assert f"torque scale {report.systematic.within[TORQUE_SCALE]}" in str(report)
    report.save(f"{tmp_path}/results", pictures=False)
    loaded = jc.load_report(f"{tmp_path}/results")
    assert loaded.systematic.within == dict(report.systematic.within)


@pytest.mark.parametrize(
    ("conditions", "seed", "factor", "low", "high"),
    [(clean_conditions(1014), 1014, 1.0, 0.0, 1.5), (Conditions(), 0, 1.05, 5.0, 10.0)],
)
def test_joints_that_disagree_show_no_clock(
    conditions: Conditions, seed: int, factor: float, low: float, high: float
) -> None:
    """Friction that no model has differs from joint to joint; a wrong clock does not."""
    recording = record("UR5", conditions, seed).recording
    slow = dataclasses.replace(recording, time=factor * recording.time)
    settings = jc.Settings()
    report = jc.identify(arm_of("UR5").network, slow, settings=settings, possible="never")
    size = float(report.systematic.within[CLOCK].split()[1])
    assert low <= size <= high


def test_coefficients_of_a_joint_that_stands_still_have_no_part(
    arm: tuple[jc.CSLC, np.ndarray, jc.Patterns],
) -> None:
    """Nothing depends on its friction: rounding, divided by rounding, was a part of 1e128."""
    network, k, patterns = arm
    still = np.array([1.0, 0.0])
    q = np.asarray(patterns.q)
    q, qd, qdd = (
        q * still + np.array([0.0, 0.3]),
        np.asarray(patterns.qd) * still,
        np.asarray(patterns.qdd) * still,
    )
    torque = np.asarray(network.torque(k, q, qd, qdd))
    patterns = dataclasses.replace(patterns, q=q, qd=qd, qdd=qdd, torque=torque)
    parts = possible_faults(network, patterns, k, np.ones(network.size, bool)).parts
    friction = [network.names.index("kv2")]
    for part in parts.values():
        assert np.all(part[friction] == 0.0)
        assert np.max(part) < 10.0 * np.max(np.abs(k))
