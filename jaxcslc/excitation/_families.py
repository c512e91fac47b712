"""Families of joint motions from rest to rest: B-splines, Fourier series, minimum-jerk moves.

All are linear in their parameters, so that kinematic limits are linear too.
"""

import abc
import dataclasses
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import scipy
from jaxtyping import Array, Float


Parameters = Float[Array | np.ndarray, "parameters joints"]
Times = Float[np.ndarray, " samples"]

_DEGREE = 5  # of splines and of minimum-jerk moves


class AbstractFamily(abc.ABC):
    """A family of joint motions from rest to rest, linear in its parameters.

        q(t) = basis(t) @ parameters,      basis (samples, m), parameters (m, joints)

    The first row of `parameters` is the pose at which the motion starts, whatever the others are:
    `scaled` shrinks a motion towards it. Velocity and acceleration vanish at both ends. Derivatives
    are analytic, so limits of position, velocity, acceleration and jerk are linear in the
    parameters.

    **Attributes**

    - `duration`: of the motion [s].
    - `smoothness`: the highest order of a derivative that is continuous.
    """

    duration: float
    smoothness: ClassVar[float]

    @property
    @abc.abstractmethod
    def size(self) -> int:
        """Number of parameters of a joint, m."""

    @abc.abstractmethod
    def basis(self, time: Times, order: int = 0) -> Float[np.ndarray, "samples parameters"]:
        """Return the derivative of that order of each basis function, (samples, m)."""

    @abc.abstractmethod
    def bound(self, parameters: Parameters, order: int) -> Float[np.ndarray, " joints"]:
        """Bound the absolute derivative of that order, from 1, at all times, (joints,)."""

    @property
    @abc.abstractmethod
    def description(self) -> str:
        """A phrase for people, as in "quintic B-splines of 20 intervals"."""

    def derivative(
        self, parameters: Parameters, time: Times, order: int = 0
    ) -> Float[Array | np.ndarray, "samples joints"]:
        """Return positions, or their derivative of that order, (samples, joints)."""
        return self.basis(time, order) @ parameters

    def motion(self, parameters: Parameters, time: Times) -> tuple[Any, Any, Any]:
        """Return `q`, `qd`, `qdd`, each (samples, joints)."""
        q, qd, qdd = (self.derivative(parameters, time, order) for order in range(3))
        return q, qd, qdd

    def scaled(self, parameters: Parameters, factor: float) -> Parameters:
        """Return parameters of the motion with displacements from its start times a factor."""
        factors = np.full((self.size, 1), float(factor))
        factors[0] = 1.0
        return factors * parameters

    def between_samples(
        self, parameters: Parameters, order: int, interval: float
    ) -> Float[np.ndarray, " joints"]:
        """Bound how far a derivative exceeds, between samples, its values at both, (joints,).

        A function whose slope is at most b lies at most b h / 2 above its samples; one whose second
        derivative is at most c, at most c h² / 8.
        """
        if order + 1 <= self.smoothness:
            return interval**2 / 8 * self.bound(parameters, order + 2)
        if order <= self.smoothness:
            return interval / 2 * self.bound(parameters, order + 1)
        return self.bound(parameters, order)  # it jumps: samples say nothing


def sample_times(duration: float, rate: float) -> Times:
    """Return times from 0 to the duration, both included.

    There are `rate` samples per second, or slightly more.

    >>> sample_times(1.0, 4.0).tolist()
    [0.0, 0.25, 0.5, 0.75, 1.0]
    """
    return np.linspace(0.0, duration, int(np.ceil(duration * rate - 1e-9)) + 1)


def _check(duration: float, name: str, count: int, least: int) -> None:
    """**Raises** `ValueError` for a duration that is no time, or a count that is too small."""
    if not 0.0 < duration < np.inf:
        raise ValueError(f"duration is {duration}; expected more than 0 s")
    if count < least:
        raise ValueError(f"{name}: expected {least} or more, got {count}")


