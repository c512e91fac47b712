"""Information of a motion about coefficients under noise, and the standard errors it predicts.

`Noise` describes the recording chain and the estimator, `MotionInformation` weights the equations
of a motion by it, frequency by frequency. `_criteria` makes one number of the information.
"""

import dataclasses
from functools import cached_property
from typing import Any, Literal, NamedTuple, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..least_squares import Identification
from ..network import CSLC
from ..recordings import Sampling, decimation_for
from ..report import compared_with_value
from ._families import Times


Estimator = Literal["likelihood", "regression"]
PerJoint = float | tuple[float, ...]

# Of each joint's top speed: slower pairs of joint and sample count little, as masks or unknown
# moments of reversals leave them out.
_SLOW = {"likelihood": 0.005, "regression": 0.03}
_FILTER_ORDER = 4  # of `parallel_filter`, in each of two passes


@dataclasses.dataclass(frozen=True)
class Noise:
    """The noise of a recording chain, and the estimator that meets it.

    Torque equations err by the noise of torques, and by that of positions: a reading that is wrong
    by σ makes accelerations, from second differences, wrong by σ ω² at frequency ω, and torques by
    M(q) times that. So the spectral density of equations' errors is

        S(ω) = Sτ(ω) + ω⁴ M diag(σ²/rate) Mᵀ            [(N m)²/Hz], joints x joints

    **Attributes**

    - `torque`: standard deviation of each joint's torque [N m or N]; one number for all.
    - `resolution`: of encoders [rad or m], whose rounding has σ = resolution / √12.
    - `rate`: of the recording [Hz].
    - `torque_bandwidth`: of a torque noise that is correlated in time, a first-order low pass [Hz];
      one for all joints or one each, infinite for white noise. Errors of the model can be stated
      so: measured residuals and the bandwidth in which they lie.
    - `estimator`: `"likelihood"`, which weights each frequency by its noise (`MaximumLikelihood`,
      whose bound the Cramér-Rao bound is); or `"regression"`, least squares of equations that are
      low-passed alike at `cutoff`.
    - `cutoff`: of `"regression"` [Hz].
    - `offset`: standard deviation of a constant error of each joint's torque [N m or N]: friction
      that differs between directions, offsets of sensors; one number for all.
    - `slow`: speeds below this part of a joint's top speed count little; by default 0.005 and,
      for `"regression"`, 0.03, as its masks are.

    **Raises**

    - `ValueError`: numbers out of range, or another estimator.

    >>> from jaxcslc.excitation import Noise
    >>> noise = Noise(torque=0.1, resolution=1e-4)
    >>> noise.position_deviation(2).round(7).tolist(), noise.slow_fraction
    ([2.89e-05, 2.89e-05], 0.005)
    """

    torque: PerJoint
    resolution: PerJoint = 0.0
    rate: float = 500.0
    torque_bandwidth: PerJoint = np.inf
    estimator: str = "likelihood"
    cutoff: float = 15.0
    slow: float | None = None
    offset: PerJoint = 0.0

    def __post_init__(self) -> None:
        if self.estimator not in get_args(Estimator):
            raise ValueError(
                f"estimator: expected {' or '.join(get_args(Estimator))}, got {self.estimator!r}"
            )
        for name, least in (("torque", "above"), ("resolution", "from"), ("offset", "from")):
            values = np.atleast_1d(getattr(self, name))
            usable = (values > 0.0) if least == "above" else (values >= 0.0)
            if not (usable & np.isfinite(values)).all():
                raise ValueError(f"{name} noise is {values.tolist()}; expected numbers {least} 0")
        for name in ("rate", "cutoff"):
            value = getattr(self, name)
            if not 0.0 < value < np.inf:
                raise ValueError(f"{name} is {value}; expected more than 0 Hz")
        if not np.all(np.atleast_1d(self.torque_bandwidth) > 0.0):
            raise ValueError(
                f"torque_bandwidth is {self.torque_bandwidth}; expected more than 0 Hz"
            )
        if self.slow is not None and not 0.0 <= self.slow < 1.0:
            raise ValueError(f"slow is {self.slow}; expected from 0 to below 1")

    @classmethod
    def of_fit(
        cls,
        fit: Identification,
        sampling: Sampling | None,
        *,
        cutoff: float | None = None,
        **stated: Any,
    ) -> "Noise":
        """Estimate the noise from an earlier identification's residuals and their correlation.

        A joint's n residuals at a rate of r in a second, worth m independent ones, are those of a
        first-order low pass of the bandwidth b for which, with x = r / (2 b),

            m / n = (2 / x) atan²(x) / (atan x + x / (1 + x²)),

        which is (∫ S df)² / (r ∫ S² df) over the band of the equations, of S = 1 / (1 + (f/b)²)
        (Bartlett's count, as `Identification.effective_equations` has it): 1 of white noise,
        2 π b / r of slow noise.

        **Arguments**

        - `fit`: the identification.
        - `sampling`: of its recording; None if unknown.
        - `cutoff`: of the low pass of its equations [Hz]; None if they were not filtered.
        - `stated`: attributes that are known better.

        >>> import dataclasses, numpy as np, jaxcslc as jc
        >>> from jaxcslc.excitation import Noise
        >>> network = jc.derive(jc.examples.turntable(), lengths="numeric")
        >>> exact = jc.examples.swing(network, [0.5, 0.2, 0.1], samples=2500, time_step=0.002)
        >>> error = 0.1 * np.random.default_rng(0).normal(size=exact.torque.shape)
        >>> patterns = dataclasses.replace(exact, torque=exact.torque + error)
        >>> noise = Noise.of_fit(jc.LeastSquares().fit(network, patterns), None, rate=500.0)
        >>> noise.torque_bandwidth, round(noise.torque[0], 2)
        ((inf,), 0.1)
        """
        fields: dict[str, Any] = {}
        if sampling is not None:
            fields |= {"resolution": sampling.resolution, "rate": 1.0 / sampling.interval}
        if cutoff is not None:
            fields["cutoff"] = cutoff
        fields |= stated
        rate = float(fields.get("rate", cls.rate))
        of_equations = rate if cutoff is None else rate / decimation_for(cutoff, 1.0 / rate)
        count, error = np.asarray(fit.equations), np.asarray(fit.torque_error, float)
        worth = np.asarray(fit.effective_equations) / np.maximum(count, 1.0)
        bandwidth, seen = _low_pass(np.where(count > 0.0, worth, 1.0), of_equations)
        white = np.isinf(bandwidth)
        error = np.where(white, error * np.sqrt(rate / of_equations), error / np.sqrt(seen))
        error = np.maximum(error, 1e-9 * error.max())
        correlated: dict[str, Any] = {
            "torque": tuple(error.tolist()),
            "torque_bandwidth": tuple(bandwidth.tolist()),
        }
        return cls(**(correlated | fields))

    @property
    def slow_fraction(self) -> float:
        """`slow`, or its default."""
        return _SLOW[self.estimator] if self.slow is None else self.slow

    def torque_deviation(self, joints: int) -> Float[np.ndarray, " joints"]:
        """Return the standard deviation of each joint's torque noise [N m or N]."""
        return _per_joint("torque noise", self.torque, joints)

    def position_deviation(self, joints: int) -> Float[np.ndarray, " joints"]:
        """Return the standard deviation of each joint's readings [rad or m]."""
        return _per_joint("resolution", self.resolution, joints) / np.sqrt(12.0)

    def offset_deviation(self, joints: int) -> Float[np.ndarray, " joints"]:
        """Return the standard deviation of each joint's offset [N m or N]."""
        return _per_joint("offset", self.offset, joints)

    @property
    def efficient(self) -> bool:
        """True if the estimator's weights are those of all errors."""
        return self.estimator == "likelihood" and not np.any(self.offset)

    def density(
        self,
        frequency: Float[np.ndarray, " frequencies"],
        mass_square: Float[np.ndarray, "joints joints"],
    ) -> Float[np.ndarray, "frequencies joints joints"]:
        """Return the spectral density of errors of torque equations, S of the class [(N m)²/Hz].

        Offsets, whose density is all at zero, are left out.

        **Arguments**

        - `frequency`: [Hz].
        - `mass_square`: M diag(σ²) Mᵀ of the positions' deviations, averaged over the motion.
        """
        joints = len(mass_square)
        variance = self.torque_deviation(joints) ** 2
        b = _per_joint("torque_bandwidth", self.torque_bandwidth, joints)
        slow = np.isfinite(b)
        low = np.where(slow, b, 1.0)
        # Of a first-order low pass, its integral over both signs of the frequency the variance.
        low_passed = 1.0 / (np.pi * low) / (1.0 + (frequency[:, None] / low) ** 2)
        of_torque = variance * np.where(slow, low_passed, 1.0 / self.rate)
        fourth = (2.0 * np.pi * frequency) ** 4
        return (
            of_torque[:, :, None] * np.eye(joints) + fourth[:, None, None] * mass_square / self.rate
        )

    def gain(self, frequency: Float[np.ndarray, " frequencies"]) -> Float[np.ndarray, " _"]:
        """Return the gain of the filter through which `"regression"` sees its equations."""
        return 1.0 / (1.0 + (frequency / self.cutoff) ** (2 * _FILTER_ORDER))


