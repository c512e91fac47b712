"""The causal differentiator, and a controller behind encoders."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from scipy.integrate import solve_ivp

from jaxcslc.control import PID, LowPassChain, OutputFeedback, Reference


def test_each_interval_is_the_chains_exponential(rng: np.random.Generator) -> None:
    """Against SciPy's matrix exponential of the same chain, held input and ramp."""
    chain, interval = LowPassChain(15.0, lags=4), 0.013
    pole = 2 * np.pi * 15.0
    system = np.zeros((6, 6))  # four lags, the input and its slope
    system[:4, :4] = pole * (np.eye(4, k=-1) - np.eye(4))
    system[0, 4], system[4, 5] = pole, 1.0
    step = scipy.linalg.expm(system * interval)
    state = rng.normal(size=4)
    before, now = 0.3, -0.5
    ramp = step @ [*state, before, (now - before) / interval]
    constant = step @ [*state, before, 0.0]
    at = jnp.asarray(state)
    np.testing.assert_allclose(
        chain.step(at, np.array(before), np.array(now), interval), ramp[:4], atol=1e-12
    )
    np.testing.assert_allclose(
        chain.step(at, np.array(before), np.array(now), interval, hold="constant"),
        constant[:4],
        atol=1e-12,
    )


def test_rates_are_derivatives_of_the_filtered_signal() -> None:
    """Against an integration of the chain by SciPy, driven by a sinusoid."""
    chain, interval = LowPassChain(8.0, lags=4), 1e-3
    pole = 2 * np.pi * 8.0
    time = interval * np.arange(400)
    signal = np.sin(7.0 * time)

    def flow(t: float, y: np.ndarray) -> np.ndarray:
        return pole * (np.array([np.sin(7.0 * t), *y[:-1]]) - y)

    solution = solve_ivp(flow, (0, time[-1]), np.zeros(4), rtol=1e-10, atol=1e-12, t_eval=time).y
    state = chain.begin(np.array(0.0))
    step = jax.jit(chain.step)
    for i in range(1, len(time)):
        state = step(state, jnp.asarray(signal[i - 1]), jnp.asarray(signal[i]), interval)
    now = chain.read(state)
    exact = flow(time[-1], solution[:, -1])
    second = pole * (exact[-2] - exact[-1])
    np.testing.assert_allclose(now.value, solution[-1, -1], atol=1e-5)
    np.testing.assert_allclose(now.rate, exact[-1], atol=1e-4)
    np.testing.assert_allclose(now.second, second, atol=2e-3)


def test_no_time_changes_nothing(rng: np.random.Generator) -> None:
    chain = LowPassChain(10.0)
    state = jnp.asarray(rng.normal(size=(3, 2)))
    after = chain.step(state, np.zeros(2), np.zeros(2), 0.0)
    np.testing.assert_allclose(after, state, atol=1e-14)


def test_intervals_add_up(rng: np.random.Generator) -> None:
    """A ramp in two intervals of different lengths is the ramp in one."""
    chain = LowPassChain(np.array([10.0, 20.0]))
    state = jnp.asarray(rng.normal(size=(3, 2)))
    start, slope = rng.normal(size=(2, 2))
    half = chain.step(state, start, start + 0.003 * slope, 0.003)
    twice = chain.step(half, start + 0.003 * slope, start + 0.01 * slope, 0.007)
    once = chain.step(state, start, start + 0.01 * slope, 0.01)
    np.testing.assert_allclose(twice, once, atol=1e-12)


def test_transforms(rng: np.random.Generator) -> None:
    chain = LowPassChain(10.0)
    before, now = rng.normal(size=(2, 4, 3))
    state = chain.begin(before)
    together = chain.step(state, before, now, 0.01)
    np.testing.assert_allclose(jax.jit(chain.step)(state, before, now, 0.01), together)
    step = jax.jit(jax.vmap(chain.step, in_axes=(1, 0, 0, None), out_axes=1))
    mapped = step(state, before, now, 0.01)
    np.testing.assert_allclose(mapped, together)
    with_corner = jax.jit(jax.vmap(lambda f: LowPassChain(f).step(state, before, now, 0.01)))
    corners = with_corner(jnp.array([5.0, 10.0]))
    np.testing.assert_allclose(corners[1], together)


def test_a_loop_finds_its_velocities_from_readings() -> None:
    """On a ramp that is followed at a constant error, qd is the ramp's slope at once."""
    pid = PID(1, position_gain=0.0, velocity_gain=1.0)
    loop = OutputFeedback(pid, LowPassChain(30.0, lags=2))
    state, slope = loop.begin(np.zeros(1)), np.array([2.0])
    for n in range(1, 50):
        at = slope * 0.002 * n
        torque, state = loop.step(state, Reference(at, slope, 0 * at), at, 0.002)
        np.testing.assert_allclose(torque, 0.0, atol=1e-12)
    # A resting joint off the path: the rate of the error arrives through the filter.
    state, torque = loop.begin(np.zeros(1)), np.zeros(1)
    for n in range(1, 200):
        at = slope * 0.002 * n
        torque, state = loop.step(state, Reference(at, slope, 0 * at), np.zeros(1), 0.002)
    np.testing.assert_allclose(torque, slope, atol=1e-9)


def test_a_reading_that_has_not_come_does_no_lasting_harm() -> None:
    loop = OutputFeedback(PID(1, position_gain=10.0, velocity_gain=1.0), LowPassChain(30.0, lags=2))
    at, state = np.array([0.1]), loop.begin(np.zeros(1))
    for n in range(20):
        reading = np.full(1, np.nan) if n in (5, 6) else np.zeros(1)
        torque, state = loop.step(state, Reference.at_rest(at), reading, 0.002)
        assert np.all(np.isfinite(torque))


def test_refusals() -> None:
    with pytest.raises(ValueError, match=r"corner is 0\.0; expected more than 0 Hz"):
        LowPassChain(0.0)
    with pytest.raises(ValueError, match="lags is 1; expected 2 or more"):
        LowPassChain(5.0, lags=1)
