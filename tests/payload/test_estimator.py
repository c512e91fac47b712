"""A payload identified while it is carried (8.2.4)."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

import jaxcslc as jc
import sim
from jaxcslc.bodies import nearest_body, pseudo_inertia
from jaxcslc.control import ComputedTorque, LowPassChain, OutputFeedback
from jaxcslc.payload import PayloadCompensation, PayloadEstimate, PayloadEstimator, torque_noise
from scripts.studies.payload.loops import LoopBatch
from tests import arms


BODY = jc.LinkParameters(1.0, np.array([0.02, -0.03, 0.10]), 0.002 * np.eye(3))
START = np.array([0.0, -1.2, 0.6, 0.3, 0.5, 0.2])
POSES = START + np.array(
    [
        [0.3, 0.3, -0.2, -0.1, 0.3, -0.5],
        [0.9, 0.8, -0.4, -0.9, -1.2, 0.8],
        [0.2, 0.2, 0.0, 0.5, 0.4, -1.2],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    ]
)
PATH = sim.ViaPoints(POSES, np.full(4, 1.0), np.array([0.4, 0.1, 0.4, 0.2]))
PICKED, PLACED = 1.2, 3.8  # standing at the first and the third pose [s]
SAMPLES = 2450
MACHINE = sim.disturbed(sim.puma560(), "quantisation")
NOISE = np.array([2e-4, 2e-4, 3e-5, 2e-6, 2e-6, 2e-6])
SLOWEST = np.array([0.1, 0.1, 0.1, 0.3, 0.3, 0.3])


@pytest.fixture(scope="module")
def arm_k(puma: jc.CSLC) -> Array:
    assert puma.robot.links is not None
    return puma.coefficients_from(puma.robot.links, viscous=MACHINE.viscous, dry=MACHINE.dry)


@pytest.fixture(scope="module")
def estimator(puma: jc.CSLC, arm_k: Array) -> PayloadEstimator:
    return PayloadEstimator(puma, arm_k, NOISE, velocity_threshold=SLOWEST)


def _carried(
    puma: jc.CSLC,
    k: Array,
    estimator: PayloadEstimator,
    loads: tuple[sim.Load, ...],
    samples: int = SAMPLES,
) -> list[sim.ClosedLoop]:
    """Without and with compensation, side by side."""
    controller = ComputedTorque(
        puma,
        k,
        20.0,
        friction_at="reference",
        friction_width=0.02,
        torque_limit=np.array(MACHINE.maximum_torque),
    )

    # One after the other: side by side, the estimator would update at every sample.
    loops = LoopBatch.of(
        [
            PayloadCompensation(controller, estimator, compensation_gain=jnp.asarray(gain))
            for gain in (0.0, 1.0)
        ]
    )
    trajectory = sim.Trajectory("carrying", START, loops, samples, loads=loads, path=PATH)

    def seen(state: Any) -> dict[str, Array]:
        return state.estimator.estimate._asdict()

    results = sim.close_loop([MACHINE] * 2, trajectory, [7, 7], observe=seen)
    assert all(isinstance(result, sim.ClosedLoop) for result in results)
    return [result for result in results if isinstance(result, sim.ClosedLoop)]


@pytest.fixture(scope="module")
def carried(puma: jc.CSLC, arm_k: Array, estimator: PayloadEstimator) -> list[sim.ClosedLoop]:
    return _carried(puma, arm_k, estimator, (sim.Load(PICKED, BODY, stop=PLACED),))


def test_mass_and_centre_within_two_seconds_of_motion(carried: list[sim.ClosedLoop]) -> None:
    """Of a payload that MuJoCo carries, from encoder counts."""
    result = carried[1]
    observed, time = result.observed, result.truth.time
    at = np.searchsorted(time, 3.4)  # 1.9 s after the arm began to move with it, 0.1 s of it still
    assert abs(observed["mass"][at] - 1.0) < 0.02
    assert np.max(np.abs(observed["centre"][at] - BODY.centre_of_gravity)) < 0.005
    assert observed["carrying"][at]


def test_what_is_handed_out_can_exist(carried: list[sim.ClosedLoop]) -> None:
    for body in carried[1].observed["body"][::7]:
        values = np.linalg.eigvalsh(pseudo_inertia(body))
        assert np.min(values) > -1e-14 * np.max(values)


def test_picking_up_and_putting_down_are_noticed(carried: list[sim.ClosedLoop]) -> None:
    observed = carried[1].observed
    resumed = {PICKED: 1.4, PLACED: 3.9}  # an arm at rest determines nothing
    assert 0 < observed["picked_up"][-1] - resumed[PICKED] < 1.0
    assert 0 < observed["put_down"][-1] - resumed[PLACED] < 1.0
    assert np.count_nonzero(np.diff(observed["carrying"])) == 2  # and not lost in between
    before = carried[1].truth.time < resumed[PICKED]
    assert not observed["carrying"][before].any() and not observed["carrying"][-1]
    assert np.all(observed["picked_up"][before] == -1.0)


def test_compensation_tracks_better(carried: list[sim.ClosedLoop]) -> None:
    time = carried[0].truth.time
    wanted = np.asarray(PATH.reference(time[:, None], np.tile(START, (len(time), 1))).q)
    settled = (time > 2.6) & (time < PLACED)
    uncompensated, compensated = (
        np.sqrt(np.mean((result.truth.position - wanted)[settled] ** 2)) for result in carried
    )
    assert compensated < 0.6 * uncompensated


def test_nothing_is_found_where_nothing_is(
    puma: jc.CSLC, arm_k: Array, estimator: PayloadEstimator
) -> None:
    observed = _carried(puma, arm_k, estimator, (), 1000)[1].observed
    assert not observed["carrying"].any()
    assert observed["mass"][-1] < 0.05 and np.all(observed["picked_up"] == -1.0)


@eqx.filter_jit
def _scanned(estimator: PayloadEstimator, q: Array, torque: Array) -> PayloadEstimate:
    def onwards(state: Any, signal: tuple[Array, Array]) -> tuple[Any, Any]:
        state = estimator.step(state, signal[0], signal[1], 0.002)
        return state, state.estimate

    return jax.lax.scan(onwards, estimator.begin(q[0]), (q, torque))[1]


@pytest.fixture(scope="module")
def smooth(puma: jc.CSLC, arm_k: Array) -> tuple[Array, Array, Array]:
    """Exact readings and torques of a loaded arm, and k with the payload."""
    loaded = puma.with_payload()
    robot = puma.robot
    assert robot.links is not None
    k = loaded.coefficients_from(
        robot.links, viscous=MACHINE.viscous, dry=MACHINE.dry, payload=BODY
    )
    pace = jnp.array([2.0, 3.0, 2.5, 4.0, 3.5, 5.0])

    def path(time: Array) -> Array:  # from rest, unaccelerated
        return jnp.asarray(START) + 0.4 * jnp.sin(pace * time) * time**3 / (0.1 + time**3)

    time = jnp.asarray(0.002 * np.arange(1500))
    rate = jax.jacfwd(path)
    motion = (path, rate, jax.jacfwd(rate))
    q, qd, qdd = (jax.jit(jax.vmap(function))(time) for function in motion)
    # Held torques are half an interval late.
    later = loaded.torque(k, q, qd, qdd)
    return q, 0.5 * (later + jnp.roll(later, -1, axis=0)), k


def test_it_is_least_squares_on_filtered_signals(
    puma: jc.CSLC, arm_k: Array, smooth: tuple[Array, Array, Array]
) -> None:
    """Without forgetting: NumPy's over the same equations and prior, then a general solver."""
    q, torque, _ = smooth
    q, torque = q[:400], torque[:400]
    chain = LowPassChain(8.0, lags=4)
    estimator = PayloadEstimator(
        puma,
        arm_k,
        NOISE,
        velocity_threshold=SLOWEST,
        forgetting_time=1e9,
        detection_threshold=1e9,
        filter=chain,
    )
    estimates = _scanned(estimator, q, torque)
    motion, effort = chain.begin(q[0]), chain.begin(torque[0])
    rows, values = [np.diag(1 / np.array([0.2] * 6 + [1.0] * 3 + [5.0]))], [np.zeros(10)]
    step = jax.jit(chain.step, static_argnames="hold")
    read, regressor = jax.jit(chain.read), jax.jit(estimator.network.regressor)
    layout = estimator.network.layout
    for n in range(400):
        if n:
            motion = step(motion, q[n - 1], q[n], 0.002)
            effort = step(effort, torque[n - 1], torque[n], 0.002, hold="constant")
        if (n + 1) % estimator.update_every == 0:
            at = read(motion)
            columns = np.asarray(regressor(*at))
            weight = np.sqrt(np.where(np.abs(at.rate) > SLOWEST, 0.02 / NOISE, 0.0))
            of_arm = columns[:, layout.unloaded] @ np.asarray(arm_k)
            residual = np.asarray(read(effort).value) - of_arm
            rows.append(weight[:, None] * columns[:, layout.payload])
            values.append(weight * residual)
    a, b = np.concatenate(rows), np.concatenate(values)
    covariance = np.linalg.inv(a.T @ a)
    np.testing.assert_allclose(estimates.covariance[-1], covariance, rtol=1e-6, atol=1e-12)
    solution = np.linalg.lstsq(a, b)[0]
    possible = nearest_body(solution, covariance, least=1e-6)
    assert possible is not None
    apart = np.asarray(estimates.body[-1]) - possible
    assert apart @ (a.T @ a) @ apart < 0.1


