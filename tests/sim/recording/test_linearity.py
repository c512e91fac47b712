"""The motor linearity experiment: what must lie on a line, and what above it."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
import scipy.special

import sim
from jaxcslc.manipulator import puma560
from sim.recording._linearity import MotorLinearity, _laden, _locked, motor_linearity


_AMPLITUDE = 0.05
# A swing of one second, once: quick, and small enough to take little torque for acceleration.
_QUICK: dict[str, Any] = {"period": 1.0, "swings": 1, "amplitude": _AMPLITUDE}
_MASSES = (0.0, 1.5, 3.0, 4.5)
# An encoder count of 7e-5 rad is worth 0.7 N m to the controller; the mean over 500 samples of what
# that does, and of a friction that is not quite symmetrical over a swing, stays below this.
_SCATTER = 0.02  # N m


@pytest.fixture(scope="module")
def linear() -> MotorLinearity:
    return motor_linearity(sim.puma560(), masses=_MASSES, **_QUICK)


def test_line_and_residuals_are_numpys(rng: np.random.Generator):
    mass, torque = np.array([2.0, 0.0, 1.0, 3.0, 0.0]), rng.normal(size=5)
    result = MotorLinearity.of(2, mass, torque)
    np.testing.assert_array_equal(result.mass, [0.0, 0.0, 1.0, 2.0, 3.0])
    np.testing.assert_array_equal(result.torque, torque[[1, 4, 2, 0, 3]])
    design = np.stack([np.ones(4), result.mass[:-1]], axis=-1)
    line, squares, *_ = np.linalg.lstsq(design, result.torque[:-1], rcond=None)
    np.testing.assert_allclose([result.intercept, result.slope], line, rtol=1e-12)
    np.testing.assert_allclose(result.scatter**2, squares[0] / 2)
    np.testing.assert_allclose(result.excess, torque[3] - line @ [1.0, 3.0])
    assert np.isnan(MotorLinearity.of(2, mass[[0, 1, 3]], torque[[0, 1, 3]]).scatter)


def test_slope_and_intercept_are_gravitys(linear: MotorLinearity):
    """Averaged over a sinusoid of amplitude A, the cosine of the angle is J₀(A)."""
    robot = puma560()
    assert robot.links is not None
    length = robot.length_values()
    lever = length["a2"] + length["d4"] + 0.05625
    mean = scipy.special.j0(_AMPLITUDE)
    np.testing.assert_allclose(linear.slope, -robot.gravity[2] * lever * mean, rtol=0.01)
    still = sim.AbbreviatedGravity.of(robot).torque(np.array([0, 0, np.pi / 2, 0, 0, 0]))
    np.testing.assert_allclose(linear.intercept, abs(still[1]) * mean, rtol=0.01)


def test_a_linear_motor_gives_a_line(linear: MotorLinearity):
    assert linear.scatter < _SCATTER
    assert abs(linear.excess) < 3 * _SCATTER


def test_beyond_the_limit_of_linearity_the_heaviest_lies_above():
    machine = dataclasses.replace(sim.puma560(), linear_torque=(math.inf, 75.0, *[math.inf] * 4))
    result = motor_linearity(machine, masses=_MASSES, **_QUICK)
    assert result.excess > 10 * _SCATTER


def test_friction_averages_out_also_when_it_is_lopsided(linear: MotorLinearity):
    """What it leaves is the same for every mass: the line is shifted, and no less straight."""
    machine = dataclasses.replace(sim.puma560(), asymmetry=(0.0, 0.3, 0.0, 0.0, 0.0, 0.0))
    result = motor_linearity(machine, masses=(0.0, 2.0, 4.0), **_QUICK)
    np.testing.assert_allclose(result.slope, linear.slope, rtol=0.02)
    shift = abs(result.intercept - linear.intercept)
    assert machine.dry[1] * 0.3 * 0.8 < shift < machine.static[1] * 0.3 * 1.2


def test_brakes_hold():
    machine = _laden(_locked(sim.puma560(), 2), 4.5)
    start = np.array([0.0, 0.0, np.pi / 2, 0.0, 0.0, 0.0])
    zero = np.zeros(6)
    controller = sim.SinusoidalTorque(zero, np.ones(6), zero)  # nothing holds joint 2
    _, truth = sim.simulate(machine, sim.Trajectory("drop", start, controller, 200))
    assert truth.position[-1, 1] - truth.position[0, 1] > 0.3
    others = [0, 2, 3, 4, 5]
    # A tenth of an encoder count.
    assert np.abs(truth.position[-1] - truth.position[0])[others].max() < 7e-6


def test_a_weight_is_a_point_mass_on_the_flange():
    machine = sim.puma560()
    laden, bare = _laden(machine, 2.0).robot.links, machine.robot.links
    assert laden is not None
    assert bare is not None
    assert laden[:5] == bare[:5]
    at = np.array([0.0, 0.0, 0.05625])
    np.testing.assert_allclose(laden[5].mass, bare[5].mass + 2.0)
    np.testing.assert_allclose(laden[5].first_moment, bare[5].first_moment + 2.0 * at)
    np.testing.assert_allclose(
        laden[5].inertia_at_frame,
        bare[5].inertia_at_frame + 2.0 * (at @ at * np.eye(3) - np.outer(at, at)),
        atol=1e-15,
    )


def test_seeds_repeat():
    once, again = (
        motor_linearity(sim.puma560(), masses=(0, 1, 2), period=0.4, swings=1, seed=4)
        for _ in range(2)
    )
    np.testing.assert_array_equal(once.torque, again.torque)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"joint": 7}, "joint is 7; expected one from 1 to 6"),
        ({"masses": (0, -1, 2)}, "masses have -1; expected zero or more"),
        ({"masses": (0, 0, 0, 1)}, "masses have 2 different values; expected three or more"),
        ({"swings": 0}, "swings is 0; expected one or more"),
    ],
)
def test_what_cannot_be_measured_is_refused(change: dict[str, Any], message: str):
    with pytest.raises(sim.MachineError, match=message):
        motor_linearity(sim.puma560(), **change)
