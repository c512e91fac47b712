import dataclasses
from collections.abc import Sequence
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from ...motion import Recording


TorqueSampling = Literal["held", "sampled"]
"""What a recorded torque is: held until the next sample, or the value at the sample's instant."""


@dataclasses.dataclass(frozen=True)
class Readings:
    """One recording, or several one after the other, as the equations of motion need them.

    **Attributes**

    - `time`: (samples,) going on after each recording [s].
    - `position`: (samples, n) as recorded.
    - `torque`: (equations, n), averaged over the two intervals of each equation.
    - `part`: (samples,) number of the recording that a sample belongs to.
    - `joined`: (equations,) those that span two recordings, and are none.

    >>> import numpy as np
    >>> line = np.arange(5.0)[:, None]
    >>> readings = Readings.of([Recording(np.arange(5.0), line, line)] * 2, "sampled")
    >>> readings.time.tolist(), readings.part.tolist()
    ([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0], [0, 0, 0, 0, 0, 1, 1, 1, 1, 1])
    >>> readings.joined.tolist()
    [False, False, False, True, True, False, False, False]
    """

    time: Float[np.ndarray, " samples"]
    position: Float[np.ndarray, "samples joints"]
    torque: Float[np.ndarray, "equations joints"]
    part: Int[np.ndarray, " samples"]
    joined: Bool[np.ndarray, " equations"]

    @classmethod
    def of(cls, recordings: Sequence[Recording], torque_sampling: TorqueSampling) -> "Readings":
        """Those of recordings of the same joints."""
        times: list[np.ndarray] = []
        start = 0.0
        for recording in recordings:
            time = np.asarray(recording.time) - recording.time[0] + start
            times.append(time)
            start = float(time[-1] + np.mean(np.diff(time)))
        part = np.repeat(np.arange(len(recordings)), [len(time) for time in times])
        time = np.concatenate(times)
        torque = np.concatenate([np.asarray(recording.torque) for recording in recordings])
        return cls(
            time,
            np.concatenate([np.asarray(recording.position) for recording in recordings]),
            averaged_torque(time, torque, torque_sampling),
            part,
            part[2:] != part[:-2],
        )

    @property
    def recordings(self) -> int:
        """How many."""
        return int(self.part[-1]) + 1


def averaged_torque(
    time: Float[np.ndarray, " samples"],
    torque: Float[np.ndarray, "samples joints"],
    torque_sampling: TorqueSampling,
) -> Float[np.ndarray, "equations joints"]:
    """The recorded torque, averaged as the second difference averages acceleration.

    >>> import numpy as np
    >>> line = np.arange(5.0)[:, None]
    >>> averaged_torque(np.arange(5.0), line, "held")[:, 0].tolist()
    [0.5, 1.5, 2.5]
    >>> averaged_torque(np.arange(5.0), line, "sampled")[:, 0].tolist()
    [1.0, 2.0, 3.0]
    """
    h = np.diff(time)[:, None]
    before, after = h[:-1] / (h[:-1] + h[1:]), h[1:] / (h[:-1] + h[1:])
    if torque_sampling == "held":
        return before * torque[:-2] + after * torque[1:-1]
    # Linear between samples: two thirds of each triangle are at its middle, a third at its end.
    return (before * torque[:-2] + 2.0 * torque[1:-1] + after * torque[2:]) / 3.0