def test_the_arms_uncertainty_is_carried_along(
    puma: jc.CSLC, arm_k: Array, smooth: tuple[Array, Array, Array], rng: np.random.Generator
) -> None:
    """Wrong coefficients of the arm move the estimate as far as its covariance says."""
    q, torque, _ = smooth
    spread = 0.01 * np.abs(np.asarray(arm_k)) + 1e-4
    exact = PayloadEstimator(
        puma, arm_k, NOISE, velocity_threshold=SLOWEST, detection_threshold=1e9
    )
    unsure = eqx.tree_at(lambda e: e.covariance, exact, jnp.diag(jnp.asarray(spread**2)))
    wider = _scanned(unsure, q, torque)
    narrow = _scanned(exact, q, torque)
    assert np.all(np.asarray(wider.mass_error[-1]) > np.asarray(narrow.mass_error[-1]))
    moved = []
    for _ in range(12):
        other = eqx.tree_at(
            lambda e: e.k, exact, exact.k + jnp.asarray(spread * rng.normal(size=43))
        )
        moved.append(float(_scanned(other, q, torque).mass[-1] - narrow.mass[-1]))
    expected = np.sqrt(float(wider.mass_error[-1]) ** 2 - float(narrow.mass_error[-1]) ** 2)
    assert 0.5 < np.std(moved) / expected < 2.0


