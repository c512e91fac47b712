"""Joints stay within their ranges, whatever is asked for."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

import jaxcslc as jc
from jaxcslc.control import PID, ComputedTorque, JointLimitAvoidance, Reference
from tests.control.conftest import SmallArm


RANGE = np.array([[-2.0, 2.0], [-2.2, 0.4], [-0.5, 2.5], [-1.5, 1.5], [-1.5, 1.5], [-3.0, 3.0]])
LIMIT = np.array([97.6, 186.4, 89.4, 24.2, 20.1, 21.3])
START = np.array([0.0, -1.0, 1.0, 0.0, 0.0, 0.0])


def _moved(
    puma: jc.CSLC, k: Array, controller: JointLimitAvoidance, target: np.ndarray
) -> np.ndarray:
    """Positions over 3 s under a controller that is sent to a target, by the model itself."""

    def onwards(carry: tuple[Array, ...], _: None) -> tuple[tuple[Array, ...], Array]:
        q, qd, state = carry
        torque, state = controller.step(state, Reference.at_rest(target), q, 0.002, qd)
        qd = qd + 0.002 * puma.forward_dynamics(k, q, qd, torque)
        return (q + 0.002 * qd, qd, state), q + 0.002 * qd

    start = (jnp.asarray(START), jnp.zeros(6), controller.begin(START))
    return np.asarray(jax.jit(lambda carry: jax.lax.scan(onwards, carry, length=1500))(start)[1])


def test_targets_beyond_the_range_are_not_reached(puma: jc.CSLC, puma_k: Array) -> None:
    """Every joint is sent half a radian past an end, by a PID controller that saturates."""
    k = puma.without_friction(puma_k)
    target = np.array([2.5, 0.9, -1.0, 2.0, -2.0, 3.5])
    pid = PID(6, position_gain=500.0, velocity_gain=20.0, integral_gain=50.0, torque_limit=LIMIT)
    kept = JointLimitAvoidance(pid, puma, k, RANGE, torque_limit=LIMIT)
    at = _moved(puma, k, kept, target)
    assert np.all(at > RANGE[:, 0] - 1e-3) and np.all(at < RANGE[:, 1] + 1e-3)
    ends = np.clip(target, RANGE[:, 0], RANGE[:, 1])
    np.testing.assert_allclose(at[-1], ends, atol=0.02)


def test_far_from_the_ends_nothing_changes(small_arm: SmallArm, rng: np.random.Generator) -> None:
    network, k = small_arm
    controller = ComputedTorque(network, k, 10.0, torque_limit=LIMIT[:2])
    kept = JointLimitAvoidance(controller, network, k, RANGE[:2], torque_limit=LIMIT[:2])
    q, qd = START[:2] + rng.uniform(-0.2, 0.2, (4, 2)), rng.uniform(-0.3, 0.3, (4, 2))
    reference = Reference(q + 0.01, qd, 0 * q)
    state = controller.begin(q)
    # Not compiled: as a part of another program, the same law may be rounded otherwise.
    np.testing.assert_array_equal(
        kept.step(state, reference, q, 0.002, qd)[0],
        controller.step(state, reference, q, 0.002, qd)[0],
    )


def test_the_bound_is_the_barriers(puma: jc.CSLC, puma_k: Array) -> None:
    """Pushed against an end, a joint accelerates as the barrier says, the others as they would."""
    controller = ComputedTorque(puma, puma_k, 30.0)
    kept = JointLimitAvoidance(controller, puma, puma_k, RANGE, torque_limit=1e3, rate=8.0)
    q, qd = START.copy(), np.full(6, 0.1)
    q[0] = 1.95
    wanted = Reference(q + np.array([1.0, 0, 0, 0, 0, 0]), qd, 0 * q)
    torque, _ = eqx.filter_jit(kept.step)(kept.begin(q), wanted, q, 0.002, qd)
    got = puma.forward_dynamics(puma_k, q, qd, torque)
    np.testing.assert_allclose(got[0], 64 * 0.05 - 16 * 0.1, atol=1e-8)
    np.testing.assert_allclose(got[1:], 0.0, atol=1e-8)


def test_refusals(puma: jc.CSLC, puma_k: Array) -> None:
    pid = PID(6, position_gain=1.0, velocity_gain=1.0)
    with pytest.raises(ValueError, match=r"position_range: expected shape \(6, 2\)"):
        JointLimitAvoidance(pid, puma, puma_k, RANGE[:3], torque_limit=1.0)
    with pytest.raises(ValueError, match="position_range of joint 2 is"):
        JointLimitAvoidance(
            pid, puma, puma_k, np.where(np.arange(6)[:, None] == 1, 0.0, RANGE), torque_limit=1.0
        )
    with pytest.raises(ValueError, match="k: expected shape"):
        JointLimitAvoidance(pid, puma, puma_k[:5], RANGE, torque_limit=1.0)
