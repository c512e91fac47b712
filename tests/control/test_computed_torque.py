"""Computed torque (2.7.1): the law itself, the response it promises, and what limits it."""

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from jaxtyping import Array

import jaxcslc as jc
import sim
from jaxcslc.control import COMPENSATIONS, ComputedTorque, Reference, error_gains, smooth_friction
from tests import arms
from tests.control.conftest import SmallArm


FREQUENCY = np.array([12.0, 10.0, 14.0, 18.0, 20.0, 16.0])
DAMPING = np.array([1.0, 0.7, 1.0, 0.5, 1.3, 0.9])
INTERVAL = 0.002


def _state(rng: np.random.Generator, *shape: int) -> tuple[Reference, np.ndarray, np.ndarray]:
    q, qd, at, rate, second = rng.uniform(-1.5, 1.5, (5, *shape, 6))
    return Reference(at, rate, second), q, qd


def test_the_law_is_equation_2_7_1(puma: jc.CSLC, puma_k: Array, rng: np.random.Generator) -> None:
    """τ = M (q̈_d + K_v ė + K_p e) + V + G + F, written out in NumPy."""
    controller = ComputedTorque(puma, puma_k, FREQUENCY, DAMPING)
    reference, q, qd = _state(rng, 4)
    torque, _ = controller.step(controller.begin(q), reference, q, INTERVAL, qd)
    mass = np.asarray(puma.mass_matrix(puma_k, q))
    wanted = (
        np.asarray(reference.qdd)
        + 2 * DAMPING * FREQUENCY * (np.asarray(reference.qd) - qd)
        + FREQUENCY**2 * (np.asarray(reference.q) - q)
    )
    expected = np.einsum("sij,sj->si", mass, wanted)
    expected += puma.velocity_term(puma_k, q, qd)
    expected += puma.gravity_term(puma_k, q)
    expected += puma.friction_term(puma_k, qd)
    np.testing.assert_allclose(torque, expected, atol=1e-9)


@pytest.mark.parametrize("choice", COMPENSATIONS)
def test_partial_compensation_leaves_terms_out(
    puma: jc.CSLC, puma_k: Array, rng: np.random.Generator, choice: str
) -> None:
    pose = np.array([0.0, -0.5, 0.3, 0.0, 0.2, 0.0])
    controller = ComputedTorque(puma, puma_k, FREQUENCY, compensation=choice, pose=pose)
    reference, q, qd = _state(rng)
    torque, _ = controller.step(controller.begin(q), reference, q, INTERVAL, qd)
    terms = COMPENSATIONS[choice]
    position, velocity = (np.asarray(gain) for gain in error_gains(FREQUENCY, 1.0))
    wanted = reference.qdd + velocity * (reference.qd - qd) + position * (reference.q - q)
    if "mass" in terms:
        expected = np.asarray(puma.mass_matrix(puma_k, q)) @ wanted
    else:
        expected = np.diag(np.asarray(puma.mass_matrix(puma_k, pose))) * wanted
    if "velocity" in terms:
        expected = expected + puma.velocity_term(puma_k, q, qd)
    if "gravity" in terms:
        expected = expected + puma.gravity_term(puma_k, q)
    if "friction" in terms:
        expected = expected + puma.friction_term(puma_k, qd)
    np.testing.assert_allclose(torque, expected, atol=1e-9)


def _oscillator(error: np.ndarray, rate: np.ndarray, time: np.ndarray) -> np.ndarray:
    """The error that the gains prescribe, (samples, joints): e" + 2 ζ ω e' + ω² e = 0."""
    response = np.empty((len(time), len(error)))
    for joint, (w, z) in enumerate(zip(FREQUENCY, DAMPING, strict=True)):
        system = np.array([[0.0, 1.0], [-w * w, -2 * z * w]])
        values, vectors = np.linalg.eig(system + 1e-9 * np.diag([1.0, -1.0]))
        start = np.linalg.solve(vectors, np.array([error[joint], rate[joint]], complex))
        modes = vectors[0] * start * np.exp(np.outer(time, values))
        response[:, joint] = np.real(modes.sum(axis=1))
    return response


