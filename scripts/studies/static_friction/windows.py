"""Fits of simulated motion to recorded positions over windows: the output error method."""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxcslc import CSLC, Recording
from jaxcslc.likelihood import runs


_STEPS = 4  # of integration between two samples
_OUTLIER = 36.0  # times the median mean square of a window
_FIRST_DAMPING, _MOST_DAMPING = 0.01, 1e6
# How far the logarithm of a slope moves in a step: further off, its term may vanish for good.
_SLOPE_STEP = 0.7
_CONVERGED = 1e-5  # of the sum of squares
_UNDETERMINED = 1e-12  # smaller eigenvalues of the scaled normal equations are rounding
_RESTING = 10  # samples
_FEWEST = 8  # samples of a window: each joint has two unknowns in it
_KINDS = {"viscous", "dry", "static"}


class MotionWindows(NamedTuple):
    """Windows of consecutive samples in which no joint rests.

    **Attributes**

    - `rows`: (windows, samples) of the recording, the last repeated behind a window's end.
    - `within`: (windows, samples) False behind the end.
    """

    rows: Int[np.ndarray, "windows samples"]
    within: Bool[np.ndarray, "windows samples"]


def motion_windows(
    velocity: Float[np.ndarray, "samples joints"], *, length: int, slowest: float, trim: int
) -> MotionWindows:
    """Cuts a motion into windows in which no joint rests.

    A joint rests if it is slower than `slowest` for ten samples or more. A reversal is shorter.

    **Arguments**

    - `velocity`: (samples, n) [rad/s or m/s].
    - `length`: samples of a window, at most.
    - `slowest`: speed below which a joint may rest.
    - `trim`: samples to leave out at both ends, where velocities are poor.

    **Returns** the windows, shorter ones padded.
    """
    resting = np.zeros(len(velocity), dtype=bool)
    resting[:trim] = resting[len(velocity) - trim :] = True
    for slow in (np.abs(velocity) < slowest).T:
        for start, end in runs(slow):
            resting[start:end] |= end - start >= _RESTING
    parts = [
        part
        for start, end in runs(~resting)
        for part in np.array_split(np.arange(start, end), -(-(end - start) // length))
        if len(part) >= _FEWEST
    ]
    rows = [np.pad(part, (0, length - len(part)), mode="edge") for part in parts]
    within = [np.arange(length) < len(part) for part in parts]
    shape = (len(parts), length)
    return MotionWindows(
        np.reshape(rows, shape).astype(int), np.reshape(within, shape).astype(bool)
    )


@dataclasses.dataclass(frozen=True)
class WindowFit:
    """Coefficients and slopes of static friction from simulated motion.

    **Attributes**

    - `k`: (p,) coefficients; `error`: their standard errors for independent residuals.
    - `slopes`: (n,) of static friction [s/rad or s/m]; `slope_error`: their standard errors.
    - `residual`: (n,) root mean square of the positions' residuals.
    - `windows`: how many the fit uses.
    - `steps`: of Gauss and Newton's method.
    - `converged`: whether the sum of squares has stopped falling and the motion determines all
      unknowns. Where it does not determine one, its standard error is infinite.
    """

    k: Float[np.ndarray, " coefficients"]
    slopes: Float[np.ndarray, " joints"]
    error: Float[np.ndarray, " coefficients"]
    slope_error: Float[np.ndarray, " joints"]
    residual: Float[np.ndarray, " joints"]
    windows: int
    steps: int
    converged: bool


def fit_windows(
    network: CSLC,
    k: Float[np.ndarray, " coefficients"],
    recording: Recording,
    windows: MotionWindows,
    motion: tuple[Float[np.ndarray, "samples joints"], Float[np.ndarray, "samples joints"]],
    *,
    rounds: int = 40,
) -> WindowFit:
    """Fits simulated to recorded positions over windows: no derivative of a recording is taken.

    Between two samples the demanded torque is constant (thesis, Section 7.4), so that forward
    dynamics predict the following samples from a position, a velocity and the demands. The first
    position and velocity of a window are unknowns, eliminated from the coefficients' equations.

    Where a joint reverses within a step of integration, friction counts by its mean over the step,
    in which velocity is taken as linear. The equations thus contain the instant of the reversal and
    its dependence on every coefficient.

    **Arguments**

    - `network`: with viscous, dry and static friction; its slopes are where the fit starts.
    - `k`: (p,) coefficients to start from.
    - `windows`: see `motion_windows`.
    - `motion`: smoothed positions and velocities, (samples, n) each, to start each window from.
    - `rounds`: steps at most.

    **Returns** the fit. Joints are weighted by their residuals; windows with a residual of more
    than six times the median are left out.

    **Raises**

    - `ValueError`: a network with other kinds of friction.
    """
    kinds = set(network.layout.kinds) - {network.layout.kinds[0]}
    if kinds != _KINDS:
        raise ValueError(
            f"the network has the terms {', '.join(sorted(kinds)) or 'none'} beside the rigid body;"
            " expected viscous, dry and static friction"
        )
    n = network.joint_count
    theta = jnp.concatenate([jnp.asarray(k), jnp.log(jnp.asarray(network.static_slopes, float))])
    states = jnp.concatenate([jnp.asarray(x)[windows.rows[:, 0]] for x in motion], axis=1)
    measured = jnp.asarray(recording.position)[windows.rows]
    demands = jnp.asarray(recording.torque)[windows.rows]
    within = jnp.asarray(windows.within, float)
    interval = jnp.asarray(float(np.median(np.diff(recording.time))))

    def equations(theta: Array, states: Array) -> "_System":
        return _equations(network, theta, states, (measured, demands, within), interval, scale)

    # Weights of joints, and windows that something has disturbed: with the states fitted linearly,
    # residuals are near the noise from the first step on.
    scale = jnp.full(n, 1.0)
    scale = equations(theta, states).rms
    system = equations(theta, states)
    within = within * (system.mean_square < _OUTLIER * jnp.median(system.mean_square))[:, None]
    system = equations(theta, states)
    # Optimistix's loop, states eliminated in its descent: the same minimum to 1e-3 standard errors
    # (PUMA 560, encoders, 17 windows) in 24 steps and 24 s of processor time instead of 6 and 8.
    damping, converged, number = _FIRST_DAMPING, False, 0
    while number < rounds and not converged and damping <= _MOST_DAMPING:
        number += 1
        change, moves = _step(system, jnp.asarray(damping))
        trial = equations(theta + change, states + moves)
        if float(trial.cost) <= float(system.cost):  # and not NaN
            converged = float(system.cost) - float(trial.cost) < _CONVERGED * float(trial.cost)
            theta, states, system = theta + change, states + moves, trial
            damping /= 10.0
        else:
            damping *= 10.0
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
        converged and bool(np.all(np.isfinite(errors))),
    )


class _System(NamedTuple):
    """Linearised equations of coefficients and logarithms of slopes; states are eliminated."""

    normal: Float[Array, "windows unknowns unknowns"]
    right: Float[Array, "windows unknowns"]
    solve_states: Float[Array, "windows states _"]  # minus the states' reply to the unknowns
    states: Float[Array, "windows states"]
    cost: Float[Array, ""]
    mean_square: Float[Array, " windows"]
    degrees_of_freedom: Float[Array, ""]
    rms: Float[Array, " joints"]


@jax.jit
def _step(system: _System, damping: Float[Array, ""]) -> tuple[Array, Array]:
    """Levenberg and Marquardt's step of unknowns and states."""
    scaled, size = _scaled(system)
    right = jnp.sum(system.right, axis=0) / size
    step = jnp.linalg.solve(scaled + damping * jnp.eye(size.size), right) / size
    first = size.size - system.rms.size  # of the slopes
    step = step.at[first:].set(jnp.clip(step[first:], -_SLOPE_STEP, _SLOPE_STEP))
    return step, system.states - jnp.einsum("wsu,u->ws", system.solve_states, step)


@jax.jit
def _errors(system: _System) -> Array:
    """Standard errors for independent residuals, as those of encoders' steps are."""
    scaled, size = _scaled(system)
    eigenvalues, vectors = jnp.linalg.eigh(scaled)
    unclear = eigenvalues <= _UNDETERMINED * eigenvalues[-1]
    inverse = jnp.where(unclear, 0.0, 1.0 / jnp.where(unclear, 1.0, eigenvalues))
    determined = vectors**2 @ unclear.astype(float) <= _UNDETERMINED
    variance = system.cost / (system.degrees_of_freedom - size.size)
    error = jnp.sqrt(variance * (vectors**2 @ inverse)) / size
    return jnp.where(determined, error, jnp.inf)


def _scaled(system: _System) -> tuple[Array, Array]:
    """Normal equations of unknowns with ones on the diagonal, and by what these are divided."""
    normal = jnp.sum(system.normal, axis=0)
    size = jnp.sqrt(jnp.diag(normal))
    size = jnp.where(size > 0.0, size, 1.0)
    return normal / (size[:, None] * size[None, :]), size


def _window_equations(
    network: CSLC, theta: Array, state: Array, data: tuple[Array, ...], interval: Array,
    scale: Array,
) -> tuple[Array, ...]:  # fmt: skip
    measured, demands, within = data
    n = network.joint_count
    weights = within[:, None] / scale[None, :]

    def residual(unknowns: Array, state: Array) -> Array:
        path = _path(network, unknowns, state, demands, interval)
        return ((measured - path) * weights).reshape(-1)

    total = residual(theta, state)
    by_theta, by_state = jax.jacfwd(residual, argnums=(0, 1))(theta, state)
    q, r = jnp.linalg.qr(by_state)
    reply = jax.scipy.linalg.solve_triangular(r, q.T @ by_theta)
    moves = -jax.scipy.linalg.solve_triangular(r, q.T @ total)
    reduced = total - q @ (q.T @ total)
    columns = by_theta - q @ (q.T @ by_theta)
    squares = (reduced.reshape(-1, n) * scale[None, :]) ** 2
    return (
        columns.T @ columns,
        -(columns.T @ reduced),
        reply,
        moves,
        jnp.sum(reduced**2),
        jnp.sum(squares, axis=0),
    )


@jax.jit
def _equations(
    network: CSLC, theta: Array, states: Array, data: tuple[Array, ...], interval: Array,
    scale: Array,
) -> _System:  # fmt: skip
    normal, right, reply, moves, cost, squares = jax.vmap(
        lambda state, window: _window_equations(network, theta, state, window, interval, scale)
    )(states, data)
    n, within = network.joint_count, data[2]
    used = within[:, 0] > 0
    # Two unknowns of each joint are fitted in every window.
    degrees_of_freedom = jnp.sum(within) - 2 * jnp.sum(used)
    mean_square = jnp.where(used, cost / jnp.maximum(jnp.sum(within, axis=1), 1.0), 0.0)
    return _System(
        jnp.where(used[:, None, None], normal, 0.0),
        jnp.where(used[:, None], right, 0.0),
        jnp.where(used[:, None, None], reply, 0.0),
        jnp.where(used[:, None], moves, 0.0),
        jnp.sum(jnp.where(used, cost, 0.0)),
        mean_square,
        degrees_of_freedom * n,
        jnp.sqrt(jnp.sum(jnp.where(used[:, None], squares, 0.0), axis=0) / degrees_of_freedom),
    )


def _path(
    network: CSLC, theta: Array, state: Array, demands: Array, interval: Array
) -> Float[Array, "samples joints"]:
    """Positions at the samples of a window, from a state at the first; midpoint rule."""
    n, p, layout = network.joint_count, network.size, network.layout
    rigid = jnp.zeros(p).at[layout.inertial].set(theta[layout.inertial])
    viscous, dry, static = (theta[layout.term_slice(kind)] for kind in ("viscous", "dry", "static"))
    slopes = jnp.exp(theta[p:])
    h = interval / _STEPS

    def mean_friction(before: Array, after: Array) -> Array:
        """Return the mean of dry and static friction between two velocities."""
        change = after - before
        still = jnp.abs(change) < 1e-9
        middle = 0.5 * (before + after)
        at_middle = jnp.sign(middle) * (dry + static * jnp.exp(-slopes * jnp.abs(middle)))

        def work(v: Array) -> Array:  # friction's integral over the velocity
            speed = jnp.abs(v)
            return dry * speed - static * jnp.expm1(-slopes * speed) / slopes

        mean = (work(after) - work(before)) / jnp.where(still, 1.0, change)
        return jnp.where(still, at_middle, mean)

    def stage(number: Array, carry: tuple[Array, ...], demand: Array) -> tuple[Array, ...]:
        """The velocity that a step would end with, and the step with the mean of both."""
        q, qd, guess = carry
        last = number % 2 == 1
        guess = jnp.where(last, guess, qd)
        middle = 0.5 * (qd + guess)
        friction = viscous * middle + mean_friction(qd, guess)
        q_middle = q + jnp.where(last, 0.5 * h, 0.0) * qd
        after = qd + h * network.forward_dynamics(rigid, q_middle, middle, demand - friction)
        return jnp.where(last, q + 0.5 * h * (qd + after), q), jnp.where(last, after, qd), after

    def sample(state: tuple[Array, ...], demand: Array) -> tuple[tuple[Array, ...], Array]:
        after = jax.lax.fori_loop(
            0, 2 * _STEPS, lambda number, carry: stage(number, carry, demand), state
        )
        return after, state[0]

    _, path = jax.lax.scan(sample, (state[:n], state[n:], state[n:]), demands)
    return path
