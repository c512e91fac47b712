"""Reversals of a joint's velocity: which is quickest, and which shows static friction best."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


# Samples on either side of a reversal that are looked at.
_REACH = 80
# The fewest samples of a ramp, and beside it, that its height is taken from.
_FEWEST = 3


def clean_turn(velocity: Float[np.ndarray, " samples"]) -> int:
    """The sample before the quickest reversal of a joint's velocity: one that does not stick."""
    turns = np.flatnonzero(np.diff(np.sign(velocity)))
    turns = turns[(turns > 100) & (turns < velocity.size - 100)]
    quickness = np.minimum(np.abs(velocity[turns - 20]), np.abs(velocity[turns + 20]))
    return int(turns[np.argmax(quickness)])


class Ramps(NamedTuple):
    """A reversal and the ramps of the error on either side of it (7.6).

    - `joint`: from 0; `sample`: the last one before the reversal.
    - `before`, `after`: heights, positive if the error is along the motion: by how much the mean
      error of speeds below half the threshold exceeds that of speeds from one to three times
      the threshold, as part of dry friction.
    """

    joint: int
    sample: int
    before: float
    after: float

    @property
    def lower(self) -> float:
        """The height of the lower ramp."""
        return min(self.before, self.after)


def clearest_ramps(
    qd: Float[np.ndarray, "samples joints"],
    error: Float[np.ndarray, "samples joints"],
    thresholds: Float[np.ndarray, " joints"],
    dry: Float[np.ndarray, " joints"],
) -> Ramps:
    """The reversal whose lower ramp is highest, among those of all joints.

    A joint that sticks or turns back before it has left the ramp shows none.

    **Arguments**

    - `qd`: estimated velocities, and `error`: measured less predicted torque, of every sample.
    - `thresholds`: speeds below which static friction is significant [rad/s].
    - `dry`: dry friction, in whose units ramps of different joints are compared [N m].

    **Raises**

    - `ValueError`: no reversal has ramps on both sides.
    """
    reversals: list[Ramps] = []
    for joint in range(qd.shape[1]):
        velocity, column = qd[:, joint], error[:, joint]
        for turn in np.flatnonzero(np.diff(np.sign(velocity))):
            if not _REACH <= turn < len(qd) - _REACH:
                continue
            earlier = slice(turn, turn - _REACH, -1)
            later = slice(turn + 1, turn + 1 + _REACH)
            heights = [
                _height(velocity[side], column[side], float(thresholds[joint]))
                for side in (earlier, later)
            ]
            before, after = (float(height / dry[joint]) for height in heights)
            if np.isfinite(before) and np.isfinite(after):
                reversals.append(Ramps(joint, int(turn), before, after))
    if not reversals:
        raise ValueError("no reversal has ramps on both sides; expected a joint that turns round")
    return max(reversals, key=lambda ramps: ramps.lower)


def _height(
    velocity: Float[np.ndarray, " samples"], error: Float[np.ndarray, " samples"], threshold: float
) -> float:
    """The height of a ramp, from the reversal outwards; NaN where there is none."""
    direction, speed = np.sign(velocity[0]), np.abs(velocity)
    same_way = np.logical_and.accumulate(np.sign(velocity) == direction)
    ramp = same_way & np.logical_and.accumulate(speed < threshold / 2)
    beside = same_way & (speed > threshold) & (speed < 3 * threshold)
    if min(ramp.sum(), beside.sum()) < _FEWEST:
        return np.nan
    along = direction * error
    return float(along[ramp].mean() - along[beside].mean())