def test_errors_follow_the_response_that_the_gains_prescribe(puma: jc.CSLC, puma_k: Array) -> None:
    """On MuJoCo's arm, which this package did not write; torque renewed every 0.2 ms."""
    robot = puma.robot
    assert robot.links is not None
    interval, samples = 2e-4, 1500
    model = mujoco.MjModel.from_xml_string(
        sim.mjcf(robot, viscous=robot.viscous, time_step=interval)
    )
    data = mujoco.MjData(model)
    k = puma.coefficients_from(robot.links, viscous=robot.viscous)
    controller = ComputedTorque(puma, k, FREQUENCY, DAMPING)
    step = eqx.filter_jit(controller.step)
    time = interval * np.arange(samples)
    middle, swing = np.array([0.2, -0.8, 0.9, 0.1, 0.6, -0.3]), np.full(6, 0.5)
    pace = np.array([2.0, 3.0, 2.5, 4.0, 3.5, 5.0])
    at = middle + swing * np.sin(np.outer(time, pace))
    rate = swing * pace * np.cos(np.outer(time, pace))
    second = -swing * pace**2 * np.sin(np.outer(time, pace))
    first = np.array([0.1, -0.08, 0.12, 0.2, -0.15, 0.1])
    data.qpos[:], data.qvel[:] = at[0] - first, rate[0]
    state, error = controller.begin(np.asarray(data.qpos)), np.empty((samples, 6))
    for sample in range(samples):
        error[sample] = at[sample] - data.qpos
        reference = Reference(at[sample], rate[sample], second[sample])
        data.ctrl[:], state = step(
            state, reference, np.array(data.qpos), interval, np.array(data.qvel)
        )
        mujoco.mj_step(model, data)
    prescribed = _oscillator(first, np.zeros(6), time)
    assert np.max(np.abs(error - prescribed) / np.abs(first)) < 0.01


def test_an_integral_takes_out_what_a_wrong_model_leaves(puma: jc.CSLC, puma_k: Array) -> None:
    """With gravity 30 % off, e settles at −M⁻¹ ΔG / K_p without an integral, and at 0 with one."""
    target = np.array([0.3, -0.7, 0.8, 0.2, 0.4, 0.1])
    k = puma.without_friction(puma_k)

    @eqx.filter_jit
    def last(controller: ComputedTorque) -> Array:
        def onwards(carry: tuple[Array, ...], _: None) -> tuple[tuple[Array, ...], None]:
            q, qd, state = carry
            torque, state = controller.step(state, Reference.at_rest(target), q, INTERVAL, qd)
            state = jnp.asarray(state)
            qd = qd + INTERVAL * puma.forward_dynamics(k, q, qd, torque)
            return (q + INTERVAL * qd, qd, state), None

        start = (jnp.asarray(target), jnp.zeros(6), jnp.asarray(controller.begin(target)))
        (q, _, _), _ = jax.lax.scan(onwards, start, length=1500)
        return q

    settled: dict[float, np.ndarray] = {}
    for gain in (0.0, 4000.0):
        controller = ComputedTorque(
            puma, k * jnp.where(jnp.arange(43) >= 26, 0.7, 1.0), 20.0, integral_gain=gain
        )
        settled[gain] = target - np.asarray(last(controller))
    missing = 0.3 * np.asarray(puma.gravity_term(k, target))
    expected = np.linalg.solve(np.asarray(puma.mass_matrix(k, target)), missing) / 20.0**2
    np.testing.assert_allclose(settled[0.0], expected, rtol=0.02, atol=1e-4)
    assert np.max(np.abs(settled[4000.0])) < 1e-6


def test_torque_stays_within_its_limits_and_the_integral_does_not_wind_up(
    puma: jc.CSLC, puma_k: Array
) -> None:
    limit = np.array(sim.puma560().maximum_torque)
    controller = ComputedTorque(puma, puma_k, 30.0, integral_gain=1000.0, torque_limit=limit)
    q, far = np.zeros(6), np.array([2.0, -2.0, 2.0, 0.01, -0.01, 0.01])
    state, torque = controller.begin(q), np.zeros(6)
    step = eqx.filter_jit(controller.step)
    for _ in range(50):
        torque, state = step(state, Reference.at_rest(far), q, INTERVAL, 0 * q)
        assert np.all(np.abs(torque) <= limit)
    saturated = np.abs(np.asarray(torque)) == limit
    assert saturated.any() and not saturated.all()
    integral = np.asarray(state)
    assert np.all(integral[saturated] == 0.0)
    np.testing.assert_allclose(integral[~saturated], 50 * INTERVAL * far[~saturated])
    # What leads back is taken up even at the limit.
    back = controller.step(jnp.asarray(far), Reference.at_rest(-0.1 * far), q, INTERVAL, 0 * q)[1]
    assert np.all(np.abs(back) < np.abs(far))