_WHITE = 0.9  # residuals worth more than this part of their number are white
_RATIOS = np.geomspace(0.01, 1e6, 2000)  # x, of half a rate to a bandwidth, that are looked up


def _low_pass(
    worth: Float[np.ndarray, " joints"], rate: float
) -> tuple[Float[np.ndarray, " joints"], Float[np.ndarray, " joints"]]:
    """Return the bandwidths [Hz] of low passes whose samples are worth a part of their number.

    They are infinite for white noise. The part of their variance in the samples' band comes second.
    """
    angle = np.arctan(_RATIOS)
    of_ratios = 2.0 / _RATIOS * angle**2 / (angle + _RATIOS / (1.0 + _RATIOS**2))
    x = np.interp(-np.clip(worth, of_ratios[-1], 1.0), -of_ratios, _RATIOS)
    return np.where(worth > _WHITE, np.inf, rate / (2.0 * x)), 2.0 / np.pi * np.arctan(x)


def _per_joint(name: str, values: PerJoint, joints: int) -> Float[np.ndarray, " joints"]:
    """Return one number per joint. **Raises** `ValueError` for neither one nor as many."""
    numbers = np.atleast_1d(np.asarray(values, float))
    if numbers.shape not in ((1,), (joints,)):
        raise ValueError(f"{name}: expected one number or {joints}, got {numbers.size}")
    return np.broadcast_to(numbers, (joints,)).copy()


