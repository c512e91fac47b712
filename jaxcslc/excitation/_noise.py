"""Noise of the recording chain: torques, encoders, and the estimator that meets them."""

import dataclasses
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Float

from ..least_squares import Identification
from ..recordings import Recording, Sampling, decimation_for


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
      one for all joints or one each, infinite or None for white noise. Errors of the model can be
      stated so: measured residuals and the bandwidth in which they lie.
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
    torque_bandwidth: PerJoint | None = None
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
        if not np.all(np.atleast_1d(self._bandwidth) > 0.0):
            raise ValueError(
                f"torque_bandwidth is {self.torque_bandwidth}; expected more than 0 Hz"
            )
        if self.slow is not None and not 0.0 <= self.slow < 1.0:
            raise ValueError(f"slow is {self.slow}; expected from 0 to below 1")

    @classmethod
    def of(
        cls,
        recording: Recording,
        torque: PerJoint,
        *,
        torque_bandwidth: PerJoint | None = None,
        estimator: str = "likelihood",
    ) -> "Noise":
        """Make the noise with rate and resolution of a recording of the same robot.

        **Arguments**

        - `recording`: whose sampling the next recording will have.
        - the others: as of the class.

        >>> import numpy as np, jaxcslc as jc
        >>> from jaxcslc.excitation import Noise
        >>> time = np.arange(1000) * 0.002
        >>> position = 1e-4 * np.round(np.sin(time)[:, None] / 1e-4)
        >>> noise = Noise.of(jc.Recording(time, position, position), 0.1)
        >>> round(noise.rate), round(noise.resolution[0], 6)
        (500, 0.0001)
        """
        sampling = Sampling.of(recording)
        # Readings without steps are as good as a step of √12 times their scatter.
        steps = tuple(
            step or float(np.sqrt(12.0) * scatter)
            for step, scatter in zip(sampling.resolution, sampling.noise, strict=True)
        )
        return cls(torque, steps, 1.0 / sampling.interval, torque_bandwidth, estimator)

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

        >>> import jax.numpy as jnp, numpy as np, jaxcslc as jc
        >>> from jaxcslc.excitation import Noise
        >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
        >>> t = np.linspace(0, 5, 2500)[:, None]
        >>> q, qd, qdd = np.sin(3 * t), 3 * np.cos(3 * t), -9 * np.sin(3 * t)
        >>> torque = 0.5 * qdd + 0.1 * np.random.default_rng(0).normal(size=t.shape)
        >>> everything = np.ones(t.shape, bool)
        >>> patterns = jc.Patterns(t[:, 0], q, qd, qdd, torque, everything, everything)
        >>> fit = jc.LeastSquares().fit(jc.derive(arm, lengths="numeric"), patterns)
        >>> noise = Noise.of_fit(fit, None, rate=500.0)
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
    def _bandwidth(self) -> PerJoint:
        return np.inf if self.torque_bandwidth is None else self.torque_bandwidth

    @property
    def slow_fraction(self) -> float:
        """`slow`, or its default."""
        return _SLOW[self.estimator] if self.slow is None else self.slow

    def torque_deviation(self, joints: int) -> Float[np.ndarray, " joints"]:
        """Return the standard deviation of each joint's torque noise [N m or N].

        **Raises** `ValueError` for another number of values than joints.
        """
        return per_joint("torque noise", self.torque, joints)

    def position_deviation(self, joints: int) -> Float[np.ndarray, " joints"]:
        """Return the standard deviation of each joint's readings [rad or m].

        **Raises** `ValueError` for another number of values than joints.
        """
        return per_joint("resolution", self.resolution, joints) / np.sqrt(12.0)

    def offset_deviation(self, joints: int) -> Float[np.ndarray, " joints"]:
        """Return the standard deviation of each joint's offset [N m or N].

        **Raises** `ValueError` for another number of values than joints.
        """
        return per_joint("offset", self.offset, joints)

    @property
    def efficient(self) -> bool:
        """True if the estimator's weights are those of all errors."""
        return self.estimator == "likelihood" and not np.any(self.offset)

    def density(
        self,
        frequency: Float[np.ndarray, " frequencies"],
        mass_square: Float[np.ndarray, "joints joints"],
    ) -> Float[np.ndarray, "frequencies joints joints"]:
        """The spectral density of errors of torque equations, S of the class [(N m)²/Hz], without
        that of offsets, which is all at zero.

        **Arguments**

        - `frequency`: [Hz].
        - `mass_square`: M diag(σ²) Mᵀ of the positions' deviations, averaged over the motion.
        """
        joints = len(mass_square)
        variance = self.torque_deviation(joints) ** 2
        b = per_joint("torque_bandwidth", self._bandwidth, joints)
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
    """Bandwidths [Hz] of low passes whose samples at a rate are worth a part of their number,
    infinite for white noise; and which part of their variance lies in the samples' band."""
    angle = np.arctan(_RATIOS)
    of_ratios = 2.0 / _RATIOS * angle**2 / (angle + _RATIOS / (1.0 + _RATIOS**2))
    x = np.interp(-np.clip(worth, of_ratios[-1], 1.0), -of_ratios, _RATIOS)
    return np.where(worth > _WHITE, np.inf, rate / (2.0 * x)), 2.0 / np.pi * np.arctan(x)


def per_joint(name: str, values: PerJoint, joints: int) -> Float[np.ndarray, " joints"]:
    """Return one number per joint, from one for all or from as many.

    **Raises** `ValueError` for another number of them.
    """
    numbers = np.atleast_1d(np.asarray(values, float))
    if numbers.shape not in ((1,), (joints,)):
        raise ValueError(f"{name}: expected one number or {joints}, got {numbers.size}")
    return np.broadcast_to(numbers, (joints,)).copy()
