"""How accurately a motion determines a payload: the Cramér-Rao bound under model errors."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

import jaxcslc as jc
from jaxcslc.payload import PayloadEstimator
from scripts.studies.payload.task import INTERVAL


_REACH = 0.5  # of the errors' autocovariance [s]
# The errors' spectrum is no less than this part of its maximum, for what is left of it at higher
# frequencies is rounding and the filter's.
_FLOOR = 1e-2
_PRIOR = np.array([0.2] * 6 + [1.0] * 3 + [5.0])  # the estimator's


class Equations(NamedTuple):
    """What an estimator sees of a recording, at the samples of its updates."""

    rows: Float[np.ndarray, "updates joints 10"]
    """The regressor's columns of the payload."""

    residual: Float[np.ndarray, "updates joints"]
    """Torque that the unloaded arm's coefficients do not explain [N m]."""

    moving: Bool[np.ndarray, "updates joints"]
    """Which joints are faster than their thresholds."""


def equations(estimator: PayloadEstimator, *recordings: jc.Recording) -> list[Equations]:
    """The equations that an estimator makes of each recording."""
    longest = max(len(recording.time) for recording in recordings)
    made: list[Equations] = []
    for recording in recordings:
        # At one length one compiled program serves all of them.
        missing = ((0, longest - len(recording.time)), (0, 0))
        signals = (recording.position, recording.torque)
        padded = (jnp.asarray(np.pad(signal, missing, mode="edge")) for signal in signals)
        updates = len(recording.time) // estimator.update_every
        made.append(Equations(*(np.asarray(x)[:updates] for x in _equations(estimator, *padded))))
    return made


@eqx.filter_jit
def _equations(
    estimator: PayloadEstimator, q: Float[Array, "samples n"], torque: Float[Array, "samples n"]
) -> tuple[Array, Array, Array]:
    chain = estimator.filter

    def filtered(state: tuple[Array, Array], sample: tuple[Array, ...]) -> tuple[Any, Any]:
        before, now, demand_before, demand = sample
        motion = chain.step(state[0], before, now, INTERVAL)
        effort = chain.step(state[1], demand_before, demand, INTERVAL, hold="constant")
        return (motion, effort), (chain.read(motion), chain.read(effort).value)

    begin = chain.begin(q[0]), chain.begin(torque[0])
    pairs = (q[:-1], q[1:], torque[:-1], torque[1:])
    (position, rate, second), effort = jax.lax.scan(filtered, begin, pairs)[1]
    every = slice(estimator.update_every - 2, None, estimator.update_every)
    rows = jax.vmap(estimator.network.regressor)(position[every], rate[every], second[every])
    layout = estimator.network.layout
    residual = effort[every] - rows[..., layout.unloaded] @ estimator.k
    return rows[..., layout.payload], residual, jnp.abs(rate[every]) > estimator.velocity_threshold


def autocovariance(
    residual: Float[np.ndarray, " updates"], moving: Bool[np.ndarray, " updates"], lags: int
) -> Float[np.ndarray, " lags"]:
    """Return the autocovariance of a joint's errors in motion, weighted by a triangle that ends at
    `lags`.
    """
    error = np.where(moving, residual, 0.0)
    pairs = [np.sum(moving[lag:] & moving[: len(moving) - lag]) for lag in range(lags)]
    sums = [np.sum(error[lag:] * error[: len(error) - lag]) for lag in range(lags)]
    return np.array(sums) / np.maximum(pairs, 1) * (1.0 - np.arange(lags) / lags)


def mass_bound(unloaded: Equations, carrying: Equations, interval: float) -> float:
    """The least standard error of an unbiased estimate of the mass [kg].

    For errors of each joint that are Gaussian and stationary, with the autocovariance of those of
    `unloaded`, another motion.

    **Arguments**

    - `unloaded`: without payload; their residual is the model's error.
    - `carrying`: while the payload is carried.
    - `interval`: from update to update [s].
    """
    count, lags = len(carrying.residual), round(_REACH / interval)
    information = np.diag(1.0 / _PRIOR**2)
    for joint in range(carrying.residual.shape[1]):
        covariance = autocovariance(unloaded.residual[:, joint], unloaded.moving[:, joint], lags)
        circle = np.zeros(4 * count)
        circle[:lags], circle[-lags + 1 :] = covariance, covariance[:0:-1]
        spectrum = np.fft.rfft(circle).real
        covariance = np.fft.irfft(np.maximum(spectrum, _FLOOR * spectrum.max()))
        at = np.flatnonzero(carrying.moving[:, joint])
        rows = carrying.rows[at, joint]
        matrix = covariance[np.abs(at[:, None] - at[None, :])]
        information += rows.T @ np.linalg.solve(matrix, rows)
    return float(np.sqrt(np.linalg.inv(information)[9, 9]))
