"""Friction that grows with the load, identified: fit, standard errors, choice, report, refusals."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.friction import contact_states, fit_load, fit_pre_sliding
from jaxcslc.identification import ESTIMATORS
from jaxcslc.identification._exclusions import Request, excluded
from jaxcslc.selection import PRE_SLIDING, choose_friction


ARM = jc.examples.planar_arm()
TIME = 0.01 * np.arange(1500)[:, None]
NOISE = 0.02


def motion() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rate, size = np.array([[2.0, 1.3], [3.1, 4.7]]), np.array([[0.9, 0.7], [0.3, 0.2]])
    pairs = list(zip(rate, size, strict=True))
    return (
        np.sum([s * np.sin(r * TIME) for r, s in pairs], axis=0),
        np.sum([s * r * np.cos(r * TIME) for r, s in pairs], axis=0),
        np.sum([-s * r**2 * np.sin(r * TIME) for r, s in pairs], axis=0),
    )


def truth(*kinds: str) -> tuple[jc.CSLC, np.ndarray]:
    """Possible bodies, joint 1 with kl 0.2, joint 2 with 0.1."""
    network = jc.derive(ARM.with_friction(*kinds), lengths="numeric")
    links = [
        jc.LinkParameters(3.0, np.array([0.2, 0.05, 0.0]), 0.05 * np.eye(3), 0.1),
        jc.LinkParameters(2.0, np.array([0.15, 0.02, 0.0]), 0.02 * np.eye(3), 0.05),
    ]
    values: dict[str, Any] = {"viscous": [0.3, 0.2], "dry": [0.4, 0.3], "load": [0.2, 0.1]}
    if "static" in kinds:
        values["static"] = [0.5, 0.4]
        network = network.with_static_slopes([6.0, 8.0])
    k = np.asarray(network.coefficients_from(links, **values))
    return network.with_load(k), k


def patterns(network: jc.CSLC, k: np.ndarray, noise: float, seed: int = 0) -> jc.Patterns:
    torque = np.asarray(network.torque(k, *motion()))
    torque = torque + noise * np.random.default_rng(seed).normal(size=torque.shape)
    everything = np.ones(torque.shape, bool)
    return jc.Patterns(TIME[:, 0], *motion(), torque, everything, everything)


def test_friction_that_yields_beside_friction_of_the_load() -> None:
    """Both in one model: each has its own coefficient, and states their lengths."""
    network, k = truth("viscous", "dry", "load")
    exact = patterns(network, k, 0.01)
    lengths = np.array([0.04, 0.02])
    states = np.asarray(contact_states(exact.q, lengths, np.zeros(2)))
    dry = k[[network.names.index(f"kd{joint}") for joint in (1, 2)]]
    torque = np.asarray(exact.torque) + dry * (states - np.sign(np.asarray(exact.qd)))
    result = fit_pre_sliding(network, dataclasses.replace(exact, torque=torque))
    assert_allclose(result.presliding_distance, lengths, rtol=0.1)
    assert_allclose(result.fit.k, k, atol=0.02)
    assert all(error.change < np.log(0.9) for error in result.elsewhere.values())
    request = Request(
        network.with_load(None),
        {"": jc.Recording(exact.time, exact.q, torque)},
        supports=ESTIMATORS["least-squares"].supports,
    )
    assert excluded(request, PRE_SLIDING) is None


def test_static_friction_that_the_motion_does_not_show_is_dropped() -> None:
    """Its slopes are searched for in linear equations, whose rigid bodies carry the load."""
    network, k = truth("viscous", "dry", "load")
    richer = network.with_joint_friction([("viscous", "dry", "static", "load")] * 2)
    exact = patterns(network, k, 1e-6)
    fast = np.abs(np.asarray(exact.qd)) > 0.3
    motion_of = exact.time, exact.q, exact.qd, exact.qdd, exact.torque
    result = fit_load(richer, jc.Patterns(*motion_of, fast, fast))
    assert result.slopes is not None and result.slopes.dropped
    assert "static" not in result.network.robot.friction_terms
    assert_allclose(result.fit.k, k, atol=1e-3)


@pytest.mark.parametrize("kinds", [("viscous", "dry"), ("viscous", "dry", "static")])
def test_exact_recordings_give_the_truth(kinds: tuple[str, ...]) -> None:
    network, k = truth(*kinds, "load")
    result = fit_load(network.with_load(None), patterns(network, k, 0.0))
    assert result.converged and not result.dropped
    assert_allclose(result.fit.k, k, atol=1e-6)
    assert_allclose(result.network.torque(result.fit.k, *motion()), network.torque(k, *motion()))
    if "static" in kinds:
        assert result.slopes is not None
        assert_allclose(result.slopes.slopes, [6.0, 8.0], rtol=1e-5)


def test_standard_errors_allow_for_the_load() -> None:
    """Over recordings, errors are as large as they say."""
    network, k = truth("viscous", "dry", "load")
    solver = jc.LeastSquares(errors="independent")
    fits = [
        fit_load(network.with_load(None), patterns(network, k, 0.1, seed), solver=solver).fit
        for seed in range(20)
    ]
    ratio = np.array([(fit.k - k) / fit.standard_error for fit in fits])
    # Twenty recordings of ten coefficients: chance alone leaves this range once in a thousand sets.
    assert 0.8 < np.sqrt(np.mean(ratio**2)) < 1.25


def test_what_no_friction_can_be_is_dropped() -> None:
    """A negative coefficient drives: joint 2 loses its term, joint 1 does not."""
    network, k = truth("viscous", "dry", "load")
    k = np.array(k)
    k[network.names.index("kl2")] = -0.1
    result = fit_load(network, patterns(network, k, NOISE))
    assert result.dropped == (2,)
    assert result.network.friction_per_joint == (("viscous", "dry", "load"), ("viscous", "dry"))
    assert "joint 2: friction of kind 'load' dropped, its coefficient -0." in result.warnings[0]


def directional(joints: tuple[int, ...]) -> tuple[jc.CSLC, np.ndarray]:
    """As `truth`, these joints with 0.25 where they drive their load and 0.1 where they brake."""
    robot = ARM.with_friction("viscous", "dry")
    for joint in joints:
        robot = robot.with_friction("viscous", "dry", "directional_load", joint=joint)
    network = jc.derive(robot, lengths="numeric")
    bare, values = truth("viscous", "dry", "load")
    known = dict(zip(bare.names, values, strict=True)) | {
        f"{symbol}{joint}": value
        for joint in joints
        for symbol, value in (("kld", 0.25), ("klb", 0.1))
    }
    k = np.array([known[name] for name in network.names])
    return network.with_load(k), k


def test_directions_are_told_apart_where_joints_share_coefficients() -> None:
    network, k = directional((2,))
    result = fit_load(network.with_load(None), patterns(network, k, 0.0))
    assert result.converged and not result.dropped
    assert_allclose(result.fit.k, k, atol=1e-6)


def test_directions_of_all_joints_are_a_multiple_of_rigid_torque() -> None:
    """(1 + kld) R and (1 - klb) R are those of bodies twice as heavy with other coefficients."""
    network, k = directional((1, 2))
    result = fit_load(network.with_load(None), patterns(network, k, 0.0))
    assert result.dropped == (1, 2)
    assert (
        "the motion does not distinguish it from a multiple of rigid torques" in result.warnings[0]
    )


@pytest.fixture(scope="module")
def recording() -> jc.Recording:
    network, k = truth("viscous", "dry", "load")
    return jc.Recording(TIME[:, 0], motion()[0], patterns(network, k, NOISE).torque)


def test_it_is_added_where_it_predicts_better(recording: jc.Recording) -> None:
    network = jc.derive(ARM, lengths="numeric")
    choice = choose_friction(network, recording, jc.Settings(), candidates=("offset", "load"))
    assert choice.network.friction_per_joint == (("viscous", "dry", "load"),) * 2
    assert "load -" in str(choice) and ", used" in str(choice)


def test_directions_are_added_where_they_predict_better() -> None:
    network, k = directional((2,))
    pairs = patterns(network, k, NOISE)
    choice = choose_friction(
        jc.derive(ARM, lengths="numeric"),
        jc.Recording(TIME[:, 0], motion()[0], pairs.torque),
        jc.Settings(),
        candidates=("load", "directional_load"),
    )
    assert choice.network.friction_per_joint[1] == ("viscous", "dry", "directional_load")


def test_a_report_saves_and_loads_it(recording: jc.Recording, tmp_path: Path) -> None:
    """What is loaded predicts what was identified, and so does C code's network."""
    robot = ARM.with_friction("viscous", "dry", "load")
    network, k = truth("viscous", "dry", "load")
    report = jc.identify(
        jc.derive(robot, lengths="numeric"), recording, settings=jc.Settings(), systematic=False
    )
    assert_allclose(report.k[report.network.layout.indices("load")], [0.2, 0.1], atol=0.02)
    error = report.network.torque(report.k, *motion()) - network.torque(k, *motion())
    assert np.sqrt(np.mean(np.asarray(error) ** 2)) < NOISE
    report.save(tmp_path / "out")
    saved = jc.load_report(tmp_path / "out", robot)
    assert_allclose(
        saved.network.torque(saved.fit.k, *motion()), report.network.torque(report.k, *motion())
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"estimator": "auto"}, "the estimator 'auto'"),
        ({"simulate": True}, "simulation without feedback"),
    ],
)
def test_what_does_not_know_it_says_so(
    recording: jc.Recording, options: dict[str, Any], message: str
) -> None:
    network = jc.derive(ARM.with_friction("dry", "load"), lengths="numeric")
    with pytest.raises(
        ValueError, match=f"friction of kind 'load' cannot be combined with {message}"
    ):
        jc.identify(network, recording, settings=jc.Settings(), **options)


def test_several_recordings_do_not_know_it(recording: jc.Recording) -> None:
    network = jc.derive(ARM.with_friction("dry", "load"), lengths="numeric")
    with pytest.raises(ValueError, match="cannot be combined with several recordings in one fit"):
        jc.identify(network, [recording, recording], settings=jc.Settings())


def test_estimators_without_a_regression_do_not_know_it(recording: jc.Recording) -> None:
    network, _ = truth("viscous", "dry", "load")
    with pytest.raises(ValueError, match="friction of kind 'load'"):
        jc.MaximumLikelihood().fit(network, recording)
