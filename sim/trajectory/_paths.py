"""Desired paths of joints, in NumPy and JAX alike."""

import abc
from dataclasses import dataclass
from typing import Any, no_type_check

import jax
import numpy as np
from jaxtyping import Float

from jaxcslc.control import Reference
from sim.machine._bodies import MachineError


Array = np.ndarray | jax.Array
"""An array of either library, a tracer included. Code for both uses the functions of
`xp = array.__array_namespace__()` (Python Array API), does not modify arrays, and has no branch
on an array's value or on the time."""


# Called many times a sample: tests check the annotations of the callers instead.
@no_type_check
def namespace(array: Array) -> Any:
    """The library of an array: `numpy` or `jax.numpy`."""
    return array.__array_namespace__()


@no_type_check
def spread(values: np.ndarray, like: Array) -> Array:
    """Constants for every row of another array (*batch, n): in its library, of its type, and with
    an axis of one for each of its batch axes. JAX then need not promote ranks, which
    a setting can forbid. NumPy needs nothing of that: its constants are returned as they are."""
    if isinstance(like, np.ndarray) and like.dtype == values.dtype:
        return values
    shape = (1,) * (like.ndim - 1) + values.shape
    return namespace(like).asarray(values.reshape(shape), dtype=like.dtype)


class AbstractPath(abc.ABC):
    """Desired joint motion as a function of the time and of the initial positions."""

    @abc.abstractmethod
    def reference(
        self, time: Float[Array, "*batch 1"], origin: Float[Array, "*batch joints"]
    ) -> Reference:
        """Positions, velocities and accelerations at `time` [s] of the path from `origin`, the
        joint positions at rest at time 0 [rad or m]."""

    def position(
        self, time: Float[Array, "*batch 1"], origin: Float[Array, "*batch joints"]
    ) -> Float[Array, "*batch joints"]:
        """The positions alone [rad or m]."""
        return self.reference(time, origin).q


@dataclass(frozen=True, eq=False)
class MinimumJerk(AbstractPath):
    """A straight line in joint space from rest to rest, along `minimum_jerk`.

    >>> import numpy as np
    >>> from sim import MinimumJerk
    >>> path = MinimumJerk(end=np.array([1.0, -1.0]), duration=2.0)
    >>> path.reference(np.array([1.0]), np.zeros(2)).qd
    array([ 0.9375, -0.9375])
    """

    end: Float[np.ndarray, " joints"]
    """Where the path ends [rad or m]."""

    duration: float
    """[s]; afterwards the path stays at `end`."""

    def reference(
        self, time: Float[Array, "*batch 1"], origin: Float[Array, "*batch joints"]
    ) -> Reference:
        """Return what the abstract method declares."""
        way = spread(self.end, origin) - origin
        s, rate, change = _minimum_jerk(time / self.duration)
        return Reference(
            origin + way * s, way * (rate / self.duration), way * (change / self.duration**2)
        )


@dataclass(frozen=True, eq=False)
class ViaPoints(AbstractPath):
    """Path from pose to pose, from rest to rest along `minimum_jerk`, with a stay at each.

    With a first axis of machines in all three tables, each machine has its path, all of as many
    poses.

    >>> import numpy as np
    >>> from sim import ViaPoints
    >>> path = ViaPoints(np.array([[1.0], [0.5]]), np.array([2.0, 1.0]), np.array([0.5, 0.0]))
    >>> [float(path.position(np.array([t]), np.zeros(1))[0]) for t in (1.0, 2.2, 3.0, 9.0)]
    [0.5, 1.0, 0.75, 0.5]
    >>> path.arrivals
    array([2. , 3.5])

    **Raises** `MachineError`: not one duration and one stay a pose, or a duration that is not
    positive.
    """

    poses: Float[np.ndarray, "*machines poses joints"]
    """The via points [rad or m]."""

    durations: Float[np.ndarray, "... _"]
    """Of the motion to each pose [s]."""

    stays: Float[np.ndarray, "... _"]
    """Time at rest at each pose [s]; the path stays at the last one."""

    def __post_init__(self) -> None:
        shape, count = self.poses.shape[:-1], self.poses.shape[-2]
        if not count or self.durations.shape != shape or self.stays.shape != shape:
            raise MachineError(
                f"path of {count} poses, {self.durations.size} durations and {self.stays.size}"
                " stays; expected one of each a pose"
            )
        if not (np.all(self.durations > 0) and np.all(self.stays >= 0)):
            raise MachineError("path: expected durations above zero, and no negative stays")

    @property
    def arrivals(self) -> Float[np.ndarray, "*machines poses"]:
        """Times at which each pose is reached [s]."""
        return np.cumsum(self.durations, -1) + np.cumsum(self.stays, -1) - self.stays

    def reference(
        self, time: Float[Array, "*batch 1"], origin: Float[Array, "*batch joints"]
    ) -> Reference:
        """Return what the abstract method declares."""
        alike = self.poses.ndim == 2
        broadcast = spread if alike else _rows
        duration = broadcast(self.durations, time)
        first = broadcast(self.poses[..., 0, :], origin) - origin
        segments = namespace(origin).asarray(np.diff(self.poses, axis=-2), dtype=origin.dtype)
        s, rate, change = _minimum_jerk(1 + (time - broadcast(self.arrivals, time)) / duration)

        def along(parts: Array) -> Array:
            later = parts[..., 1:]
            later = later @ segments if alike else (later[..., None, :] @ segments)[..., 0, :]
            return first * parts[..., :1] + later

        return Reference(origin + along(s), along(rate / duration), along(change / duration**2))


