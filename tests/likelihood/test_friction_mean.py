"""Friction averaged with a triangle over two intervals, against dense sums of the same."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from jaxcslc.likelihood._friction_mean import mean_inputs
from jaxcslc.network import JOINT_LAWS


SLOPE = 3.0


def averaged(
    law: object,
    velocity: float,
    change: float,
    turn: float,
    direction: float,
    share: float = 0.5,
) -> float:
    rows = [jnp.full((1, 1), float(x)) for x in (0.0, velocity, change, change)]
    others = [jnp.full((1, 1), float(x)) for x in (share, turn, direction)]
    return float(mean_inputs(law, *rows, *others)[0][0, 0])  # type: ignore[arg-type]


def dense(velocity: float, change: float, turn: float, direction: float, share: float) -> float:
    """The mean of sgn exp(-slope speed), its sign set by the turn, by a sum of many terms."""
    x = np.linspace(-1.0, 1.0, 400_001)
    weight = (1.0 - np.abs(x)) * np.where(x < 0.0, share, 1.0 - share)
    sign = np.where(x < turn, -direction, direction)
    speed = np.maximum(sign * (velocity + x * change), 0.0)
    return float(np.sum(weight * sign * np.exp(-SLOPE * speed)) / np.sum(weight))


@pytest.mark.parametrize("turn", [-1.0, -0.4, 0.0, 0.3, 0.999])
@pytest.mark.parametrize("direction", [-1.0, 1.0])
def test_it_is_the_mean_over_both_intervals(turn: float, direction: float) -> None:
    law = JOINT_LAWS["static"].with_slopes(np.array([SLOPE]))
    change = 0.2 * direction
    velocity = 0.5 * direction if turn == -1.0 else -turn * change
    for share in (0.5, 0.3):
        expected = dense(velocity, change, turn, direction, share)
        obtained = averaged(law, velocity, change, turn, direction, share)
        # Two nodes in each part leave this much of the exponential's change over the interval.
        assert_allclose(obtained, expected, atol=2e-4)


def test_away_from_reversals_viscous_friction_is_that_of_the_mean_velocity() -> None:
    assert_allclose(averaged(JOINT_LAWS["viscous"], 0.7, 0.1, -1.0, 1.0), 0.7, rtol=1e-14)


def test_it_is_smooth_in_the_moment_of_the_turn() -> None:
    law = JOINT_LAWS["static"].with_slopes(np.array([SLOPE]))

    def of_turn(turn: jax.Array) -> jax.Array:
        one = jnp.ones((1, 1))
        rows = (0 * one, 0.01 * one, 0.1 * one, 0.1 * one, 0.5 * one, turn * one, one)
        return mean_inputs(law, *rows)[0][0, 0]

    for turn in (-0.3, 0.2):
        slope = float(jax.grad(of_turn)(jnp.asarray(turn)))
        step = 1e-6
        central = (of_turn(jnp.asarray(turn + step)) - of_turn(jnp.asarray(turn - step))) / 2 / step
        assert_allclose(slope, float(central), rtol=1e-6)
