from ..motion import Recording


# Without a validation recording, this part of each recording, its last, is held out.
_HELD_OUT = 0.25
# A recording of fewer samples is not divided.
FEWEST_SAMPLES = 400


def held_out_from(recording: Recording) -> float:
    """The instant at which the part of a recording that is held out begins [s].

    >>> import numpy as np, jaxcslc as jc
    >>> still = np.zeros((5, 1))
    >>> held_out_from(jc.Recording(np.arange(5.0), still, still))
    3.0
    """
    start, end = float(recording.time[0]), float(recording.time[-1])
    return end - _HELD_OUT * (end - start)
