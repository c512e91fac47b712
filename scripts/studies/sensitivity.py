"""Output sensitivity: the mean torque that a unit of each coefficient causes (Section 7.6)."""

import numpy as np
from jaxtyping import Float

from jaxcslc import CSLC, Patterns
from jaxcslc.least_squares import columns_of


def output_sensitivity(network: CSLC, patterns: Patterns) -> Float[np.ndarray, " coefficients"]:
    """Return the mean torque that a unit of each coefficient causes over a recording (Section 7.6).

    The mean modulus, over all joints and all patterns, of the network's torque when one
    coefficient is 1 and all others are 0. Torque is linear in the coefficients, so a
    variation times its sensitivity is its mean effect [N m], whatever the coefficients are.

    A joint that the coefficient does not enter counts into the mean with zero. So does
    Appendix B: its dry friction, which moves one joint of six, has a sensitivity of one sixth.

    **Arguments**

    - `network`: n joints, p coefficients.
    - `patterns`: motion of the training recording. Its masks are not used: a sensitivity is a
      property of the motion, not of the samples that are fitted.

    **Returns** (p,) [N m, or N, per unit of the coefficient].
    """
    mean = np.zeros(network.size)
    for support, columns in zip(network.support, columns_of(network, patterns), strict=True):
        mean[list(support)] += np.mean(np.abs(columns), axis=1)
    return mean / network.joint_count
