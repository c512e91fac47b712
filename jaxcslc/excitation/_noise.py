import dataclasses
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Float

from ..identification.solver import Identification
from ..motion import Recording, Sampling


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
      None for white noise. Errors of the model can be stated so: measured residuals and the
      bandwidth in which they lie.
    - `estimator`: `"likelihood"`, which weights each frequency by its noise (`MaximumLikelihood`,
      whose bound the Cramér-Rao bound is); or `"regression"`, least squares of equations that are
      low-passed alike at `cutoff`.
    - `cutoff`: of `"regression"` [Hz].
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
    torque_bandwidth: float | None = None
    estimator: str = "likelihood"
    cutoff: float = 15.0
    slow: float | None = None

    def __post_init__(self) -> None:
        if self.estimator not in get_args(Estimator):
            raise ValueError(
                f"estimator: expected {' or '.join(get_args(Estimator))}, got {self.estimator!r}"
            )
        for name, least in (("torque", "above"), ("resolution", "from")):
            values = np.atleast_1d(getattr(self, name))
            usable = (values > 0.0) if least == "above" else (values >= 0.0)
            if not (usable & np.isfinite(values)).all():
                raise ValueError(f"{name} noise is {values.tolist()}; expected numbers {least} 0")
        for name in ("rate", "torque_bandwidth", "cutoff"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < np.inf:
                raise ValueError(f"{name} is {value}; expected more than 0 Hz")
        if self.slow is not None and not 0.0 <= self.slow < 1.0:
            raise ValueError(f"slow is {self.slow}; expected from 0 to below 1")

    @classmethod
    def of(
        cls,
        recording: Recording,
        torque: PerJoint,
        *,
        torque_bandwidth: float | None = None,
        estimator: str = "likelihood",
    ) -> "Noise":
        """With rate and resolution of a recording of the same robot.

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
    def of_fit(cls, fit: Identification, sampling: Sampling | None, **stated: Any) -> "Noise":
        """As an earlier identification met it: residuals, and how they were correlated.

        A joint's residuals that are worth m of n independent ones have a density n / m times that
        of white noise, as a first-order low pass of bandwidth rate m / (π n) makes it.

        **Arguments**

        - `fit`: the identification.
        - `sampling`: of its recording; None if unknown.
        - `stated`: attributes that are known better.
        """
        ratio = np.asarray(fit.effective_equations) / np.maximum(np.asarray(fit.equations), 1.0)
        ratio = float(np.clip(np.median(ratio), 1e-4, 1.0))
        error = np.asarray(fit.torque_error, float)
        fields: dict[str, Any] = {"torque": tuple(np.maximum(error, 1e-9 * error.max()).tolist())}
        if sampling is not None:
            fields |= {"resolution": sampling.resolution, "rate": 1.0 / sampling.interval}
        fields |= stated
        if ratio < 0.3 and "torque_bandwidth" not in stated:
            fields["torque_bandwidth"] = float(fields.get("rate", cls.rate)) * ratio / np.pi
        return cls(**fields)

    @property
    def slow_fraction(self) -> float:
        """`slow`, or its default."""
        return _SLOW[self.estimator] if self.slow is None else self.slow

    def torque_deviation(self, joints: int) -> Float[np.ndarray, " joints"]:
        """Of each joint's torque [N m or N]. **Raises** `ValueError` for another number."""
        return per_joint("torque noise", self.torque, joints)

    def position_deviation(self, joints: int) -> Float[np.ndarray, " joints"]:
        """Of each joint's readings [rad or m]. **Raises** `ValueError` for another number."""
        return per_joint("resolution", self.resolution, joints) / np.sqrt(12.0)

    def density(
        self,
        frequency: Float[np.ndarray, " frequencies"],
        mass_square: Float[np.ndarray, "joints joints"],
    ) -> Float[np.ndarray, "frequencies joints joints"]:
        """The spectral density of errors of torque equations, S of the class [(N m)²/Hz].

        **Arguments**

        - `frequency`: [Hz].
        - `mass_square`: M diag(σ²) Mᵀ of the positions' deviations, averaged over the motion.
        """
        joints = len(mass_square)
        variance = np.diag(self.torque_deviation(joints) ** 2) / self.rate
        shape = np.ones(len(frequency))
        if self.torque_bandwidth is not None:
            b = self.torque_bandwidth
            # Of a first-order low pass, its integral over both signs of the frequency the rate.
            shape = self.rate / (np.pi * b) / (1.0 + (frequency / b) ** 2)
        fourth = (2.0 * np.pi * frequency) ** 4
        return shape[:, None, None] * variance + fourth[:, None, None] * (mass_square / self.rate)

    def gain(self, frequency: Float[np.ndarray, " frequencies"]) -> Float[np.ndarray, " _"]:
        """Of the filter through which `"regression"` sees its equations."""
        return 1.0 / (1.0 + (frequency / self.cutoff) ** (2 * _FILTER_ORDER))


def per_joint(name: str, values: PerJoint, joints: int) -> Float[np.ndarray, " joints"]:
    """One number a joint, from one for all or from as many.

    **Raises** `ValueError` for another number of them.
    """
    numbers = np.atleast_1d(np.asarray(values, float))
    if numbers.shape not in ((1,), (joints,)):
        raise ValueError(f"{name}: expected one number or {joints}, got {numbers.size}")
    return np.broadcast_to(numbers, (joints,)).copy()
