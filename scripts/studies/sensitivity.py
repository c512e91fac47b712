"""Output sensitivity: the mean torque that a unit of each coefficient causes (Section 7.6)."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxcslc import CSLC, Patterns
from jaxcslc.least_squares import filled_up


def output_sensitivity(network: CSLC, patterns: Patterns) -> Float[Array, " coefficients"]:
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
    q, qd, qdd = (filled_up(x).T for x in (patterns.q, patterns.qd, patterns.qdd))
    # Padding rows are at rest, where gravity acts too: their weight is zero.
    weight = filled_up(np.ones((patterns.samples, 1)))[:, 0]
    return _mean_modulus(network, q, qd, qdd, weight)


@eqx.filter_jit
def _mean_modulus(network: CSLC, q: Array, qd: Array, qdd: Array, weight: Array) -> Array:
    total = jnp.zeros(network.size, q.dtype)
    for support, rows in zip(network.support, network.columns(q, qd, qdd), strict=True):
        total = total.at[np.array(support, dtype=int)].add(jnp.abs(rows) @ weight)
    return total / (network.joint_count * jnp.sum(weight))
