"""Velocities of arms without tachometers, from encoder readings.

`LowPassChain` is a causal differentiating low pass, exact between samples. `OutputFeedback` filters
the position error of a controller with it.
"""

from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ._controller import AbstractController, Joints, Reference


Signal = Float[Array | np.ndarray, "*shape"]


class FilteredSignal(NamedTuple):
    """A filtered signal and its first two derivatives, (*shape) each.

    **Attributes**

    - `value`, `rate`, `second`: the signal, its first and its second derivative in time.
    """

    value: Float[Array, "*shape"]
    rate: Float[Array, "*shape"]
    second: Float[Array, "*shape"]


class LowPassChain(eqx.Module):
    """A causal low-pass differentiator: a cascade of m equal first-order lags.

    With y_i the output of lag i with the pole ω = 2π `corner`, the first derivative of the last
    output is ω (y_{m−1} − y_m), and the second ω² (y_{m−2} − 2 y_{m−1} + y_m). Both are exact
    derivatives of the filtered signal; samples are never differenced, so that quantisation passes
    through the filter as well.

    Between samples the signal is `"linear"` (positions) or `"constant"` at the value with which
    the interval began (torque commands). Either is integrated exactly, by the matrix exponential of
    the cascade, at any sampling interval. At low frequencies the delay is m / ω. Two signals behind
    equal filters stay aligned, as regression requires.

    **Attributes**

    - `corner`: corner frequency of each lag [Hz]; one number, or one for each last axis of the
      signal.
    - `lags`: m; two or more for a continuous rate, three or more for a continuous second
      derivative.

    >>> import jax.numpy as jnp
    >>> from jaxcslc.control import LowPassChain
    >>> low_pass = LowPassChain(20.0, lags=3)
    >>> state = low_pass.begin(jnp.zeros(1))
    >>> for n in range(200):  # a ramp of slope 2
    ...     before, now = jnp.array([0.004 * n]), jnp.array([0.004 * (n + 1)])
    ...     state = low_pass.step(state, before, now, 0.002)
    >>> filtered = low_pass.read(state)
    >>> round(float(filtered.rate[0]), 6), round(abs(float(filtered.second[0])), 6)
    (2.0, 0.0)
    >>> bool(jnp.allclose(filtered.value, 0.8 - 2.0 * low_pass.delay))
    True
    """

    corner: float | Float[Array | np.ndarray, "..."]
    lags: int = eqx.field(static=True)

    def __init__(self, corner: float | Float[Array | np.ndarray, "..."], lags: int = 3) -> None:
        """Make a filter with its corner frequency [Hz] and number of lags.

        **Raises** `ValueError`: a corner frequency that is not above 0, or fewer than two lags.
        """
        if not isinstance(corner, Tracer) and not np.all(np.asarray(corner) > 0):
            raise ValueError(f"corner is {corner}; expected more than 0 Hz")
        if lags < 2:
            raise ValueError(f"lags is {lags}; expected 2 or more")
        self.corner = corner
        self.lags = lags

    @property
    def pole(self) -> Array:
        """The pole ω of each lag [rad/s]."""
        return 2.0 * np.pi * jnp.asarray(self.corner, float)

    @property
    def delay(self) -> float | Array:
        """The delay at low frequencies [s]."""
        return self.lags / self.pole

    def begin(self, value: Signal) -> Float[Array, "lags ..."]:
        """Return the state in equilibrium at the constant signal `value`, (lags, *shape)."""
        value = jnp.asarray(value)
        return jnp.broadcast_to(value, (self.lags, *value.shape))

    def step(
        self,
        state: Float[Array, "lags ..."],
        before: Signal,
        now: Signal,
        interval: float | Array,
        *,
        hold: Literal["linear", "constant"] = "linear",
    ) -> Float[Array, "lags ..."]:
        """Return the state one interval later.

        **Arguments**

        - `state`: (lags, *shape).
        - `before`, `now`: the signal at the beginning and at the end of the interval, (*shape).
        - `interval`: [s].
        - `hold`: `"linear"` between the two values, or `"constant"` at `before`.

        **Returns** (lags, *shape).
        """
        before, now = jnp.asarray(before), jnp.asarray(now)
        pole = jnp.broadcast_to(self.pole.astype(before.dtype), before.shape)
        phase = pole * interval
        # Along a ramp, lag i is i / ω late. The deviation from that decays with the exponential of
        # the cascade, whose entries are (ω h)^(i−j) / (i−j)! exp(−ω h).
        if hold == "linear":
            lag = jnp.where(phase > 0, (now - before) / jnp.where(phase > 0, phase, 1.0), 0.0)
        else:
            now, lag = before, jnp.zeros_like(before)
        deviation = [state[i] - (before - (i + 1) * lag) for i in range(self.lags)]
        powers = [jnp.exp(-phase)]
        for i in range(1, self.lags):
            powers.append(powers[-1] * phase / i)
        return jnp.stack(
            [
                now - (i + 1) * lag + sum(powers[i - j] * deviation[j] for j in range(i + 1))
                for i in range(self.lags)
            ]
        )

    def read(self, state: Float[Array, "lags ..."]) -> FilteredSignal:
        """Return the filtered signal and its derivatives."""
        last = state[-1]
        # The lag before the first of two is the signal itself, which a state does not hold.
        earlier = state[-3] if self.lags > 2 else jnp.full_like(last, jnp.nan)
        pole = jnp.broadcast_to(self.pole.astype(last.dtype), last.shape)
        second = pole**2 * (earlier - 2.0 * state[-2] + last)
        return FilteredSignal(last, pole * (state[-2] - last), second)