Motion = tuple[Any, Any, Any]
Square = Float[np.ndarray, "coefficients coefficients"]


# Sizes of coefficients: standard errors near that are of those that nothing determines.
UNDETERMINED = 1e3
SMALLEST_SHARE = 0.01  # of a joint's torque limit, by definition of size (docs/excitation.md)


States = Float[Array | np.ndarray, "samples joints"]


def motion_regressor(
    network: CSLC, q: States, qd: States, qdd: States
) -> Float[np.ndarray, "samples joints coefficients"]:
    """Return the regressor of a whole motion.

    NumPy computes it, from the network's expressions. XLA compiles for some seconds for each number
    of samples, which is longer than all calls of a design take. It serves terms of which NumPy
    cannot compute columns.
    """
    if not network.has_host_columns:
        return np.asarray(_regressor(network, *(jnp.asarray(x) for x in (q, qd, qdd))))
    columns = _columns(network, q, qd, qdd)
    regressor = np.zeros((len(q), len(columns), network.size))
    for joint, (rows, support) in enumerate(zip(columns, network.support, strict=True)):
        regressor[:, joint, list(support)] = rows.T
    return regressor


def motion_torques(
    network: CSLC, k: Float[np.ndarray, "models coefficients"], q: States, qd: States, qdd: States
) -> Float[np.ndarray, "models samples joints"]:
    """Return the torques of a motion by several models, a row of `k` each."""
    if not network.has_host_columns:
        return np.einsum("sjp,mp->msj", motion_regressor(network, q, qd, qdd), k)
    columns = _columns(network, q, qd, qdd)
    torques = [
        k[:, list(support)] @ rows for rows, support in zip(columns, network.support, strict=True)
    ]
    return np.stack(torques, axis=-1)


def motion_mass_matrices(
    network: CSLC, k: Float[np.ndarray, " coefficients"], q: States
) -> Float[np.ndarray, "samples joints joints"]:
    """Return M(q), by which torques at rest change with unit accelerations, joint by joint."""
    zero = np.zeros_like(q)
    gravity, *columns = (
        motion_torques(network, k[None], q, zero, zero + acceleration)[0]
        for acceleration in (0.0, *np.eye(q.shape[1]))
    )
    return np.stack(columns, axis=-1) - gravity[..., None]


def _columns(
    network: CSLC, q: States, qd: States, qdd: States
) -> tuple[Float[np.ndarray, "_ samples"], ...]:
    rows: Any = (np.ascontiguousarray(np.asarray(x, float).T) for x in (q, qd, qdd))
    return tuple(np.asarray(x) for x in network.columns(*rows))


