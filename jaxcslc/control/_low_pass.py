from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float


Signal = Float[Array | np.ndarray, "*shape"]


class Smoothed(NamedTuple):
    """A filtered signal with its rate and its rate's rate, (*shape) each."""

    value: Float[Array, "*shape"]
    rate: Float[Array, "*shape"]
    second: Float[Array, "*shape"]


class LowPassChain(eqx.Module):
    """A causal differentiator: like first-order lags in a row, and what their differences say.

    With y_i the output of lag i of pole ω = 2π `corner`, the last one's rate is ω (y_{m−1} − y_m)
    and its second rate ω² (y_{m−2} − 2 y_{m−1} + y_m): exact derivatives of the filtered signal,
    no difference of samples among them. Quantisation reaches them through the filter alone.

    Between samples the signal is taken as `"linear"` (positions) or as `"constant"` at the value
    that the interval began with (demands that are held); either is integrated exactly, by the
    exponential of the chain, so samples may come at any interval. At low frequencies the chain
    delays by m / ω: two signals that went through alike chains stay aligned, which is what a
    regression over them needs, whatever the delay.

    **Attributes**

    - `corner`: of each lag [Hz], a leaf; or one for each last axis of the signal.
    - `lags`: m, two or more for a continuous rate, three for a continuous second rate.

    >>> import jax.numpy as jnp
    >>> from jaxcslc.control import LowPassChain
    >>> chain = LowPassChain(20.0, lags=3)
    >>> state = chain.begin(jnp.zeros(1))
    >>> for n in range(200):  # a ramp of slope 2
    ...     state = chain.step(state, jnp.array([0.004 * n]), jnp.array([0.004 * (n + 1)]), 0.002)
    >>> now = chain.read(state)
    >>> round(float(now.rate[0]), 6), round(abs(float(now.second[0])), 6)
    (2.0, 0.0)
    >>> bool(jnp.allclose(now.value, 0.8 - 2.0 * chain.delay))
    True
    """

    corner: float | Float[Array | np.ndarray, "..."]
    lags: int = eqx.field(static=True)

    def __init__(self, corner: float | Float[Array | np.ndarray, "..."], lags: int = 3) -> None:
        """**Raises** `ValueError` for a corner that is not above 0, or fewer than two lags."""
        if not isinstance(corner, Tracer) and not np.all(np.asarray(corner) > 0):
            raise ValueError(f"corner is {corner}; expected more than 0 Hz")
        if lags < 2:
            raise ValueError(f"lags is {lags}; expected 2 or more")
        self.corner = corner
        self.lags = lags

    @property
    def pole(self) -> Array:
        """ω [rad/s]."""
        return 2.0 * np.pi * jnp.asarray(self.corner, float)

    @property
    def delay(self) -> float | Array:
        """At low frequencies [s]."""
        return self.lags / self.pole

    def begin(self, value: Signal) -> Float[Array, "lags ..."]:
        """The state of a chain that has seen `value` for ever."""
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
        """The state an interval [s] later, in which the signal went from `before` to `now`.

        With `hold="constant"` it was `before` all along.
        """
        before, now = jnp.asarray(before), jnp.asarray(now)
        pole = jnp.broadcast_to(self.pole.astype(before.dtype), before.shape)
        turn = pole * interval
        # Along a ramp, lag i is i / ω late; what differs from that dies away by the chain's
        # exponential, whose entries are (ω h)^(i−j) / (i−j)! exp(−ω h).
        if hold == "linear":
            fall = jnp.where(turn > 0, (now - before) / jnp.where(turn > 0, turn, 1.0), 0.0)
        else:
            now, fall = before, jnp.zeros_like(before)
        off = [state[i] - (before - (i + 1) * fall) for i in range(self.lags)]
        powers = [jnp.exp(-turn)]
        for i in range(1, self.lags):
            powers.append(powers[-1] * turn / i)
        return jnp.stack(
            [
                now - (i + 1) * fall + sum(powers[i - j] * off[j] for j in range(i + 1))
                for i in range(self.lags)
            ]
        )

    def read(self, state: Float[Array, "lags ..."]) -> Smoothed:
        """The filtered signal and its derivatives."""
        last = state[-1]
        earlier = state[-3] if self.lags > 2 else None
        pole = jnp.broadcast_to(self.pole.astype(last.dtype), last.shape)
        rate = pole * (state[-2] - last)
        if earlier is None:
            # The lag before the first is the signal itself, which a state does not hold.
            second = jnp.full_like(last, jnp.nan)
        else:
            second = pole**2 * (earlier - 2.0 * state[-2] + last)
        return Smoothed(last, rate, second)
