"""Information of a motion about coefficients, by frequency, and predicted standard errors.

`Noise` gives the errors of the equations; `_criteria` makes one number of the information.
"""

import dataclasses
from functools import cached_property
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..network import CSLC
from ._families import Times
from ._noise import Noise


# Of whole motions, where nothing is differentiated. NumPy computes them, from the network's
# expressions: for each of them, and each number of samples, XLA compiles for some seconds, which
# is longer than all calls of a design take.
States = Float[Array | np.ndarray, "samples joints"]


def regressor_of(
    network: CSLC, q: States, qd: States, qdd: States
) -> Float[np.ndarray, "samples joints coefficients"]:
    """The regressor of a motion; compiled for terms of which NumPy cannot compute columns."""
    if not network.has_host_columns:
        return np.asarray(_regressor(network, *(jnp.asarray(x) for x in (q, qd, qdd))))
    columns = _columns(network, q, qd, qdd)
    regressor = np.zeros((len(q), len(columns), network.size))
    for joint, (rows, support) in enumerate(zip(columns, network.support, strict=True)):
        regressor[:, joint, list(support)] = rows.T
    return regressor


def torques_of(
    network: CSLC, k: Float[np.ndarray, "models coefficients"], q: States, qd: States, qdd: States
) -> Float[np.ndarray, "models samples joints"]:
    """Torques of a motion by several models, a row of `k` each."""
    if not network.has_host_columns:
        return np.einsum("sjp,mp->msj", regressor_of(network, q, qd, qdd), k)
    columns = _columns(network, q, qd, qdd)
    torques = [
        k[:, list(support)] @ rows for rows, support in zip(columns, network.support, strict=True)
    ]
    return np.stack(torques, axis=-1)


def mass_matrices_of(
    network: CSLC, k: Float[np.ndarray, " coefficients"], q: States
) -> Float[np.ndarray, "samples joints joints"]:
    """M(q): what torques at rest change by with unit accelerations, joint by joint."""
    zero, joints = np.zeros_like(q), np.eye(q.shape[1])
    of_gravity = torques_of(network, k[None], q, zero, zero)[0]
    columns = [torques_of(network, k[None], q, zero, zero + unit)[0] for unit in joints]
    return np.stack(columns, axis=-1) - of_gravity[..., None]


def _columns(
    network: CSLC, q: States, qd: States, qdd: States
) -> tuple[Float[np.ndarray, "_ samples"], ...]:
    rows: Any = (np.ascontiguousarray(np.asarray(x, float).T) for x in (q, qd, qdd))
    return tuple(np.asarray(x) for x in network.columns(*rows))


@eqx.filter_jit
def _regressor(network: CSLC, q: Any, qd: Any, qdd: Any) -> Any:
    return network.regressor(q, qd, qdd)


Motion = tuple[Any, Any, Any]
Square = Float[np.ndarray, "coefficients coefficients"]


# Sizes of coefficients: standard errors near that are of those that nothing determines.
UNDETERMINED = 1e3


class Spectra(NamedTuple):
    """Factors of the weights of equations, frequency by frequency, fixed while a step is judged.

    **Attributes**

    - `white`: (f, n, n) whose product with a spectrum of equations makes the weighted equations.
    - `error`: (f, n, n) the covariance of weighted equations' errors.
    """

    white: Float[Any, "frequencies joints joints"]
    error: Float[Any, "frequencies joints joints"]


class Moments(NamedTuple):
    """Information of a motion about coefficients, in units of their sizes.

    **Attributes**

    - `normal`: (p, p) H, of the normal equations of the estimator.
    - `spread`: (p, p) G, covariance of their right-hand sides: H of an efficient estimator.
    - `plain`: (p, p) products of the regressor's columns in SI units, for condition numbers.
    """

    normal: Any
    spread: Any
    plain: Any