def test_torque_noise_is_a_spectral_density(puma: jc.CSLC, arm_k: Array) -> None:
    rng = np.random.default_rng(4)
    time = 0.002 * np.arange(20000)
    q = np.zeros((len(time), 6))
    exact = np.asarray(puma.torque(arm_k, q, q, q))
    noise = 0.3 * rng.normal(size=q.shape)
    everything = np.ones(q.shape, bool)
    patterns = jc.Patterns(time, q, q, q, exact + noise, everything, everything)
    np.testing.assert_allclose(torque_noise(puma, arm_k, patterns), 0.3**2 * 0.002, rtol=0.4)
    # Left-out samples do not count, and do not make the rest look shorter than it is.
    half = everything & (rng.uniform(size=q.shape) < 0.7)
    wild = dataclasses.replace(
        patterns, torque=np.where(half, patterns.torque, 1e3), backlash_mask=half
    )
    np.testing.assert_allclose(torque_noise(puma, arm_k, wild), 0.3**2 * 0.002, rtol=0.5)
    with pytest.raises(ValueError, match="joint 1: 2 blocks of 20 s in which it moves"):
        torque_noise(puma, arm_k, patterns, block=20.0)


def test_refusals(puma: jc.CSLC, arm_k: Array, estimator: PayloadEstimator) -> None:
    with pytest.raises(ValueError, match="fixed: expected 43 coefficients"):
        PayloadEstimator(puma, arm_k[:4], NOISE)
    with pytest.raises(ValueError, match="noise: expected 6 values, one a joint"):
        PayloadEstimator(puma, arm_k, NOISE[:2])
    with pytest.raises(ValueError, match="expected more than 0"):
        PayloadEstimator(puma, arm_k, 0 * NOISE)
    small = arms.turntable()
    with pytest.raises(ValueError, match="expected the same network"):
        PayloadCompensation(ComputedTorque(small, np.ones(small.size), 5.0), estimator)
    assert OutputFeedback(ComputedTorque(puma, arm_k, 5.0)).filter.lags == 2
