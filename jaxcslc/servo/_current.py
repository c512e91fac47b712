"""Gain of the motors' current over the identified torque, joint by joint.

A current is one more reading of the torque: current = idle + gain * torque, or of the torque's
size where the servo reports no sign. The torque is that of the identified drives at the measured
positions. Read with `_fit`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Float

from ._drive import ServoDrive
from ._intervals import BLOCK
from ._recording import ServoRecording


_LEAST_EXPLAINED = 0.2  # part of the current's variance; less is no reading of this torque


@dataclass(frozen=True)
class CurrentGain:
    """Gain of one joint's current, with its 95 % interval.

    **Attributes**

    - `joint`: index of the joint, from 0.
    - `value`, `low`, `high`: gain and its interval, in units of the current per N m. The interval
      takes the torques as exact: their common scale is that of the drive's `gain`.
    - `idle`: current without torque, in its unit.
    - `is_signed`: whether the servos report the current's sign: any joint's is negative somewhere.
    - `explained`: part of the current's variance that the torque explains.

    >>> from jaxcslc.servo import CurrentGain
    >>> CurrentGain(0, 0.8, 0.75, 0.85, 0.02, False, 0.9).is_reading
    True
    """

    joint: int
    value: float
    low: float
    high: float
    idle: float
    is_signed: bool
    explained: float

    @property
    def is_reading(self) -> bool:
        """True if the current follows the torque."""
        return self.explained >= _LEAST_EXPLAINED and self.value > 0.0


def current_gains(
    drives: Sequence[ServoDrive],
    recordings: Sequence[ServoRecording],
    velocities: Sequence[Float[np.ndarray, "samples joints"]],
) -> tuple[CurrentGain, ...]:
    """Return the gains of joints whose recordings have currents.

    - `velocities`: measured ones, smoothed, of each recording.
    """
    found: list[CurrentGain] = []
    given = [(x, v) for x, v in zip(recordings, velocities, strict=True) if x.current is not None]
    is_signed = any(bool(np.any(x.current < 0.0)) for x, _ in given if x.current is not None)
    for i, drive in enumerate(drives):
        torques: list[np.ndarray] = []
        currents: list[np.ndarray] = []
        blocks: list[np.ndarray] = []
        for number, (recording, v) in enumerate(given):
            assert recording.current is not None
            time = recording.time
            error = np.interp(time - drive.delay, time, recording.command[:, i])
            error -= recording.position[:, i]
            error = np.sign(error) * np.maximum(np.abs(error) - drive.dead_zone, 0.0)
            torque = drive.gain * error - drive.damping * v[:, i]
            torques.append(np.clip(torque, -drive.torque_limit, drive.torque_limit))
            currents.append(recording.current[:, i])
            blocks.append(1e6 * number + np.floor((time - time[0]) / BLOCK))
        if not given or np.ptp(np.concatenate(currents)) == 0.0:
            continue
        torque, current = np.concatenate(torques), np.concatenate(currents)
        found.append(_gain(i, torque, current, np.concatenate(blocks), is_signed))
    return tuple(found)


def _gain(
    joint: int,
    torque: Float[np.ndarray, " samples"],
    current: Float[np.ndarray, " samples"],
    blocks: Float[np.ndarray, " samples"],
    is_signed: bool,
) -> CurrentGain:
    A = np.stack([np.ones_like(torque), torque if is_signed else np.abs(torque)], axis=1)
    values = np.linalg.lstsq(A, current)[0]
    rest = current - A @ values
    labels = np.unique(blocks)
    scores = np.array([A[blocks == x].T @ rest[blocks == x] for x in labels])
    bread = np.linalg.pinv(A.T @ A)
    covariance = bread @ (scores.T @ scores) @ bread * len(labels) / max(len(labels) - 2, 1)
    half = float(scipy.special.stdtrit(max(len(labels) - 2, 1), 0.975) * np.sqrt(covariance[1, 1]))
    value = float(values[1])
    explained = 1.0 - float(np.var(rest) / np.var(current))
    return CurrentGain(
        joint, value, value - half, value + half, float(values[0]), is_signed, explained
    )