class OutputFeedbackState(NamedTuple):
    """The memory of an `OutputFeedback` controller.

    **Attributes**

    - `error`: position error at the previous sample, (*batch, n) [rad or m].
    - `filter`: state of the filter on the error, (lags, *batch, n).
    - `controller`: state of the wrapped controller.
    """

    error: Float[Array, "*batch joints"]
    filter: Float[Array, "lags *batch joints"]
    controller: Any


class OutputFeedback(AbstractController):
    """Velocity estimation for a controller of an arm that has encoders, but no tachometers.

    The rate of the *error* is filtered, not that of the position: while the arm follows its path
    the filter then causes no delay. The controller gets qd_d minus the filtered rate of e as its
    velocity, and the reading as its position. Where a reading is lost (NaN) the error is kept
    from the sample before; a `FaultMonitor` ends the motion if too many are lost in a row.

    **Attributes**

    - `controller`: the controller that needs positions and velocities.
    - `filter`: of the error.

    >>> import jax.numpy as jnp
    >>> from jaxcslc.control import PID, LowPassChain, OutputFeedback, Reference
    >>> pid = PID(1, position_gain=100.0, velocity_gain=10.0)
    >>> feedback = OutputFeedback(pid, LowPassChain(50.0, lags=2))
    >>> q, reference = jnp.zeros(1), Reference.at_rest(jnp.array([0.1]))
    >>> torque, state = feedback.step(feedback.begin(q), reference, q, 0.002)
    >>> bool(torque[0] > 10.0)
    True
    """

    controller: AbstractController
    filter: LowPassChain = LowPassChain(50.0, lags=2)

    def begin(self, q: Joints) -> OutputFeedbackState:
        """Return the state before the first sample, at rest where the path begins."""
        zero = jnp.zeros_like(jnp.asarray(q))
        return OutputFeedbackState(zero, self.filter.begin(zero), self.controller.begin(q))

    def step(
        self,
        state: OutputFeedbackState,
        reference: Reference,
        q: Joints,
        interval: float | Array,
        qd: Joints | None = None,
    ) -> tuple[Joints, OutputFeedbackState]:
        """Compute the torque command, as `AbstractController.step`, without measured velocities."""
        del qd
        error = jnp.asarray(reference.q - q)
        lost = jnp.isnan(error)
        error = jnp.where(lost, state.error, error)
        q = jnp.where(lost, reference.q - error, q)
        filtered = self.filter.step(state.filter, state.error, error, interval)
        estimate = reference.qd - self.filter.read(filtered).rate
        torque, inner = self.controller.step(state.controller, reference, q, interval, estimate)
        return torque, OutputFeedbackState(error, filtered, inner)
