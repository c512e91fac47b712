"""Joints that stick: a bound of friction at break-away, as a censored observation."""

import numpy as np
import pytest
import scipy
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.likelihood import search
from jaxcslc.likelihood._laws import bound, sticking_equations
from tests import arms


STEP, INERTIA, VISCOUS, DRY = 0.005, 0.4, 0.3, 0.8


def test_the_bound_is_the_tail_of_a_normal_density() -> None:
    excess = np.array([-3.0, -0.5, 0.0, 1.0, 4.0])
    obtained = bound(excess)
    assert_allclose(obtained.value, -2.0 * scipy.stats.norm.logcdf(-excess), rtol=1e-12)
    step = 1e-4
    values = [bound(excess + shift).value for shift in (-step, 0.0, step)]
    slope = (values[2] - values[0]) / (2 * step)
    assert_allclose(2.0 * obtained.weight * obtained.residual, slope, rtol=1e-6)
    bend = (values[2] - 2.0 * values[1] + values[0]) / step**2
    assert_allclose(2.0 * obtained.weight, bend, rtol=1e-4, atol=1e-6)


def test_far_beyond_it_is_a_parabola() -> None:
    obtained = bound(np.array([29.9, 30.1, 1e3]))
    assert np.all(np.isfinite(obtained.value)) and np.all(np.diff(obtained.value) > 0.0)
    assert_allclose(obtained.weight[2] * obtained.residual[2], 1e3)


def test_rests_that_something_else_holds_say_nothing() -> None:
    at_rest = np.ones((60, 1), bool)
    friction = np.linspace(0.0, 1.0, 60)[:, None]
    assert sticking_equations(at_rest, friction, np.array([0.9])).sum() == 40
    assert not sticking_equations(at_rest, 5.0 * friction, np.array([0.9])).any()


def ramp(greatest: float) -> jc.Recording:
    """A disc that turns, stops, and bears a torque that does not break it away."""
    time = STEP * np.arange(1000)
    demand = 3.0 * np.sin(6.0 * time) * (time < 3.0)
    demand += greatest * np.clip((time - 4.0) / 0.8, 0.0, 1.0) * (time >= 4.0)
    q = qd = 0.0
    positions: list[float] = []
    substeps = 40
    for torque in demand:
        positions.append(q)
        for _ in range(substeps):
            if qd == 0.0 and abs(torque) <= greatest:
                continue
            sign = np.sign(qd) if qd else np.sign(torque)
            after = qd + STEP / substeps * (torque - VISCOUS * qd - sign * DRY) / INERTIA
            after = 0.0 if qd * after < 0.0 else after
            q, qd = q + 0.5 * STEP / substeps * (qd + after), after
    count = 2e-4
    return jc.Recording(
        time, count * np.round(np.array(positions) / count)[:, None], demand[:, None]
    )


@pytest.mark.parametrize("greatest", [1.05, 0.5])
def test_torque_that_friction_bears_bounds_break_away(greatest: float) -> None:
    network = arms.turntable("viscous", "dry", "static")
    result = jc.MaximumLikelihood().fit(network, ramp(greatest))
    value = dict(zip(result.fit.names, np.asarray(result.k), strict=True))
    assert value["kd1"] + value["ks1"] > greatest - 0.01
    assert_allclose([value["kB1"], value["kv1"]], [INERTIA, VISCOUS], rtol=0.05)


def test_friction_at_rest_is_expected_above_dry_friction() -> None:
    """Known beforehand: about as far above dry friction as that is large, hardly below it."""
    network = arms.turntable("dry", "static")
    time = 0.01 * np.arange(200)
    recording = jc.Recording(time, np.sin(2 * time)[:, None], np.cos(2 * time)[:, None])
    problem, (point, *_) = jc.MaximumLikelihood("held").start(network, [recording], None, 1)
    static = network.layout.indices("static")[0]
    deviation = []
    for value in (0.5, -0.5):
        k = np.array([1.0, 2.0, value])
        there = point.with_values(k=k)
        mean, precision = problem.known(there, there)
        assert mean[static] == 0.0
        deviation.append(precision[static] ** -0.5)
    assert_allclose(deviation, [2.0, 0.2])


@pytest.mark.parametrize("fixed", [False, True])
def test_bounds_say_nothing_of_coefficients_that_are_fixed(fixed: bool) -> None:
    network = arms.turntable("viscous", "dry")
    problem, (point, torque_noise, position_noise) = jc.MaximumLikelihood("held").start(
        network, [ramp(0.75)], None, 1
    )
    minimum = search(
        problem.fixing("k") if fixed else problem,
        point,
        torque_noise,
        position_noise,
        lambda words: None,
        fixed_levels=True,
        tolerance=1e-3,
    )
    assert (minimum.objective.motion.sticking is None) == fixed
