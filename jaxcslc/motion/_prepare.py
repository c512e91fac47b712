from typing import Any

from ._patterns import Patterns
from ._preparation import Preparation
from ._recording import Recording


def prepare(recording: Recording, **options: Any) -> Patterns:
    """Turns a recording of positions and torques into patterns for a fit.

    **Arguments**

    - `recording`: positions and torques.
    - `options`: those of `Preparation`, with the same defaults.

    **Returns**

    The patterns.

    **Raises**

    - `TypeError`: an option that `Preparation` does not have.
    - `ValueError`: as `Preparation` and `Preparation.patterns`.

    >>> import numpy as np, jaxcslc as jc
    >>> time = np.arange(500) * 0.002
    >>> position = np.sin(2 * np.pi * time)[:, None].round(4)
    >>> recording = jc.Recording(time, position, np.cos(time)[:, None])
    >>> patterns = jc.prepare(recording, smoothing=jc.AveragedSplines(9))
    >>> patterns.samples
    482
    >>> error = patterns.qd[:, 0] - 2 * np.pi * np.cos(2 * np.pi * patterns.time)
    >>> bool(np.max(np.abs(error)) < 0.01)
    True
    """
    return Preparation(**options).patterns(recording)


def as_recorded(recording: Recording, **options: Any) -> Patterns:
    """Takes velocities and accelerations from the recording itself, without any smoothing.

    For simulated truth, and for machines that measure both.

    **Arguments**

    - `recording`: with velocity and acceleration.
    - `options`: those of `Preparation` that are about torques and masks, with the same defaults;
      nothing is trimmed by default.

    **Returns**

    The patterns.

    **Raises**

    - `ValueError`: a recording without velocity or acceleration, options that make no sense, or
      a selection that leaves nothing.

    >>> import numpy as np
    >>> from jaxcslc.motion import as_recorded, Recording
    >>> time = np.linspace(0.0, 1.0, 50)
    >>> columns = [f(time)[:, None] for f in (np.sin, np.cos, np.cos)]
    >>> recording = Recording(time, columns[0], columns[1], columns[2], -columns[0])
    >>> bool((as_recorded(recording).qdd == -columns[0]).all())
    True
    """
    if recording.velocity is None or recording.acceleration is None:
        missing = "velocity" if recording.velocity is None else "acceleration"
        raise ValueError(f"the recording has no {missing}; expected velocity and acceleration")
    derivatives = (recording.position, recording.velocity, recording.acceleration)
    untrimmed: dict[str, Any] = {"trim": 0, **options}
    return Preparation(**untrimmed).patterns(recording, derivatives)
