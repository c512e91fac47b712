"""Friction averaged with a triangle over two intervals, against dense sums of the same."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from jaxcslc.likelihood import EquationPoint, MotionEquations
from tests import arms


SLOPE = 3.0


def averaged(
    kind: str,
    velocity: float,
    acceleration: float,
    h: tuple[float, float],
    turn: float,
    direction: float,
) -> tuple[float, float]:
    """The mean of friction alone with a coefficient of 1, and its derivative by the turn."""
    network = arms.turntable(kind)
    k = np.array([1.0 * (name != "kB1") for name in network.names])
    t = np.array([-h[0], 0.0, h[1]])
    q = (velocity * t + 0.5 * acceleration * t**2)[:, None]
    signs = np.full((1, 1), turn), np.full((1, 1), direction)
    equations = MotionEquations(network, np.array(h))
    at = EquationPoint(k, np.log([SLOPE]), q, *signs)
    result = equations.linearised(at)
    assert_allclose(equations.torque(at), result.torque, rtol=1e-12)
    return float(result.torque[0, 0]), float(result.by_turn[0, 0])


def dense(
    velocity: float, acceleration: float, h: tuple[float, float], turn: float, direction: float
) -> float:
    """The mean of sgn exp(-slope speed), its sign set by the turn, by a sum of many terms."""
    x = np.linspace(-1.0, 1.0, 400_001)
    length = np.where(x < 0.0, *h)
    weight = (1.0 - np.abs(x)) * length
    sign = np.where(x < turn, -direction, direction)
    speed = np.maximum(sign * (velocity + x * length * acceleration), 0.0)
    return float(np.sum(weight * sign * np.exp(-SLOPE * speed)) / np.sum(weight))


@pytest.mark.parametrize("turn", [-1.0, -0.4, 0.0, 0.3, 0.999])
@pytest.mark.parametrize("direction", [-1.0, 1.0])
def test_it_is_the_mean_over_both_intervals(turn: float, direction: float) -> None:
    acceleration = 4.0 * direction
    for h in ((0.05, 0.05), (0.02, 0.04)):
        at_turn = acceleration * turn * (h[0] if turn < 0.0 else h[1])
        velocity = 0.5 * direction if turn == -1.0 else -at_turn
        expected = dense(velocity, acceleration, h, turn, direction)
        obtained, _ = averaged("static", velocity, acceleration, h, turn, direction)
        # Two nodes in each part leave this much of the exponential's change over the interval.
        assert_allclose(obtained, expected, atol=2e-4)


def test_away_from_reversals_viscous_friction_is_that_of_the_mean_velocity() -> None:
    obtained, _ = averaged("viscous", 0.7, 2.0, (0.05, 0.05), -1.0, 1.0)
    assert_allclose(obtained, 0.7, rtol=1e-12)


@pytest.mark.parametrize("turn", [-0.3, 0.2])
def test_it_is_smooth_in_the_moment_of_the_turn(turn: float) -> None:
    step, motion = 1e-6, (0.01, 2.0, (0.05, 0.05))
    _, slope = averaged("static", *motion, turn, 1.0)
    up, down = (averaged("static", *motion, turn + s, 1.0)[0] for s in (step, -step))
    assert_allclose(slope, (up - down) / (2.0 * step), rtol=1e-6)
