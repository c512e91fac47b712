"""Recording of an arm of position servos: commands, measured positions, and no torque."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from .._text_table import counted
from ..recordings import as_float, check_quantities


@dataclasses.dataclass(frozen=True, eq=False, init=False)
class ServoRecording:
    """Commanded and measured joint positions of an arm of servos, sampled in time.

    A servo holds its command until the next one comes. The command of row n is the latest one
    that was sent up to `time[n]`.

    **Attributes**

    - `time`: instants of the samples, shape `(samples,)` [s], strictly increasing.
    - `position`: measured positions, shape `(samples, joints)` [rad or m].
    - `command`: commanded positions, shape `(samples, joints)` [rad or m].
    - `velocity`: measured velocities, shape `(samples, joints)` [rad/s or m/s], or `None`.
    - `current`: motor currents as reported, shape `(samples, joints)`, or `None`. Signs and units
        are the servo's.
    - `joint_names`: names of the joints, or `None`.
    - `notes`: sentences about what was decided in reading it.

    Arrays are float64.

    >>> import numpy as np
    >>> from jaxcslc.servo import ServoRecording
    >>> time = np.arange(50) * 0.02
    >>> command = np.sin(time)[:, None]
    >>> recording = ServoRecording(time, 0.98 * command, command, joint_names=["shoulder"])
    >>> recording
    ServoRecording(50 samples of 1 joint, 0.98 s, 50 Hz)
    """

    time: Float[np.ndarray, " samples"]
    position: Float[np.ndarray, "samples joints"]
    command: Float[np.ndarray, "samples joints"]
    velocity: Float[np.ndarray, "samples joints"] | None
    current: Float[np.ndarray, "samples joints"] | None
    joint_names: tuple[str, ...] | None
    notes: tuple[str, ...]

    def __init__(
        self,
        time: ArrayLike,
        position: ArrayLike,
        command: ArrayLike,
        velocity: ArrayLike | None = None,
        current: ArrayLike | None = None,
        joint_names: Sequence[str] | None = None,
        notes: Sequence[str] = (),
    ):
        """**Arguments**

        As the attributes; anything that NumPy can turn into float64 arrays of those shapes.

        **Raises**

        - `RecordingError`: shapes that disagree, fewer than five samples, values that are not
            finite, or time that does not strictly increase. Samples and joints count from 1 in
            the message.
        """
        times = as_float("time", time, 1)
        given = {"position": position, "command": command, "velocity": velocity, "current": current}
        quantities = {
            name: as_float(name, values, 2) for name, values in given.items() if values is not None
        }
        check_quantities(times, quantities, joint_names)
        fields = {
            **dict.fromkeys(given),
            **quantities,
            "time": times,
            "joint_names": None if joint_names is None else tuple(joint_names),
            "notes": tuple(notes),
        }
        for name, value in fields.items():
            object.__setattr__(self, name, value)

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.position.shape[0]

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self.position.shape[1]

    def rows(self, selected: slice | Bool[np.ndarray, " samples"]) -> "ServoRecording":
        """Return the recording of some of the samples.

        **Arguments**

        - `selected`: a slice, or True for each sample to keep, shape `(samples,)`.

        **Raises**

        - `RecordingError`: fewer than five are left.
        """
        return ServoRecording(
            self.time[selected],
            self.position[selected],
            self.command[selected],
            None if self.velocity is None else self.velocity[selected],
            None if self.current is None else self.current[selected],
            self.joint_names,
            self.notes,
        )

    def between(self, start: float, end: float) -> "ServoRecording":
        """Return a segment of the recording, its times unchanged.

        **Arguments**

        - `start`, `end`: seconds since the first sample; both ends belong to the segment.

        **Raises**

        - `RecordingError`: fewer than five samples are left.

        >>> import numpy as np
        >>> from jaxcslc.servo import ServoRecording
        >>> time, line = 10.0 + np.arange(100) * 0.1, np.arange(100.0)[:, None]
        >>> ServoRecording(time, line, line).between(1.0, 2.0).time[[0, -1]].tolist()
        [11.0, 12.0]
        """
        time = self.time - self.time[0]
        return self.rows((time >= start) & (time <= end))

    def __repr__(self) -> str:
        duration = float(self.time[-1] - self.time[0])
        return (
            f"ServoRecording({self.samples} samples of {counted(self.joints, 'joint')},"
            f" {duration:.4g} s, {1.0 / float(np.median(np.diff(self.time))):.4g} Hz)"
        )
