"""Dry friction that yields before it slides: against integrations by other means."""

from typing import Any

import numpy as np
import pytest
import scipy
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.friction import along_motion, contact_states, fit_pre_sliding
from jaxcslc.instruments import simulate
from tests import arms
from tests.yielding_motion import yielding_motion


INERTIA, WEIGHT, VISCOUS, DRY, LENGTH = 0.4, 3.0, 0.3, 0.8, 0.03


def test_the_state_is_that_of_the_differential_equation() -> None:
    """Two joints, in small explicit steps in time."""
    fine = np.linspace(0.0, 6.0, 150_001)
    size, length = np.array([0.1, 0.4]), np.array([0.02, 0.05])
    q = np.stack([size[0] * np.sin(2.0 * fine), size[1] * np.sin(3.0 * fine) ** 2], axis=1)
    w = np.array([0.3, 0.0])
    states = [w]
    for change in np.diff(q, axis=0):
        w = w + (change - np.abs(change) * w) / length
        states.append(w)
    # A sample every millisecond: a joint turns within some intervals, not between samples.
    some = slice(None, None, 25)
    assert_allclose(contact_states(q[some], length, states[0]), np.array(states)[some], atol=2e-3)


@pytest.fixture(scope="module")
def swing() -> tuple[np.ndarray, ...]:
    """A pendulum around rest, integrated by SciPy: position, velocity, acceleration, torque."""
    time = 0.005 * np.arange(3000)

    def torque(t: Any) -> Any:
        return WEIGHT + 1.3 * np.sin(1.7 * t) + 0.6 * np.sin(5.1 * t + 1.0)

    def acceleration(t: Any, q: Any, qd: Any, w: Any) -> Any:
        return (torque(t) - WEIGHT * np.cos(q) - VISCOUS * qd - DRY * w) / INERTIA

    def rates(t: float, x: np.ndarray) -> list[float]:
        q, qd, w = x
        return [qd, float(acceleration(t, q, qd, w)), (qd - abs(qd) * w) / LENGTH]

    solution = scipy.integrate.solve_ivp(
        rates, (0.0, time[-1]), [0.0, 0.0, 0.0], t_eval=time, rtol=1e-8, atol=1e-10
    )
    q, qd, w = solution.y
    columns = (q, qd, acceleration(time, q, qd, w), torque(time), w)
    return (time, *(x[:, None] for x in columns))


def patterns(swing: tuple[np.ndarray, ...], noise: float) -> jc.Patterns:
    time, q, qd, qdd, torque, _ = swing
    torque = torque + noise * np.random.default_rng(5).normal(size=q.shape)
    pairs = np.ones(q.shape, bool)
    return jc.Patterns(time, q, qd, qdd, torque, pairs, pairs)


def test_length_and_coefficients_of_a_simulated_joint(swing: tuple[np.ndarray, ...]) -> None:
    model = arms.pendulum("viscous", "dry")
    pairs = patterns(swing, 0.02)
    result = fit_pre_sliding(model, pairs)
    assert_allclose(result.presliding_distance, LENGTH, rtol=0.05)
    value = dict(zip(result.fit.names, np.asarray(result.fit.k), strict=True))
    for name, true in {"kB1": INERTIA, "kB2": WEIGHT / 9.81, "kv1": VISCOUS, "kd1": DRY}.items():
        assert_allclose(value[name], true, atol=0.03)
    plain = jc.LeastSquares().fit(model, pairs)
    assert np.all(result.fit.torque_error < 0.5 * plain.torque_error)
    assert result.relative[1].change < np.log(0.7)


def test_columns_that_nearly_vanish_for_a_while(swing: tuple[np.ndarray, ...]) -> None:
    """What rounding makes of columns is measured at some samples; the state has all of them."""
    time, q, qd, qdd, torque, _ = swing
    still = np.where(time[:, None] < 2.0, 1e-15, 1.0)
    everything = np.ones(q.shape, bool)
    pairs = jc.Patterns(time, q, still * qd, qdd, torque, everything, everything)
    model = arms.pendulum("viscous", "dry")
    along = along_motion(model, pairs, np.array([LENGTH]))
    fit = jc.LeastSquares().fit(along, pairs)
    rows = np.asarray(along.regressor(pairs.q, pairs.qd, pairs.qdd))[:, 0]
    assert_allclose(fit.k, np.linalg.lstsq(rows, torque[:, 0])[0], rtol=1e-6)