class MotionInformation(eqx.Module):
    """The information that a motion will have about the coefficients of a network.

    Equations over time are taken to frequencies (a cosine transform, as the motion does not close),
    where noise that is stationary is independent. At each frequency they are weighted by the
    estimator: by the inverse density of their errors, or by the low pass of a regression. Errors of
    positions reach torques by the mass matrix, averaged over the motion.

    **Attributes**

    - `network`: n joints, p coefficients.
    - `k`: (p,) prior coefficients, for the mass matrix.
    - `size`: (p,) of coefficients: the units in which moments count.
    - `noise`: of the recording chain.
    - `interval`: between the samples of the motion that is judged [s]; the longer, the quicker.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.excitation import MotionInformation, Noise
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(arm, lengths="numeric")
    >>> k = np.array([0.5, 0.2, 0.1])
    >>> information = MotionInformation(network, k, k, Noise(0.1, 1e-4), 0.01)
    >>> t = np.arange(500)[:, None] * 0.01
    >>> motion = np.sin(3 * t), 3 * np.cos(3 * t), -9 * np.sin(3 * t)
    >>> moments = information.moments(motion, information.spectra(motion[0]))
    >>> bool(np.all(np.linalg.eigvalsh(moments.normal) > 0.0))  # determines all coefficients
    True
    """

    network: CSLC
    k: Float[np.ndarray, " coefficients"]
    size: Float[np.ndarray, " coefficients"]
    noise: Noise = eqx.field(static=True)
    interval: float = eqx.field(static=True)

    def spectra(self, q: Float[Any, "samples joints"]) -> Spectra:
        """Weights of equations of a motion, on the host."""
        n = self.network.joint_count
        deviation = self.noise.position_deviation(n)
        part = mass_matrices_of(self.network, np.asarray(self.k), np.asarray(q)) * deviation
        mass_square = np.mean(part @ part.swapaxes(-1, -2), axis=0)
        samples = len(q)
        frequency = np.arange(samples) / (2.0 * samples * self.interval)
        # The density of a sampled motion's coefficients of the orthonormal transform.
        density = self.noise.density(frequency, mass_square) / self.interval
        if self.noise.estimator == "likelihood":
            white = np.linalg.inv(np.linalg.cholesky(density))
        else:
            gain = self.noise.gain(frequency)
            filtered = gain[:, None] ** 2 * np.diagonal(density, axis1=1, axis2=2)
            weight = 1.0 / np.sqrt(np.mean(filtered, axis=0))  # joints weighted by their residuals
            white = gain[:, None, None] * np.diag(weight)
        # Estimators know nothing of offsets: their weights are those without.
        density[0] += samples * np.diag(self.noise.offset_deviation(n) ** 2)
        return Spectra(white, white @ density @ white.swapaxes(-1, -2))

    def moments(self, motion: Motion, spectra: Spectra, regressor: Any = None) -> Moments:
        """Compute the moments of a motion (`q`, `qd`, `qdd`), differentiably.

        - `regressor`: if it is known already.
        """
        q, qd, qdd = motion
        if regressor is None:
            regressor = self.network.regressor(q, qd, qdd)
        weighted = regressor * self._weights(qd)[..., None]
        scaled = weighted * jnp.asarray(self.size)[None, None]
        spectrum = jax.scipy.fft.dct(scaled, axis=0, norm="ortho")
        equations = jnp.einsum("fij,fjp->fip", jnp.asarray(spectra.white), spectrum)
        rows = equations.reshape(-1, self.network.size)
        normal = rows.T @ rows
        if self.noise.efficient:
            spread = normal
        else:
            errors = jnp.einsum("fij,fjp->fip", jnp.asarray(spectra.error), equations)
            spread = rows.T @ errors.reshape(-1, self.network.size)
        flat = weighted.reshape(-1, self.network.size)
        return Moments(normal, spread, flat.T @ flat)

    def _weights(self, qd: Float[Any, "samples joints"]) -> Any:
        """Return weights of pairs: near 0 where a joint hardly moves, near 1 where it moves."""
        fraction = self.noise.slow_fraction
        if fraction == 0.0:
            return jnp.ones_like(qd)
        threshold = fraction * jax.lax.stop_gradient(jnp.max(jnp.abs(qd), axis=0))
        return qd**2 / (qd**2 + threshold[None] ** 2 + 1e-12)


def error_covariance(moments: Moments, prior: Any) -> Any:
    """(p, p) covariance of coefficients in units of their sizes, with prior information (p, p).

    (H + Λ)⁻¹ (G + Λ) (H + Λ)⁻¹; for an efficient estimator (H + Λ)⁻¹.
    """
    total = moments.normal + prior
    # Units in which the matrix has a unit diagonal: inverses then lose the fewest digits.
    unit = 1.0 / jnp.sqrt(jnp.diagonal(total))
    units = unit[:, None] * unit[None]
    inverse = jnp.linalg.inv(total * units) * units
    return inverse @ (moments.spread + prior) @ inverse.T


