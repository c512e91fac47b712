from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Float


TorqueAlignment: TypeAlias = Literal["sample", "previous", "mean"]
"""Which torque belongs to the motion at a sample; see `align_torque`."""


def align_torque(
    torque: Float[np.ndarray, "samples joints"], alignment: TorqueAlignment
) -> Float[np.ndarray, "samples joints"]:
    """Gives every sample of a motion the torque that acted on it (thesis, Section 7.4).

    A drive that holds its demand applies `torque[n]` from sample n to sample n + 1. The
    acceleration jumps at the samples, and what a smoothed record of positions shows there lies
    between the accelerations on either side.

    **Arguments**

    - `torque`: demanded or measured torques, shape `(samples, joints)` [N m or N].
    - `alignment`: `"sample"` takes it as it is: right for torques measured at the instant of the
      sample. `"previous"` takes the demand one sample earlier, which drove the arm into the
      sampled configuration: the thesis's choice. `"mean"` takes the mean of the two intervals
      that meet at the sample: right for a held demand and derivatives that are smoothed
      symmetrically, the only one of the three without a delay of half an interval.

    **Returns**

    The aligned torques, shape `(samples, joints)`. The demand before the first
    sample is unknown; the first sample keeps its torque.

    **Raises**

    - `ValueError`: an alignment that is none of the three.

    >>> import numpy as np
    >>> from jaxcslc.motion import align_torque
    >>> torque = np.array([[1.0], [3.0], [7.0]])
    >>> align_torque(torque, "previous")[:, 0].tolist()
    [1.0, 1.0, 3.0]
    >>> align_torque(torque, "mean")[:, 0].tolist()
    [1.0, 2.0, 5.0]
    """
    previous = np.concatenate([torque[:1], torque[:-1]])
    if alignment == "sample":
        return torque
    if alignment == "previous":
        return previous
    if alignment == "mean":
        return 0.5 * (previous + torque)
    raise ValueError(
        f"torque alignment {alignment!r} is unknown; expected 'sample', 'previous' or 'mean'"
    )
