import abc
from typing import TypeAlias

import equinox as eqx
import numpy as np
from jaxtyping import Float


Derivatives: TypeAlias = tuple[
    Float[np.ndarray, "samples joints"],
    Float[np.ndarray, "samples joints"],
    Float[np.ndarray, "samples joints"],
]
"""Positions, velocities and accelerations, each of shape `(samples, joints)`."""


class AbstractSmoothing(eqx.Module):
    """A way from sampled positions to positions, velocities and accelerations.

    ```python
    >>> from jaxcslc.motion import AbstractSmoothing, AveragedSplines, Butterworth
    >>> all(issubclass(s, AbstractSmoothing) for s in (AveragedSplines, Butterworth))
    True

    ```
    """

    @abc.abstractmethod
    def smooth(
        self, time: Float[np.ndarray, " samples"], position: Float[np.ndarray, "samples joints"]
    ) -> Derivatives:
        """Smooths and differentiates.

        **Arguments:**

        - `time`: instants of the samples, shape `(samples,)` [s].
        - `position`: joint positions, shape `(samples, joints)` [rad or m].

        **Returns:**

        `q`, `qd`, `qdd`, each of shape `(samples, joints)`.

        **Raises:**

        - `ValueError`: too few samples, or time that the method cannot use.
        """

    @abc.abstractmethod
    def low_pass(
        self, time: Float[np.ndarray, " samples"], signal: Float[np.ndarray, "samples joints"]
    ) -> Float[np.ndarray, "samples joints"]:
        """Smooths a signal that is no position, such as a torque, by the same filter.

        **Arguments:**

        - `time`: instants of the samples, shape `(samples,)` [s].
        - `signal`: shape `(samples, joints)`.

        **Returns:**

        The smoothed signal, shape `(samples, joints)`.
        """


def without_rounding(
    position: Float[np.ndarray, "samples joints"], derivatives: Derivatives
) -> Derivatives:
    """Velocity and acceleration of joints that stand still all the time set to exactly zero.

    Smoothing leaves rounding of them, whose sign would be taken for the direction of a motion.

    >>> import numpy as np
    >>> still, noise = np.full((3, 1), 0.3), np.full((3, 1), 1e-17)
    >>> bool(np.any(without_rounding(still, (still, noise, noise))[1]))
    False
    """
    q, qd, qdd = derivatives
    moves = np.ptp(position, axis=0) > 1e-12 * np.max(np.abs(position), axis=0)
    return q, np.where(moves, qd, 0.0), np.where(moves, qdd, 0.0)