def test_friction_has_no_jump_at_rest(puma: jc.CSLC, puma_k: Array) -> None:
    width = np.full(6, 0.05)
    torque_at_rest = smooth_friction(puma, puma_k, np.zeros(6), width)
    np.testing.assert_allclose(torque_at_rest, 0.0, atol=1e-12)
    fast = np.array([0.05, -0.05, 0.3, -0.3, 1.0, -2.0])
    np.testing.assert_allclose(
        smooth_friction(puma, puma_k, fast, width), puma.friction_term(puma_k, fast), atol=1e-12
    )
    slope = jax.jacobian(lambda v: smooth_friction(puma, puma_k, v, width))(jnp.full(6, 0.01))
    edge = puma.friction_term(puma_k, width)
    np.testing.assert_allclose(np.diag(slope), np.asarray(edge) / width)
    np.testing.assert_array_equal(
        smooth_friction(puma, puma_k, fast, np.zeros(6)), puma.friction_term(puma_k, fast)
    )


def test_smooth_friction_of_coupled_joints() -> None:
    """A joint at rest beside one that moves: each one's speed is blunted by itself."""
    network = arms.coupled_arm("viscous")
    index = network.names.index("kcv1_2")
    k = jnp.zeros(network.size).at[index].set(1.0)
    qd, width = np.array([1.0, 0.0]), np.full(2, 0.1)
    np.testing.assert_allclose(
        smooth_friction(network, k, qd, width), network.friction_term(k, qd), atol=1e-12
    )


def test_friction_of_the_reference_breaks_a_resting_joint_away(
    puma: jc.CSLC, puma_k: Array
) -> None:
    robot = puma.robot
    q = np.array([0.0, -1.0, 1.0, 0.0, 0.5, 0.0])
    moving = Reference(q, np.full(6, 1e-3), np.zeros(6))
    at_rest = ComputedTorque(puma, puma_k, 0.0)
    wanted = ComputedTorque(puma, puma_k, 0.0, friction_at="reference")
    first, _ = at_rest.step(at_rest.begin(q), moving, q, INTERVAL, 0 * q)
    second, _ = wanted.step(wanted.begin(q), moving, q, INTERVAL, 0 * q)
    assert robot.dry is not None and robot.viscous is not None
    dry, viscous = np.array(robot.dry), np.array(robot.viscous)
    np.testing.assert_allclose(np.asarray(second - first), dry + 1e-3 * viscous, atol=1e-9)


def test_transforms(small_arm: SmallArm, rng: np.random.Generator) -> None:
    """Of the controller: networks have tests of their own."""
    network, k = small_arm
    controller = ComputedTorque(network, k, FREQUENCY[:2], torque_limit=50.0)
    q, qd, at, rate, second = rng.uniform(-1.5, 1.5, (5, 3, 2))
    reference = Reference(at, rate, second)

    def torque_of(k: Array) -> Array:
        one = controller.with_coefficients(k)
        return jnp.asarray(one.step(one.begin(q), reference, q, INTERVAL, qd)[0])

    together, state = controller.step(controller.begin(q), reference, q, INTERVAL, qd)
    again, _ = eqx.filter_jit(controller.step)(controller.begin(q), reference, q, INTERVAL, qd)
    np.testing.assert_allclose(again, together, atol=1e-9)
    # Controllers of different coefficients, side by side.
    vectors = k[None] * jnp.array([1.0, 1.3, 0.7])[:, None]
    mapped = jax.jit(jax.vmap(torque_of))(vectors)
    np.testing.assert_allclose(mapped[0], together, atol=1e-9)
    alone = ComputedTorque(network, vectors[2], FREQUENCY[:2], torque_limit=50.0)
    np.testing.assert_allclose(
        mapped[2], alone.step(alone.begin(q), reference, q, INTERVAL, qd)[0], atol=1e-9
    )
    assert state.shape == (3, 2)
    slope = jax.jit(jax.grad(lambda k: torque_of(k).sum()))(k)
    assert np.all(np.isfinite(slope)) and np.any(slope != 0.0)


def test_refusals(puma: jc.CSLC, puma_k: Array) -> None:
    with pytest.raises(ValueError, match="compensation is 'all'; expected 'full', 'no friction'"):
        ComputedTorque(puma, puma_k, 20.0, compensation="all")
    with pytest.raises(ValueError, match="compensation has 'inertia'"):
        ComputedTorque(puma, puma_k, 20.0, compensation=["inertia"])
    with pytest.raises(ValueError, match="k: expected shape"):
        ComputedTorque(puma, puma_k[:5], 20.0)
    with pytest.raises(ValueError, match="natural_frequency: expected one number or 6"):
        ComputedTorque(puma, puma_k, [20.0, 20.0])
    with pytest.raises(ValueError, match=r"damping of joint 2 is -1\.0; expected 0 or more"):
        ComputedTorque(puma, puma_k, 20.0, [1.0, -1.0, 1.0, 1.0, 1.0, 1.0])
    with pytest.raises(ValueError, match="friction_at is 'rest'"):
        ComputedTorque(puma, puma_k, 20.0, friction_at="rest")
