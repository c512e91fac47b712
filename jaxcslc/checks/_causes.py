"""Causes of what a recording's torque does not explain, and recordings without them."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ..recordings import Patterns, Recording
from ._evidence import Evidence
from ._findings import Finding


LEAST_GAIN = 0.15
"""Least fall of the mean logarithm of the joints' errors once a cause is removed."""
ALIKE = LEAST_GAIN / 3.0
"""Causes whose gains differ by a third of that are told apart by chance."""
# A remedy must take away this part of the squares of the errors beyond noise, of joints with errors
# of this part of their torque. (Smaller ones may be friction's that no model has.)
_REMOVED, _LARGE = 0.5, 0.05


@dataclasses.dataclass(frozen=True)
class Cause:
    """A finding, and the evidence without what it names.

    - `finding`: with its evidence.
    - `gain`: decrease of the mean logarithm of the errors once the cause is corrected.
    - `mended`: returns the evidence of the recording without what the finding names; None if
      nothing else can be judged with it.
    """

    finding: Finding
    gain: float
    mended: Callable[[], Evidence | None]


def removes(
    before: Float[np.ndarray, " joints"],
    after: Float[np.ndarray, " joints"],
    noise: Float[np.ndarray, " joints"],
) -> bool:
    """Return whether a remedy takes away most of the large errors beyond noise.

    >>> before, noise = np.array([0.2, 0.02]), np.array([0.01, 0.01])
    >>> removes(before, np.array([0.05, 0.02]), noise), removes(before, 0.9 * before, noise)
    (True, False)
    """
    excess, remaining = (np.maximum(errors**2 - noise**2, 0.0) for errors in (before, after))
    large = before > _LARGE
    return bool(np.sum(remaining[large]) <= (1.0 - _REMOVED) * np.sum(excess[large]))


@dataclasses.dataclass(frozen=True, eq=False)
class Change:
    """Columns of positions and torques in another order, and multiplied by factors.

    - `motion_order`, `torque_order`: (n,) which column becomes each joint's; None for the same.
    - `motion_factors`, `torque_factors`: (n,) of the columns in their new order.
    - `motion_offsets`: (n,) added to the positions last [rad or m].
    """

    motion_order: Int[np.ndarray, " joints"] | None = None
    torque_order: Int[np.ndarray, " joints"] | None = None
    motion_factors: Float[np.ndarray, " joints"] | float = 1.0
    torque_factors: Float[np.ndarray, " joints"] | float = 1.0
    motion_offsets: Float[np.ndarray, " joints"] | float = 0.0

    def patterns(self, patterns: Patterns) -> Patterns:
        """Return the patterns of the changed recording."""
        q, qd, qdd = (self._motion(x) for x in (patterns.q, patterns.qd, patterns.qdd))
        valid = np.asarray(patterns.backlash_mask)
        return Patterns(
            patterns.time,
            q + self.motion_offsets,
            qd,
            qdd,
            self._torque(patterns.torque),
            # Where both columns of a joint are measured.
            _ordered(valid, self.motion_order) & _ordered(valid, self.torque_order),
            _ordered(patterns.friction_mask, self.motion_order),
        )

    def recording(self, recording: Recording) -> Recording:
        """Return the changed recording, without velocities and accelerations."""
        position, torque = self._motion(recording.position), self._torque(recording.torque)
        return Recording(recording.time, position + self.motion_offsets, torque)

    def _motion(self, values: Any) -> np.ndarray:
        return _ordered(values, self.motion_order) * self.motion_factors

    def _torque(self, values: Any) -> np.ndarray:
        return _ordered(values, self.torque_order) * self.torque_factors


def _ordered(values: Any, order: Int[np.ndarray, " joints"] | None) -> np.ndarray:
    values = np.asarray(values)
    return values if order is None else values[:, order]
