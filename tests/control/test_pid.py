"""PID feedback and gravity compensation (2.7, 7.4.2)."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

import jaxcslc as jc
import sim
from jaxcslc.control import PID, Gravity, Reference


def test_the_law(rng: np.random.Generator) -> None:
    """Over a few samples, against the sums written out."""
    position, velocity, integral = rng.uniform(1, 10, (3, 2))
    pid = PID(2, position_gain=position, velocity_gain=velocity, integral_gain=integral)
    q, qd, at, rate = rng.normal(size=(4, 5, 2))
    state, total = pid.begin(q[0]), np.zeros(2)
    for i in range(5):
        torque, state = pid.step(state, Reference(at[i], rate[i], 0 * q[i]), q[i], 0.01, qd[i])
        error = at[i] - q[i]
        expected = position * error + integral * total + velocity * (rate[i] - qd[i])
        np.testing.assert_allclose(torque, expected, atol=1e-12)
        total = total + 0.01 * error


def test_saturation_cuts_off_and_holds_the_integral() -> None:
    pid = PID(2, position_gain=10.0, velocity_gain=0.0, integral_gain=5.0, torque_limit=1.0)
    q, at = np.zeros(2), np.array([5.0, 0.01])
    state, torque = pid.begin(q), np.zeros(2)
    for _ in range(10):
        torque, state = pid.step(state, Reference.at_rest(at), q, 0.1, q)
    np.testing.assert_allclose(state.integral, [0.0, 0.01])
    np.testing.assert_allclose(torque, [1.0, 0.1 + 5.0 * 0.009])


def test_gravity_is_the_networks(puma: jc.CSLC, puma_k: Array, rng: np.random.Generator) -> None:
    q = rng.uniform(-2, 2, (3, 6))
    pid = PID(6, position_gain=0.0, velocity_gain=0.0, gravity=Gravity(puma, puma_k))
    torque, _ = pid.step(pid.begin(q), Reference.at_rest(q), q, 0.002, 0 * q)
    np.testing.assert_allclose(torque, puma.gravity_term(puma_k, q), atol=1e-12)


def test_gravity_of_joints_is_the_abbreviated_gravity(rng: np.random.Generator) -> None:
    """Two ways from the same links: selected coefficients, and a transcription of B.3."""
    robot = jc.puma560()
    assert robot.links is not None
    network = jc.derive(robot)
    gravity = Gravity.of_joints(network, network.coefficients_from(robot.links), (2, 3))
    q = rng.uniform(-3, 3, (20, 6))
    np.testing.assert_allclose(
        gravity.torque(q), sim.AbbreviatedGravity.of(robot).torque(q), atol=1e-10
    )


def test_gravity_of_joints_with_base_parameters(rng: np.random.Generator) -> None:
    """With numeric lengths gravity shares coefficients with the mass matrix."""
    robot = jc.puma560()
    assert robot.links is not None
    network = jc.derive(robot, lengths="numeric")
    k = network.coefficients_from(robot.links)
    gravity = Gravity.of_joints(network, k, (2, 3))
    torque = np.asarray(gravity.torque(rng.uniform(-3, 3, (20, 6))))
    assert not torque[:, [0, 3, 4, 5]].any() and torque[:, [1, 2]].any()
    with pytest.raises(ValueError, match="no joint 7; expected 1 to 6"):
        Gravity.of_joints(network, k, (2, 7))


def test_transforms(rng: np.random.Generator) -> None:
    pid = PID(3, position_gain=[1.0, 2.0, 3.0], velocity_gain=0.5, torque_limit=2.0)
    q, qd, at = rng.normal(size=(3, 4, 3))
    reference = Reference(at, 0 * at, 0 * at)
    torque, state = pid.step(pid.begin(q), reference, q, 0.01, qd)
    again, _ = eqx.filter_jit(pid.step)(pid.begin(q), reference, q, 0.01, qd)
    np.testing.assert_allclose(again, torque, atol=1e-12)
    step = jax.jit(jax.vmap(pid.step, in_axes=(0, 0, 0, None, 0)))
    mapped, _ = step(pid.begin(q), reference, q, 0.01, qd)
    np.testing.assert_allclose(mapped, torque, atol=1e-12)
    assert state.integral.shape == q.shape
    slope_of = jax.grad(lambda x: pid.step(pid.begin(x), reference, x, 0.01, qd)[0].sum())
    slope = jax.jit(slope_of)(jnp.asarray(q))
    assert np.all(np.isfinite(slope))


def test_refusals() -> None:
    with pytest.raises(ValueError, match="integral_gain: expected one number or 2"):
        PID(2, position_gain=1.0, velocity_gain=1.0, integral_gain=[1.0])
    with pytest.raises(ValueError, match="torque_limit of joint 1 is nan"):
        PID(2, position_gain=1.0, velocity_gain=1.0, torque_limit=float("nan"))