@dataclasses.dataclass(frozen=True)
class FourierSeries(AbstractFamily):
    """Sums of sines and cosines, periodic or not (Swevers et al. 1997).

    A periodic motion ends where it starts; its frequencies are multiples of 1/duration. Otherwise a
    polynomial of fifth degree is added. The parameters are those of an orthonormal basis of all
    motions that start and end at rest with zero acceleration.

    **Attributes**

    - `duration`: of a period, and of the motion [s].
    - `harmonics`: how many.
    - `periodic`: whether it ends in the pose in which it starts.

    **Raises**

    - `ValueError`: a duration that is not positive, or less than two harmonics.

    >>> import numpy as np
    >>> from jaxcslc.excitation import FourierSeries
    >>> family = FourierSeries(5.0, harmonics=4)
    >>> parameters = np.ones((family.size, 2))
    >>> q, qd, qdd = family.motion(parameters, np.array([0.0, 5.0]))
    >>> bool(np.allclose(q, 1.0) and np.allclose([qd, qdd], 0.0))
    True
    """

    smoothness: ClassVar[float] = np.inf
    duration: float
    harmonics: int = 6
    periodic: bool = True

    def __post_init__(self) -> None:
        _check(self.duration, "harmonics", self.harmonics, 2)

    @property
    def size(self) -> int:
        return 1 + self._null.shape[1]

    @property
    def description(self) -> str:
        kind = "periodic " if self.periodic else ""
        return f"{kind}Fourier series of {self.harmonics} harmonics"

    def basis(self, time: Times, order: int = 0) -> Float[np.ndarray, "samples parameters"]:
        first = np.full((len(time), 1), float(order == 0))
        return np.concatenate([first, self._functions(np.asarray(time), order) @ self._null], 1)

    def bound(self, parameters: Parameters, order: int) -> Float[np.ndarray, " joints"]:
        raw = self._null @ np.asarray(parameters)[1:]
        h = self.harmonics
        amplitude = np.hypot(raw[:h], raw[h : 2 * h])
        # Functions are of 2 pi t / duration, and powers of t / duration.
        total = (2 * np.pi * np.arange(1, h + 1) / self.duration) ** order @ amplitude
        for power, row in enumerate(raw[2 * h + 1 :], 1):
            if power >= order:
                factor = np.prod(np.arange(power - order + 1, power + 1))
                total = total + factor / self.duration**order * np.abs(row)
        return total

    def _functions(self, time: Times, order: int) -> Float[np.ndarray, "samples functions"]:
        rate = 2 * np.pi * np.arange(1, self.harmonics + 1) / self.duration
        phase = rate * time[:, None] + order * np.pi / 2
        columns = [rate**order * np.sin(phase), rate**order * np.cos(phase)]
        columns.append(np.full((len(time), 1), float(order == 0)))
        if not self.periodic:
            s = time[:, None] / self.duration
            for power in range(1, 6):
                factor = np.prod(np.arange(power - order + 1, power + 1.0))
                part = factor * s ** max(power - order, 0) if power >= order else 0.0 * s
                columns.append(part / self.duration**order)
        return np.concatenate(columns, axis=1)

    @cached_property
    def _null(self) -> Float[np.ndarray, "functions free"]:
        """Combinations of functions that start at zero, and start and end at rest.

        They fall with frequency, so that parameters of one size are accelerations of one size.
        """
        ends = np.array([0.0, self.duration])
        zero, velocity, acceleration = (self._functions(ends, order) for order in range(3))
        rows = [zero[:1], self.duration * velocity, self.duration**2 * acceleration]
        weights = np.ones(zero.shape[1])
        weights[: 2 * self.harmonics] = np.tile(1.0 / np.arange(1, self.harmonics + 1), 2)
        return weights[:, None] * scipy.linalg.null_space(np.concatenate(rows) * weights)