def test_slow_pairs_that_are_judged_but_not_fitted(swing: tuple[np.ndarray, ...]) -> None:
    """Coefficients are those of the mask, for the states; the length is the true one."""
    pairs = patterns(swing, 0.02)
    fast = np.abs(swing[2]) > 0.3 * np.max(np.abs(swing[2]))
    states = pairs.q, pairs.qd, pairs.qdd, pairs.torque
    masked = jc.Patterns(pairs.time, *states, fast, np.ones_like(fast))
    judged = np.ones_like(fast)  # a gain as large as its spread over stretches does here
    result = fit_pre_sliding(arms.pendulum("viscous", "dry"), masked, judged=judged, chance=0.5)
    assert_allclose(result.presliding_distance, LENGTH, rtol=0.1)
    w = np.asarray(contact_states(swing[1], result.presliding_distance, np.zeros(1)))
    columns = np.stack([swing[3], 9.81 * np.cos(swing[1]), -9.81 * np.sin(swing[1])], axis=2)
    rows = np.concatenate([columns, np.stack([swing[2], w], axis=2)], axis=2)[fast]
    expected = np.linalg.lstsq(rows, np.asarray(pairs.torque)[fast])[0]
    assert_allclose(result.fit.k, expected, atol=1e-6)


def test_torque_along_a_motion_goes_on_from_a_state(swing: tuple[np.ndarray, ...]) -> None:
    _, *motion, torque, w = swing
    result = fit_pre_sliding(arms.pendulum("viscous", "dry"), patterns(swing, 0.02))
    whole, end = result.torque(*motion)
    assert_allclose(whole, torque, atol=0.05)
    assert_allclose(end, w[-1], atol=0.05)
    _, middle = result.torque(*(x[:1000] for x in motion))
    later, _ = result.torque(*(x[999:] for x in motion), start=middle)
    assert_allclose(later, whole[999:], atol=1e-9)


def test_simulated_motion_is_that_of_another_integrator(swing: tuple[np.ndarray, ...]) -> None:
    time, q, qd, _, torque, w = swing
    model = arms.pendulum("viscous", "dry")
    true = {"kB1": INERTIA, "kB2": WEIGHT / 9.81, "kv1": VISCOUS, "kd1": DRY}
    k = np.array([true.get(name, 0.0) for name in model.names])
    # Torque that is held: the mean over each interval, by the trapezium.
    held, some = 0.5 * (torque[:-1] + torque[1:])[:400], slice(0, 401)
    start = q[0], qd[0], w[0]
    path = yielding_motion(model, k, np.array([LENGTH]), start, held, float(time[1]))
    for values, expected in zip(path, (q, qd, w), strict=True):
        assert_allclose(values, expected[some], atol=1e-3)
    length = np.array([LENGTH])
    simulated = simulate(
        model, k, q[:1], qd[:1], held[:, None], float(time[1]), presliding_distance=length
    )
    assert_allclose(simulated[:, 0], q[some], atol=1e-3)


def test_motion_that_slides_keeps_the_sign() -> None:
    model = arms.pendulum("viscous", "dry")
    t = 0.01 * np.arange(1500)[:, None]
    motion = np.sin(2 * t), 2 * np.cos(2 * t), -4 * np.sin(2 * t)
    k = np.array([0.5, 0.3, -0.1, 0.2, 0.4])
    noise = 0.05 * np.random.default_rng(3).normal(size=t.shape)
    pairs = np.ones(t.shape, bool)
    torque = np.asarray(model.torque(k, *motion)) + noise
    data = jc.Patterns(t[:, 0], *motion, torque, pairs, pairs)
    result = fit_pre_sliding(model, data)
    assert result.presliding_distance.tolist() == [0.0]
    assert_allclose(result.fit.k, jc.LeastSquares().fit(model, data).k, atol=1e-9)


def test_a_network_without_dry_friction() -> None:
    model = arms.pendulum("viscous")
    t = 0.01 * np.arange(50)[:, None]
    pairs = np.ones(t.shape, bool)
    with pytest.raises(ValueError, match="has no friction of kind 'dry'"):
        fit_pre_sliding(model, jc.Patterns(t[:, 0], t, t, t, t, pairs, pairs))
