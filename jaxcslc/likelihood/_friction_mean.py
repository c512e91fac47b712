"""Friction averaged over the two intervals of an equation."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..network import JAX_FUNCTIONS, JointLaw


Rows = Float[Array, "equations joints"]
# Gauss-Legendre nodes on (0, 1): exact for a triangle times a parabola.
NODES = (np.polynomial.legendre.leggauss(2)[0] + 1) / 2
# Speed that stands in for one of the wrong sign, next to a reversal [rad/s or m/s].
SLOWEST = 1e-9


def mean_inputs(
    law: JointLaw,
    q: Rows,
    velocity: Rows,
    change_before: Rows,
    change_after: Rows,
    share: Rows,
    turn: Rows,
    direction: Rows,
) -> tuple[Rows, ...]:
    """Return a joint law's inputs, averaged as the acceleration of a second difference is.

    The second difference of positions is the acceleration averaged with a triangle over the two
    intervals that meet at a sample. Friction in the same equation is averaged alike: without that,
    an equation next to a reversal is wrong by up to twice the dry friction. Velocity is linear in
    each interval; its sign is that of `direction` from `turn` on and the other one before, so
    that the average is smooth in all motion. Which sign holds is decided elsewhere (`Signs`).

    **Arguments**

    - `law`: array fields (n,).
    - `q`, `velocity`: at the sample, (equations, n).
    - `change_before`, `change_after`: of velocity over the interval before the sample and over
      the one after it, (equations, n) each.
    - `share`: of the interval before in both, a half at even sampling.
    - `turn`: when the joint turns, -1 at the previous sample to 1 at the next one; -1 for joints
      that move one way.
    - `direction`: 1 or -1, the sign of velocity after `turn`.

    **Returns**

    (equations, n) for each of the law's symbols.
    """
    one = jnp.ones_like(turn)
    first, second = jnp.minimum(turn, 0.0), jnp.maximum(turn, 0.0)
    start, end = jnp.stack([-one, first, second]), jnp.stack([first, second, one])
    sign = jnp.stack([-one, jnp.where(turn > 0.0, -1.0, 1.0), one]) * direction[None]
    nodes = jnp.asarray(NODES)[:, None, None, None]
    x = start[None] + (end - start)[None] * nodes  # (nodes, parts, equations, n)
    shape = x.shape

    def spread(values: Array) -> Array:
        return jnp.broadcast_to(values, shape)

    earlier = x < 0.0
    change = jnp.where(earlier, spread(change_before), spread(change_after))
    mass = spread(end - start) * (1.0 - jnp.abs(x))
    mass = mass * jnp.where(earlier, spread(share), spread(1.0 - share))
    sign = spread(sign)
    qd = sign * jnp.maximum(sign * (spread(velocity) + x * change), SLOWEST)
    law = jax.tree.map(lambda values: spread(jnp.asarray(values)), law)
    inputs = law.inputs(JAX_FUNCTIONS, spread(q), qd)
    return tuple(jnp.sum(mass * spread(values), axis=(0, 1)) for values in inputs)
