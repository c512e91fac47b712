"""The training of 7.5 on a pendulum with static friction: it ends where it should."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from scripts.studies.training.thesis_route import ThesisRoute, thesis_route
from tests import arms


K = np.array([0.5, 0.3, -0.1, 0.4, 0.6])
GAMMA, EXCESS = 0.15, 0.25
RATES, SIZES = np.array([3.1, 7.3, 12.7]), np.array([0.9, 0.5, 0.12])
PREPARATION = jc.Preparation(jc.AveragedSplines(9))
MEASURED = 0.8 * K


@pytest.fixture(scope="module")
def pendulum() -> jc.CSLC:
    return arms.pendulum()


@pytest.fixture(scope="module")
def recording(pendulum: jc.CSLC) -> jc.Recording:
    """6 s of a pendulum with static friction, read without error."""
    time = np.arange(1500) * 0.004
    phase = np.outer(time, RATES)
    q = (np.sin(phase) @ SIZES)[:, None]
    qd = (np.cos(phase) @ (SIZES * RATES))[:, None]
    qdd = (-np.sin(phase) @ (SIZES * RATES**2))[:, None]
    torque = np.asarray(pendulum.torque(K, q, qd, qdd))
    return jc.Recording(time, q, torque + EXCESS * np.sign(qd) * np.exp(-np.abs(qd) / GAMMA))


@pytest.fixture(scope="module")
def route(pendulum: jc.CSLC, recording: jc.Recording) -> ThesisRoute:
    return thesis_route(
        pendulum, recording, PREPARATION, MEASURED, least_reduction=1e-7, epochs=4000
    )


def test_hand_over_is_the_cost_of_direct_measurement(pendulum: jc.CSLC, route: ThesisRoute) -> None:
    for stage in (route.first, route.second):
        part = stage.patterns
        error = np.asarray(part.torque - pendulum.torque(MEASURED, part.q, part.qd, part.qdd))
        # The cost is of all pairs that some subnetwork learns from: slow ones too (7.2.2).
        assert_allclose(stage.hand_over, 0.5 * np.abs(error).mean())
        slow = np.abs(np.asarray(part.qd)) <= stage.thresholds
        assert np.any(slow) and not np.any(np.asarray(part.mask)[slow])


def test_both_rules_train_until_neither_gains(route: ThesisRoute) -> None:
    for stage in (route.first, route.second):
        assert stage.training.outcomes() == {"no further reduction": 1}
        backpropagation, peral = stage.epochs
        assert backpropagation > 0 and peral > 0
        assert backpropagation + peral <= 4000
    cost = np.asarray(route.first.training.history.cost)
    rule = np.asarray(route.first.training.history.rule)
    # Backpropagation alone until the hand-over, from the torque of zero weights.
    assert np.all(cost[: int(np.argmax(rule == 1))][:-1] >= route.first.hand_over)


def test_thresholds_from_the_residuals_are_those_of_the_plant(route: ThesisRoute) -> None:
    assert route.static_friction.significant.tolist() == [True]
    assert 3.0 * GAMMA < route.second.thresholds[0] < 6.0 * GAMMA
    assert route.first.thresholds[0] < GAMMA
    assert_allclose(route.static_friction.slope_velocity, GAMMA, rtol=0.5)


def test_better_thresholds_bring_dry_friction_nearer(pendulum: jc.CSLC, route: ThesisRoute) -> None:
    """7.2.2: static friction in the training set raises dry friction and lowers viscous."""
    (dry,) = pendulum.layout.indices("dry")
    first = abs(float(route.first.training.weights[dry]) - K[dry])
    assert abs(float(route.k[dry]) - K[dry]) < 0.5 * first