@dataclass(frozen=True, eq=False)
class Oscillation(AbstractPath):
    """An endless sinusoid about a mean: mean − amplitude cos(2π time / period).

    It begins at rest at mean − amplitude, whatever the initial positions.

    >>> import numpy as np
    >>> from sim import Oscillation
    >>> path = Oscillation(np.array([1.0]), np.array([0.2]), period=4.0)
    >>> [float(path.position(np.array([t]), np.zeros(1))[0].round(3)) for t in (0.0, 1.0, 2.0)]
    [0.8, 1.0, 1.2]
    """

    mean: Float[np.ndarray, " joints"]
    """[rad or m]."""

    amplitude: Float[np.ndarray, " joints"]
    """[rad or m]; zero for a joint that is to stay at its mean."""

    period: float
    """[s]."""

    def reference(
        self, time: Float[Array, "*batch 1"], origin: Float[Array, "*batch joints"]
    ) -> Reference:
        """Return what the abstract method declares."""
        xp, rate = namespace(time), 2 * np.pi / self.period
        amplitude = spread(self.amplitude, origin)
        wave = amplitude * xp.cos(rate * time)
        return Reference(
            spread(self.mean, origin) - wave,
            amplitude * (rate * xp.sin(rate * time)),
            rate**2 * wave,
        )


@dataclass(frozen=True, eq=False)
class SampledPath(AbstractPath):
    """A precomputed path, row by row; after the last row it stays there.

    It begins at its first row, whatever the initial positions.

    >>> import numpy as np
    >>> from sim import SampledPath
    >>> rows = np.array([[0.0], [0.1], [0.2]])
    >>> path = SampledPath(rows, np.full((3, 1), 50.0), np.zeros((3, 1)), interval=0.002)
    >>> path.reference(np.array([0.004]), np.zeros(1)).q
    array([0.2])

    **Raises** `MachineError`: tables of different shapes.
    """

    q: Float[np.ndarray, "rows joints"]
    """[rad or m]."""

    qd: Float[np.ndarray, "_ _"]
    """[rad/s or m/s]."""

    qdd: Float[np.ndarray, "_ _"]
    """[rad/s² or m/s²]."""

    interval: float = 0.002
    """Between rows [s]. Times between two rows are rounded to the nearer one."""

    def __post_init__(self) -> None:
        if not self.q.shape == self.qd.shape == self.qdd.shape:
            raise MachineError(
                f"path with tables of shapes {self.q.shape}, {self.qd.shape}, {self.qdd.shape};"
                " expected the same"
            )

    @property
    def start(self) -> Float[np.ndarray, " joints"]:
        """The first row [rad or m]."""
        return self.q[0]

    @property
    def duration(self) -> float:
        """Time at which the last row is reached [s]."""
        return self.interval * (len(self.q) - 1)

    def reference(
        self, time: Float[Array, "*batch 1"], origin: Float[Array, "*batch joints"]
    ) -> Reference:
        """Return what the abstract method declares."""
        xp = namespace(time)
        row = xp.clip(xp.round(time[..., 0] / self.interval), 0, len(self.q) - 1).astype(int)
        q, qd, qdd = (
            namespace(origin).asarray(table, dtype=origin.dtype)[row]
            for table in (self.q, self.qd, self.qdd)
        )
        return Reference(q, qd, qdd)


def minimum_jerk(s: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """The quintic from 0 at s = 0 to 1 at s = 1 that starts and ends at rest, unaccelerated.

    Of all such motions it has the least mean square jerk (Flash and Hogan 1985). Before and after
    it stays at 0 and at 1.

    >>> import numpy as np
    >>> from sim import minimum_jerk
    >>> minimum_jerk(np.array([-1.0, 0.5, 2.0]))
    array([0. , 0.5, 1. ])
    """
    return _minimum_jerk(s)[0]


def _rows(values: np.ndarray, like: Array) -> Array:
    """A row for each row of another array (machines, n), in its library and of its type."""
    return namespace(like).asarray(values, dtype=like.dtype)


def _minimum_jerk(s: Array) -> tuple[Array, Array, Array]:
    """The quintic and its first two derivatives."""
    s = namespace(s).clip(s, 0.0, 1.0)
    left = 1.0 - s
    return (
        s * s * s * (10.0 + s * (6.0 * s - 15.0)),
        30.0 * (s * left) * (s * left),
        60.0 * s * left * (1.0 - 2.0 * s),
    )
