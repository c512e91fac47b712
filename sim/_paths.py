import abc
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ._arrays import Array, namespace, spread


class AbstractPath(abc.ABC):
    """Where the joints should be, as a function of the time and of where they were at first."""

    @abc.abstractmethod
    def position(
        self, time: Float[Array, "*batch 1"], origin: Float[Array, "*batch joints"]
    ) -> Float[Array, "*batch joints"]:
        """Positions at `time` [s] on the way from `origin`, where the joints rest at time 0
        [rad or m]."""


@dataclass(frozen=True, eq=False)
class MinimumJerk(AbstractPath):
    """A straight line in joint space from rest to rest, along `minimum_jerk`.

    ```python
    >>> import numpy as np
    >>> from sim import MinimumJerk
    >>> path = MinimumJerk(end=np.array([1.0, -1.0]), duration=2.0)
    >>> path.position(np.array([1.0]), np.zeros(2))
    array([ 0.5, -0.5])

    ```
    """

    end: Float[np.ndarray, " joints"]
    """Where the path ends [rad or m]."""

    duration: float
    """[s]; afterwards the end is held."""

    def position(
        self, time: Float[Array, "*batch 1"], origin: Float[Array, "*batch joints"]
    ) -> Float[Array, "*batch joints"]:
        """As the abstract method."""
        return origin + (spread(self.end, origin) - origin) * minimum_jerk(time / self.duration)


@dataclass(frozen=True, eq=False)
class Oscillation(AbstractPath):
    """A sinusoid about a mean, for ever: mean − amplitude cos(2π time / period).

    It begins at rest at mean − amplitude, wherever the joints are found.

    ```python
    >>> import numpy as np
    >>> from sim import Oscillation
    >>> path = Oscillation(np.array([1.0]), np.array([0.2]), period=4.0)
    >>> [float(path.position(np.array([t]), np.zeros(1))[0].round(3)) for t in (0.0, 1.0, 2.0)]
    [0.8, 1.0, 1.2]

    ```
    """

    mean: Float[np.ndarray, " joints"]
    """[rad or m]."""

    amplitude: Float[np.ndarray, " joints"]
    """[rad or m]; zero for a joint that is to be held."""

    period: float
    """[s]."""

    def position(
        self, time: Float[Array, "*batch 1"], origin: Float[Array, "*batch joints"]
    ) -> Float[Array, "*batch joints"]:
        """As the abstract method."""
        wave = namespace(time).cos(2 * np.pi / self.period * time)
        return spread(self.mean, origin) - spread(self.amplitude, origin) * wave


def minimum_jerk(s: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """The quintic from 0 at s = 0 to 1 at s = 1 that starts and ends at rest, unaccelerated.

    Of all such motions it has the least mean square jerk (Flash and Hogan 1985). Before and after
    it stays at 0 and at 1.

    ```python
    >>> import numpy as np
    >>> from sim import minimum_jerk
    >>> minimum_jerk(np.array([-1.0, 0.5, 2.0]))
    array([0. , 0.5, 1. ])

    ```
    """
    s = namespace(s).clip(s, 0.0, 1.0)
    return s * s * s * (10.0 + s * (6.0 * s - 15.0))
