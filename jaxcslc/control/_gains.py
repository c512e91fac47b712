from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float


PerJoint = float | Sequence[float] | Float[Array | np.ndarray, " joints"]


def error_gains(
    natural_frequency: PerJoint, damping: PerJoint
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Gains that make each joint's error a linear oscillator: K_p = ω_n², K_v = 2 ζ ω_n.

    The two formulas after Eqn. 2.7-1 (numbered 2.6-2 in print), from Leahy and Saridis (1989): a
    perfectly compensated arm then has e'' + K_v e' + K_p e = 0 at every joint.

    **Arguments**

    - `natural_frequency`: ω_n [rad/s].
    - `damping`: ζ, 1 for the quickest decay without overshoot.

    **Returns** K_p [1/s²] and K_v [1/s].

    >>> from jaxcslc.control import error_gains
    >>> [float(gain) for gain in error_gains(20.0, 1.0)]
    [400.0, 40.0]
    """
    frequency, ratio = jnp.asarray(natural_frequency, float), jnp.asarray(damping, float)
    return frequency**2, 2.0 * ratio * frequency


def per_joint(name: str, values: PerJoint, joints: int, least: float) -> Float[Array, " joints"]:
    """One number a joint from one for all or one each.

    **Raises** `ValueError` by name, for a wrong number of them or one below `least`. Traced values
    are taken as they come.
    """
    numbers = jnp.asarray(values, float)
    if numbers.ndim > 1 or numbers.shape not in ((), (joints,)):
        raise ValueError(f"{name}: expected one number or {joints}, got shape {numbers.shape}")
    numbers = jnp.broadcast_to(numbers, (joints,))
    if isinstance(numbers, Tracer):
        return numbers
    wrong = np.flatnonzero(~(np.asarray(numbers) >= least))
    if wrong.size:
        value = float(np.asarray(numbers)[wrong[0]])
        raise ValueError(f"{name} of joint {wrong[0] + 1} is {value}; expected {least:g} or more")
    return numbers