@dataclasses.dataclass(frozen=True, eq=False)
class Prediction:
    """Standard errors that a motion is predicted to bring.

    **Attributes**

    - `names`, `units`: of the coefficients.
    - `k`: (p,) prior coefficients; `size`: (p,) the sizes that errors are compared with.
    - `covariance`: (p, p) predicted, in the coefficients' units.
    - `before`: (p,) standard errors without the motion: of earlier recordings; infinite without.
    - `condition`, `scaled_condition`: of the stacked regressor, in SI units and with columns of
      unit length.

    >>> import numpy as np
    >>> from jaxcslc.excitation import Prediction
    >>> prediction = Prediction(
    ...     ("kd1",), ("N m",), np.array([2.0]), np.array([2.0]), np.array([[0.01]]),
    ...     np.array([0.4]), 10.0, 3.0,
    ... )
    >>> prediction.relative_error.tolist(), prediction.gains()[0]
    ([0.05], 'kd1: interval ±39 % to ±9.8 %')
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    k: Float[np.ndarray, " coefficients"]
    size: Float[np.ndarray, " coefficients"]
    covariance: Square
    before: Float[np.ndarray, " coefficients"]
    condition: float
    scaled_condition: float

    @cached_property
    def standard_error(self) -> Float[np.ndarray, " coefficients"]:
        """(p,) in the coefficients' units."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def relative_error(self) -> Float[np.ndarray, " coefficients"]:
        """(p,) standard errors over sizes."""
        return self.standard_error / self.size

    @property
    def determined(self) -> Bool[np.ndarray, " coefficients"]:
        """True for each coefficient that the motion and the prior knowledge determine."""
        return self.relative_error <= 0.1 * UNDETERMINED

    def gains(self, most: int = 8) -> list[str]:
        """Return one line per coefficient, largest gain first: 95 % intervals before and after."""
        ratio = np.where(self.determined, self.standard_error / self.before, np.inf)
        order = np.argsort(ratio)[: min(most, int(self.determined.sum()))]
        return [
            f"{self.names[i]}: interval {_interval(float(self.before[i] / self.size[i]))} to"
            f" {_interval(float(self.relative_error[i]))}"
            for i in order
        ]

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per coefficient."""
        return [
            {
                "name": name,
                "unit": unit,
                "prior": float(self.k[i]),
                "error_before": float(self.before[i]),
                "predicted_error": float(self.standard_error[i]),
                "relative": float(self.relative_error[i]),
            }
            for i, (name, unit) in enumerate(zip(self.names, self.units, strict=True))
        ]


def _interval(relative: float) -> str:
    """Half of a 95 % interval."""
    return f"±{196 * relative:.2g} %" if np.isfinite(relative) else "not determined"


def condition_of(products: Square) -> float:
    """The condition number of a matrix from the products of its columns."""
    values = np.linalg.eigvalsh(np.asarray(products))
    return float(np.sqrt(values[-1] / values[0])) if values[0] > 0.0 else np.inf


def column_scaled(products: Square) -> Square:
    """The products of the columns at unit length."""
    length = np.sqrt(np.maximum(np.diag(products), 0.0))
    length = np.where(length > 0.0, length, 1.0)
    return products / np.outer(length, length)


def coefficient_sizes(
    network: CSLC,
    k: Float[np.ndarray, " coefficients"],
    motion: Motion,
    torque: Float[np.ndarray, " joints"],
    share: float = 0.01,
) -> Float[np.ndarray, " coefficients"]:
    """The size of each coefficient: its absolute value, or what makes a part of a joint's torque.

    A coefficient that is zero by chance, or not known yet, has the size that would make `share` of
    some joint's torque over a motion.

    **Arguments**

    - `k`: (p,), zeros where unknown.
    - `motion`: `q`, `qd`, `qdd`, typical of the robot.
    - `torque`: (n,) of each joint [N m or N].
    """
    regressor = regressor_of(network, *motion)
    column = np.sqrt(np.mean(regressor**2, axis=0)) / torque[:, None]
    largest = column.max(axis=0)
    least = share / np.where(largest > 0.0, largest, np.inf)
    return np.maximum(np.abs(k), np.where(least > 0.0, least, 1.0))


def time_grid(duration: float, interval: float) -> tuple[Times, float]:
    """Times of about that interval over the whole duration, and their interval."""
    count = max(round(duration / interval), 2)
    return np.linspace(0.0, duration, count + 1), duration / count
