"""Friction at rest, the mean of before and after: literal loops, edges, every transform."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.friction import along_motion, state_at
from jaxcslc.recordings import at_rest, directions_beside
from jaxcslc.report import predicted_torque
from tests import arms


SAMPLES = 400


def velocities(rng: np.random.Generator) -> np.ndarray:
    """Three joints: with rests of several lengths, always moving, never moving."""
    qd = rng.normal(size=(SAMPLES, 3))
    for start, length in ((0, 7), (20, 4), (60, 5), (100, 80), (390, 10)):
        qd[start : start + length, 0] = 1e-6 * rng.normal(size=length)
    qd[120, 0] = 0.0
    qd[:, 2] = 0.0
    return qd


def literal_rests(qd: np.ndarray) -> np.ndarray:
    """Sample by sample: how long a joint has been, and stays, below 1e-4 of its top speed."""
    still = np.zeros(qd.shape, bool)
    for joint, speed in enumerate(np.abs(qd).T):
        run: list[int] = []
        for sample in range(len(speed) + 1):
            if sample < len(speed) and speed[sample] < 1e-4 * speed.max():
                run.append(sample)
                continue
            if len(run) >= 5:
                still[run, joint] = True
            run = []
    return still


def test_rests_and_directions_are_those_of_a_literal_loop(rng: np.random.Generator) -> None:
    qd = velocities(rng)
    still = literal_rests(qd)
    assert still[:, 0].sum() == 7 + 5 + 80 + 10 and not still[:, 1:].any()
    np.testing.assert_array_equal(at_rest(qd), still)
    np.testing.assert_array_equal(at_rest(jnp.asarray(qd)), still)
    before, after = np.zeros(qd.shape), np.zeros(qd.shape)
    for joint in range(qd.shape[1]):
        for expected, samples in ((before, range(len(qd))), (after, reversed(range(len(qd))))):
            last = 0.0
            for sample in samples:
                if not still[sample, joint]:
                    last = float(np.sign(qd[sample, joint]))
                expected[sample, joint] = last
    for directions in (
        directions_beside(qd, still),
        directions_beside(jnp.asarray(qd), jnp.asarray(still)),
    ):
        np.testing.assert_array_equal(directions[0], before)
        np.testing.assert_array_equal(directions[1], after)


@pytest.mark.parametrize("samples", [0, 1, 4])
def test_a_few_samples_hold_no_rest(samples: int) -> None:
    assert at_rest(np.zeros((samples, 2))).shape == (samples, 2)
    assert not at_rest(np.zeros((samples, 2))).any()


@pytest.fixture(scope="module")
def arm() -> tuple[jc.CSLC, np.ndarray]:
    """Two joints with all friction that has a direction, and random coefficients."""
    network = arms.planar_arm("viscous", "dry", "static", "offset").with_static_slopes([3.0, 7.0])
    return network, np.random.default_rng(3).normal(size=network.size)


def patterns_of(qd: np.ndarray, rng: np.random.Generator) -> jc.Patterns:
    q, qdd, torque = rng.normal(size=(3, *qd.shape))
    pairs = np.ones(qd.shape, bool)
    return jc.Patterns(0.01 * np.arange(len(qd)), q, qd, qdd, torque, pairs, pairs)


def test_friction_at_rest_is_the_mean_of_that_before_and_after(
    arm: tuple[jc.CSLC, np.ndarray], rng: np.random.Generator
) -> None:
    """The other terms are those of a joint that stands: written out, joint by joint."""
    network, k = arm
    patterns = patterns_of(velocities(rng)[:, :2], rng)
    still = literal_rests(np.asarray(patterns.qd))
    before, after = directions_beside(np.asarray(patterns.qd), still)
    named = dict(zip(network.names, k, strict=True))
    stopped = np.where(still, 0.0, patterns.qd)
    # At velocity 0 signs are 0: no dry and no static friction.
    expected = np.array(network.torque(k, patterns.q, stopped, patterns.qdd))
    for joint in range(2):
        whole = named[f"kd{joint + 1}"] + named[f"ks{joint + 1}"]
        expected[:, joint] += np.where(
            still[:, joint], 0.5 * whole * (before + after)[:, joint], 0.0
        )
    assert still.any()
    assert_allclose(predicted_torque(network, patterns, k), expected, rtol=1e-9, atol=1e-9)


def test_motion_without_rests_is_predicted_by_the_network(
    arm: tuple[jc.CSLC, np.ndarray], rng: np.random.Generator
) -> None:
    network, k = arm
    patterns = patterns_of(rng.normal(size=(SAMPLES, 2)), rng)
    expected = np.asarray(network.torque(k, patterns.q, patterns.qd, patterns.qdd))
    assert_allclose(predicted_torque(network, patterns, k), expected, rtol=1e-12, atol=1e-12)


def test_every_transform_agrees(arm: tuple[jc.CSLC, np.ndarray], rng: np.random.Generator) -> None:
    network, k = arm
    patterns = patterns_of(velocities(rng)[:, :2], rng)
    eager = np.asarray(predicted_torque(network, patterns, k))
    jitted = eqx.filter_jit(lambda p, k: predicted_torque(network, p, k))
    assert_allclose(jitted(patterns, jnp.asarray(k)), eager, rtol=1e-10, atol=1e-10)
    scales = jnp.array([1.0, 2.0])
    many = jax.vmap(lambda scale: jnp.asarray(predicted_torque(network, patterns, scale * k)))
    assert_allclose(many(scales), np.stack([eager, 2.0 * eager]), rtol=1e-10, atol=1e-10)
    # Torque is linear in the coefficients: its derivative along k is the torque itself.
    _, along = jax.jvp(
        lambda k: jnp.asarray(predicted_torque(network, patterns, k)),
        (jnp.asarray(k),),
        (jnp.asarray(k),),
    )
    assert_allclose(along, eager, rtol=1e-10, atol=1e-10)


def test_states_of_pre_sliding_are_left_alone(rng: np.random.Generator) -> None:
    """A joint with a length keeps what its state says, the other one half at the end."""
    robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0), (0, 0.4, 0, 0)], gravity=(0, 0, -9.81))
    network = jc.derive(robot.with_friction("dry"), lengths="numeric")
    patterns = patterns_of(rng.normal(size=(SAMPLES, 2)), rng)
    k, lengths = np.asarray(jc.LeastSquares().fit(network, patterns).k), np.array([0.01, 0.0])
    # Half a swing, and rest.
    time = 0.01 * np.arange(600)
    path = 0.3 * np.sin(np.minimum(time, 2.5))
    q = np.stack([path, path], axis=1)
    qd, zeros, pairs = np.gradient(q, 0.01, axis=0), np.zeros(q.shape), np.ones(q.shape, bool)
    patterns = jc.Patterns(time, q, qd, zeros, zeros, pairs, pairs)
    torque = predicted_torque(along_motion(network, patterns, lengths), patterns, k)
    state = state_at(patterns, lengths, len(time) - 1)
    named = dict(zip(network.names, k, strict=True))
    friction = np.asarray(torque)[-1]  # nothing accelerates, and no axis feels gravity
    assert_allclose(state, [-1.0, 0.0], atol=1e-3)
    assert_allclose(friction, [named["kd1"] * state[0], -0.5 * named["kd2"]], rtol=1e-9)
