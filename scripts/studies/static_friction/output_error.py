"""Fits simulated to recorded motion over windows: no derivative is ever taken of a recording.

Between two samples the demand is held (7.4), so that a model that is given where a joint is, how
fast it moves, and the demands, says where it will be at the samples that follow. A window is a
stretch of samples in which no joint is at rest; its first positions and velocities are unknowns of
its own, eliminated from the equations of the coefficients.

Where a joint turns round within a step of integration, friction counts by its mean over the step,
whose velocity is taken as a line: the instant of the turn, and what every coefficient does to it,
is then part of the equations, as it has to be where a force jumps.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

import jaxcslc as jc


STEPS = 4  # of integration between two samples
OUTLIER = 36.0  # times the usual mean square of a window
DAMPING = 0.01  # to begin with
RESTING = 10  # samples
FEWEST = 8  # samples of a window: it has two unknowns a joint


class Windows(NamedTuple):
    """Which samples belong together.

    - `rows`: (windows, samples) of the recording, the last repeated behind a window's end.
    - `within`: (windows, samples) False behind the end.
    """

    rows: Int[np.ndarray, "windows samples"]
    within: Bool[np.ndarray, "windows samples"]


def windows_of(
    velocity: Float[np.ndarray, "samples joints"], *, length: int, slowest: float, trim: int
) -> Windows:
    """Stretches of at most `length` samples in which no joint rests.

    A joint rests that is slower than `slowest` [rad/s] for `RESTING` samples or more: one that
    turns round is slow for fewer. `trim` samples at both ends have no velocity to be trusted.
    """
    resting = np.zeros(len(velocity), dtype=bool)
    resting[:trim] = resting[len(velocity) - trim :] = True
    for slow in (np.abs(velocity) < slowest).T:
        for start, end in _runs(slow):
            resting[start:end] |= end - start >= RESTING
    parts = [
        part
        for start, end in _runs(~resting)
        for part in np.array_split(np.arange(start, end), -(-(end - start) // length))
        if len(part) >= FEWEST
    ]
    rows = [np.pad(part, (0, length - len(part)), mode="edge") for part in parts]
    within = [np.arange(length) < len(part) for part in parts]
    shape = (len(parts), length)
    return Windows(np.reshape(rows, shape).astype(int), np.reshape(within, shape).astype(bool))


def _runs(marked: Bool[np.ndarray, " samples"]) -> list[tuple[int, int]]:
    """Where stretches of marked samples begin, and the samples behind their ends."""
    edges = np.diff(marked.astype(int), prepend=0, append=0)
    pairs = zip(np.flatnonzero(edges > 0), np.flatnonzero(edges < 0), strict=True)
    return [(int(start), int(end)) for start, end in pairs]


@dataclasses.dataclass(frozen=True)
class WindowFit:
    """What a fit of windows found; `error` is for independent residuals."""

    k: Float[np.ndarray, " coefficients"]
    slopes: Float[np.ndarray, " joints"]
    error: Float[np.ndarray, " coefficients"]
    slope_error: Float[np.ndarray, " joints"]
    residual: Float[np.ndarray, " joints"]
    windows: int
    steps: int


def fit_windows(
    network: jc.CSLC,
    k: Float[np.ndarray, " coefficients"],
    recording: jc.Recording,
    windows: Windows,
    motion: tuple[Float[np.ndarray, "samples joints"], Float[np.ndarray, "samples joints"]],
    *,
    rounds: int = 40,
) -> WindowFit:
    """Coefficients and slopes by Gauss and Newton's method from `network`'s own slopes and `k`.

    `motion` is smoothed positions and velocities to start each window from. Joints are weighted by
    their residuals; windows whose residual is beyond six times what is usual are left out.
    """
    n = network.joint_count
    theta = jnp.concatenate([jnp.asarray(k), jnp.log(jnp.asarray(network.static_slopes, float))])
    states = jnp.concatenate([jnp.asarray(x)[windows.rows[:, 0]] for x in motion], axis=1)
    measured = jnp.asarray(recording.position)[windows.rows]
    demands = jnp.asarray(recording.torque)[windows.rows]
    within = jnp.asarray(windows.within, float)
    interval = float(np.median(np.diff(recording.time)))
    data = (measured, demands)
    step = jnp.asarray(interval)

    def equations(theta: Array, states: Array) -> "_System":
        return _equations(network, theta, states, (*data, within), step, scale)

    # What joints are weighted by, and windows that something has disturbed: with the states fitted
    # linearly, residuals are next to noise from the first.
    scale = jnp.full(n, 1.0)
    scale = equations(theta, states).rms
    system = equations(theta, states)
    within = within * (system.each < OUTLIER * jnp.median(system.each))[:, None]
    system = equations(theta, states)
    damping, settled, number = DAMPING, False, 0
    while number < rounds and not settled:
        number += 1
        change, moves = _step(system, damping)
        tried = equations(theta + change, states + moves)
        if float(tried.cost) <= float(system.cost):  # and not NaN
            settled = float(system.cost) - float(tried.cost) < 1e-5 * float(tried.cost)
            theta, states, system = theta + change, states + moves, tried
            damping /= 10.0
        else:
            damping *= 10.0
            settled = damping > 1e6
    errors = np.asarray(_errors(system))
    p = network.size
    slopes = np.exp(np.asarray(theta[p:]))
    return WindowFit(
        np.asarray(theta[:p]),
        slopes,
        errors[:p],
        slopes * errors[p:],
        np.asarray(system.rms),
        int(np.sum(np.asarray(within)[:, 0])),
        number,
    )


class _System(NamedTuple):
    """Linearised equations; those of states are solved window by window."""

    normal: Float[Array, "windows unknowns unknowns"]
    right: Float[Array, "windows unknowns"]
    solve_states: Float[Array, "windows states _"]  # minus the states' reply to the unknowns
    states: Float[Array, "windows states"]
    cost: Float[Array, ""]
    each: Float[Array, " windows"]
    freedom: Float[Array, ""]
    rms: Float[Array, " joints"]


@jax.jit
def _step(system: _System, damping: float) -> tuple[Array, Array]:
    normal = jnp.sum(system.normal, axis=0)
    size = jnp.sqrt(jnp.diag(normal))
    scaled = normal / (size[:, None] * size[None, :]) + damping * jnp.eye(size.size)
    step = jnp.linalg.solve(scaled, jnp.sum(system.right, axis=0) / size) / size
    return step, system.states - jnp.einsum("wsu,u->ws", system.solve_states, step)


@jax.jit
def _errors(system: _System) -> Array:
    """Standard errors for residuals that are independent, as those of encoders' steps are."""
    normal = jnp.sum(system.normal, axis=0)
    size = jnp.sqrt(jnp.diag(normal))
    inverse = jnp.linalg.inv(normal / (size[:, None] * size[None, :]))
    variance = system.cost / (system.freedom - size.size)
    return jnp.sqrt(variance * jnp.diag(inverse)) / size