@dataclasses.dataclass(frozen=True)
class BSplines(AbstractFamily):
    """Quintic B-splines of uniform intervals.

    The first and last three control points are equal, so that the motion starts and ends at rest
    with zero acceleration. The convex hull of a derivative's control points bounds it between
    samples too.

    **Attributes**

    - `duration`: [s].
    - `intervals`: between knots, 3 or more.

    **Raises**

    - `ValueError`: a duration that is not positive, or less than three intervals.

    >>> import numpy as np
    >>> from jaxcslc.excitation import BSplines
    >>> family = BSplines(2.0, intervals=4)
    >>> parameters = np.zeros((family.size, 1))
    >>> parameters[1:] = 1.0
    >>> family.derivative(parameters, np.array([0.0, 2.0]))[:, 0].round(12).tolist()
    [0.0, 1.0]
    """

    smoothness: ClassVar[float] = _DEGREE - 1
    duration: float
    intervals: int = 20

    def __post_init__(self) -> None:
        _check(self.duration, "intervals", self.intervals, 3)

    @property
    def size(self) -> int:
        return self.intervals + 1  # of intervals + 5 control points, three are one at either end

    @property
    def description(self) -> str:
        return f"quintic B-splines of {self.intervals} intervals"

    def basis(self, time: Times, order: int = 0) -> Float[np.ndarray, "samples parameters"]:
        if order > _DEGREE:
            return np.zeros((len(time), self.size))
        return np.asarray(self._splines.derivative(order)(time) if order else self._splines(time))

    def bound(self, parameters: Parameters, order: int) -> Float[np.ndarray, " joints"]:
        if order > _DEGREE:
            return np.zeros(np.shape(parameters)[1])
        points = self._splines.c @ np.asarray(parameters)
        curve = scipy.interpolate.BSpline(self._splines.t, points, _DEGREE)
        derivative = curve.derivative(order)
        return np.abs(derivative.c[: len(derivative.t) - derivative.k - 1]).max(0)

    @cached_property
    def _splines(self) -> scipy.interpolate.BSpline:
        """Basis functions: control points relative to the first, which the first row is."""
        inner = np.linspace(0.0, self.duration, self.intervals + 1)
        knots = np.concatenate([[0.0] * _DEGREE, inner, [self.duration] * _DEGREE])
        points = np.zeros((self.intervals + _DEGREE, self.size))
        points[:, 0] = 1.0
        for i in range(1, self.size):
            points[i + 2, i] = 1.0
        points[-2:, -1] = 1.0
        return scipy.interpolate.BSpline(knots, points, _DEGREE)


@dataclasses.dataclass(frozen=True)
class MinimumJerkMoves(AbstractFamily):
    """Moves from pose to pose, each along the quintic of least jerk (Flash and Hogan 1985).

    All moves have the same duration.

    **Attributes**

    - `duration`: of all moves [s].
    - `moves`: how many.

    **Raises**

    - `ValueError`: a duration that is not positive, or no moves.

    >>> import numpy as np
    >>> from jaxcslc.excitation import MinimumJerkMoves
    >>> family = MinimumJerkMoves(4.0, moves=2)
    >>> poses = np.array([[0.0], [1.0], [0.5]])  # the start, then displacements from it
    >>> family.derivative(poses, np.array([0.0, 1.0, 2.0, 4.0]))[:, 0].tolist()
    [0.0, 0.5, 1.0, 0.5]
    """

    smoothness: ClassVar[float] = 2
    duration: float
    moves: int = 6

    def __post_init__(self) -> None:
        _check(self.duration, "moves", self.moves, 1)

    @property
    def size(self) -> int:
        return self.moves + 1

    @property
    def description(self) -> str:
        return f"{self.moves} minimum-jerk moves"

    def basis(self, time: Times, order: int = 0) -> Float[np.ndarray, "samples parameters"]:
        span = self.duration / self.moves
        phase = np.asarray(time)[:, None] / span - np.arange(self.moves)
        step = _QUINTIC.deriv(order)(np.clip(phase, 0.0, 1.0)) / span**order
        if order:  # where two moves meet, derivatives are those of the later one
            step = np.where((phase >= 0.0) & (phase < 1.0), step, 0.0)
        # A move brings the arm to pose i from pose i - 1: displacements are sums by parts.
        columns = step.copy()
        columns[:, :-1] -= step[:, 1:]
        return np.concatenate([np.full((len(step), 1), float(order == 0)), columns], axis=1)

    def bound(self, parameters: Parameters, order: int) -> Float[np.ndarray, " joints"]:
        if order > _DEGREE:
            return np.zeros(np.shape(parameters)[1])
        poses = np.array(parameters, float)
        poses[0] = 0.0
        length = np.abs(np.diff(poses, axis=0))
        return length.max(0) * _LARGEST[order] / (self.duration / self.moves) ** order


_QUINTIC = np.polynomial.Polynomial([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])
# Greatest absolute derivatives of the quintic within a move, by order: of the polynomial above.
_LARGEST = (1.0, 1.875, 10.0 / np.sqrt(3.0), 60.0, 360.0, 720.0)