@eqx.filter_jit
def _regressor(network: CSLC, q: Any, qd: Any, qdd: Any) -> Any:
    return network.regressor(q, qd, qdd)


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
    """Information that a motion will have about the coefficients of a network.

    Equations over time are taken to frequencies (a cosine transform, as the motion does not close),
    where stationary noise is independent. At each frequency they are weighted by the
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
    >>> network = jc.derive(jc.examples.turntable(), lengths="numeric")
    >>> k = np.array([0.5, 0.2, 0.1])
    >>> information = MotionInformation(network, k, k, Noise(0.1, 1e-4), 0.01)
    >>> motion = jc.examples.swing(network, k)
    >>> q, qd, qdd = motion.q, motion.qd, motion.qdd
    >>> moments = information.moments((q, qd, qdd), information.spectra(q))
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
        part = motion_mass_matrices(self.network, np.asarray(self.k), np.asarray(q)) * deviation
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
        """Return weights of pairs: near 0 where a joint nearly rests, near 1 where it moves."""
        fraction = self.noise.slow_fraction
        if fraction == 0.0:
            return jnp.ones_like(qd)
        threshold = fraction * jax.lax.stop_gradient(jnp.max(jnp.abs(qd), axis=0))
        return qd**2 / (qd**2 + threshold[None] ** 2 + 1e-12)


def error_covariance(moments: Moments, prior: Any) -> Any:
    """Return the covariance of coefficients in units of their sizes, (p, p).

    With prior information Λ (p, p) it is (H + Λ)⁻¹ (G + Λ) (H + Λ)⁻¹. Of an efficient estimator,
    that is (H + Λ)⁻¹.
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
    - `k`: (p,) prior coefficients; 0 where no value is known.
    - `size`: (p,) that errors are compared with in criteria and targets: the absolute value, or
      what makes 1 % of a joint's torque if that is larger (`coefficient_sizes`).
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
    ([0.05], 'kd1: standard error 20 % of the value, then 5 % of the value')
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
    def sized_error(self) -> Float[np.ndarray, " coefficients"]:
        """(p,) standard errors over sizes."""
        return self.standard_error / self.size

    @property
    def relative_error(self) -> Float[np.ndarray, " coefficients"]:
        """(p,) standard errors over values, as `identify` has them; over sizes without a value."""
        return self.standard_error / self._value

    @property
    def _value(self) -> Float[np.ndarray, " coefficients"]:
        return np.where(self.k == 0.0, self.size, np.abs(self.k))

    @property
    def determined(self) -> Bool[np.ndarray, " coefficients"]:
        """True for each coefficient that the motion and the prior knowledge determine."""
        return self.sized_error <= 0.1 * UNDETERMINED

    def gains(self, most: int = 8) -> list[str]:
        """Return one line per coefficient, largest gain first: standard errors before and after."""
        ratio = np.where(self.determined, self.standard_error / self.before, np.inf)
        order = np.argsort(ratio)[: min(most, int(self.determined.sum()))].tolist()
        names = (self.names[i] for i in order)
        return [
            f"{name}: {self._text_before(name)}, then {self.error_text(name)}" for name in names
        ]

    def error_text(self, name: str) -> str:
        """Return the standard error of a coefficient next to its value, as `identify` has it."""
        i = self.names.index(name)
        return compared_with_value(float(self.standard_error[i]), float(self._value[i]))

    def _text_before(self, name: str) -> str:
        i = self.names.index(name)
        if not np.isfinite(before := float(self.before[i])):
            return "not determined"
        return f"standard error {compared_with_value(before, float(self._value[i]))}"


def condition_number(products: Square) -> float:
    """Return the condition number of a matrix from the products of its columns."""
    values = np.linalg.eigvalsh(products)
    return float(np.sqrt(values[-1] / values[0])) if values[0] > 0.0 else np.inf


def coefficient_sizes(
    network: CSLC,
    k: Float[np.ndarray, " coefficients"],
    motion: Motion,
    torque: Float[np.ndarray, " joints"],
) -> Float[np.ndarray, " coefficients"]:
    """Return the size of each coefficient: its absolute value, or what makes 1 % of a torque.

    A coefficient that is zero by chance, or not known yet, has the size that would make
    `SMALLEST_SHARE` of some joint's torque over a motion.

    **Arguments**

    - `k`: (p,), zeros where unknown.
    - `motion`: `q`, `qd`, `qdd`, typical of the robot.
    - `torque`: (n,) of each joint [N m or N].
    """
    regressor = motion_regressor(network, *motion)
    column = np.sqrt(np.mean(regressor**2, axis=0)) / torque[:, None]
    largest = column.max(axis=0)
    least = SMALLEST_SHARE / np.where(largest > 0.0, largest, np.inf)
    return np.maximum(np.abs(k), np.where(least > 0.0, least, 1.0))


def time_grid(duration: float, interval: float) -> tuple[Times, float]:
    """Return times of about that interval over the whole duration, and their interval."""
    count = max(round(duration / interval), 2)
    return np.linspace(0.0, duration, count + 1), duration / count