def _window_equations(
    network: jc.CSLC, theta: Array, state: Array, data: tuple[Array, ...], interval: Array,
    scale: Array,
) -> tuple[Array, ...]:  # fmt: skip
    measured, demands, within = data
    n = network.joint_count
    own = within[:, None] / scale[None, :]

    def residual(unknowns: Array, state: Array) -> Array:
        path = _path(network, unknowns, state, demands, interval)
        return ((measured - path) * own).reshape(-1)

    left = residual(theta, state)
    by_theta, by_state = jax.jacfwd(residual, argnums=(0, 1))(theta, state)
    q, r = jnp.linalg.qr(by_state)
    reply = jax.scipy.linalg.solve_triangular(r, q.T @ by_theta)
    moves = -jax.scipy.linalg.solve_triangular(r, q.T @ left)
    rest = left - q @ (q.T @ left)
    kept = by_theta - q @ (q.T @ by_theta)
    squares = (rest.reshape(-1, n) * scale[None, :]) ** 2
    return kept.T @ kept, -(kept.T @ rest), reply, moves, jnp.sum(rest**2), jnp.sum(squares, axis=0)


@jax.jit
def _equations(
    network: jc.CSLC, theta: Array, states: Array, data: tuple[Array, ...], interval: Array,
    scale: Array,
) -> _System:  # fmt: skip
    normal, right, reply, moves, each, squares = jax.vmap(
        lambda state, own: _window_equations(network, theta, state, own, interval, scale)
    )(states, data)
    n, within = network.joint_count, data[2]
    used = within[:, 0] > 0
    # Of each joint, two unknowns a window are fitted away.
    freedom = jnp.sum(within) - 2 * jnp.sum(used)
    each_mean = jnp.where(used, each / jnp.maximum(jnp.sum(within, axis=1), 1.0), 0.0)
    return _System(
        jnp.where(used[:, None, None], normal, 0.0),
        jnp.where(used[:, None], right, 0.0),
        jnp.where(used[:, None, None], reply, 0.0),
        jnp.where(used[:, None], moves, 0.0),
        jnp.sum(jnp.where(used, each, 0.0)),
        each_mean,
        freedom * n,
        jnp.sqrt(jnp.sum(jnp.where(used[:, None], squares, 0.0), axis=0) / freedom),
    )


def _path(
    network: jc.CSLC, theta: Array, state: Array, demands: Array, interval: Array
) -> Float[Array, "samples joints"]:
    """Positions at the samples of a window, from a state at the first; midpoint rule."""
    layout, n = network.layout, network.joint_count
    k, slopes = theta[: layout.size], jnp.exp(theta[layout.size :])
    rigid = network.without_friction(k)
    viscous, dry, static = (k[layout.of(kind)] for kind in ("viscous", "dry", "static"))
    h = interval / STEPS

    def mean_friction(before: Array, after: Array) -> Array:
        """Of dry and static friction, while the velocity goes from one to the other."""
        change = after - before
        still = jnp.abs(change) < 1e-9
        middle = 0.5 * (before + after)
        own = jnp.sign(middle) * (dry + static * jnp.exp(-slopes * jnp.abs(middle)))

        def work(v: Array) -> Array:  # friction's integral over the velocity
            speed = jnp.abs(v)
            return dry * speed - static * jnp.expm1(-slopes * speed) / slopes

        return jnp.where(still, own, (work(after) - work(before)) / jnp.where(still, 1.0, change))

    def stage(number: Array, own: tuple[Array, ...], demand: Array) -> tuple[Array, ...]:
        """The velocity that a step would end with, and the step with the mean of both."""
        q, qd, guess = own
        last = number % 2 == 1
        guess = jnp.where(last, guess, qd)
        middle = 0.5 * (qd + guess)
        held = viscous * middle + mean_friction(qd, guess)
        at = q + jnp.where(last, 0.5 * h, 0.0) * qd
        after = qd + h * network.forward_dynamics(rigid, at, middle, demand - held)
        return jnp.where(last, q + 0.5 * h * (qd + after), q), jnp.where(last, after, qd), after

    def sample(state: tuple[Array, ...], demand: Array) -> tuple[tuple[Array, ...], Array]:
        after = jax.lax.fori_loop(
            0, 2 * STEPS, lambda number, own: stage(number, own, demand), state
        )
        return after, state[0]

    _, path = jax.lax.scan(sample, (state[:n], state[n:], state[n:]), demands)
    return path
