from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..network import CSLC
from ._reference import Joints


# Where gravity's columns are looked at; what vanishes at so many poses vanishes everywhere.
_POSES = 7
_NOTHING = 1e-12


class Gravity(eqx.Module):
    """Compensation of gravity alone: G(q) of a network (Eqn. 2.4-7).

    >>> import jax.numpy as jnp, jaxcslc as jc
    >>> from jaxcslc.control import Gravity
    >>> network = jc.derive(jc.puma560())
    >>> gravity = Gravity(network, network.coefficients_from(jc.puma560().links))
    >>> gravity.torque(jnp.zeros(6)).shape
    (6,)
    """

    network: CSLC
    k: Float[Array, " coefficients"]

    def torque(self, q: Joints) -> Float[Array, "*batch joints"]:
        """What holds the arm still at `q`, (*batch, n) [N m or N]."""
        return self.network.gravity_term(self.k, q)


def abbreviated_gravity(
    network: CSLC, k: Float[Array | np.ndarray, " coefficients"], joints: Sequence[int]
) -> Gravity:
    """Gravity compensated at some joints, by the coefficients that act on no others.

    For joints 2 and 3 of the PUMA 560 these are all but k₂ᴳ, the wrist's: what the thesis calls
    the abbreviated gravity compensation of its PID controller (7.4) and does not print.

    **Arguments**

    - `network`, `k`: the dynamics.
    - `joints`: counted from 1.

    **Raises**

    - `ValueError`: there is no such joint.

    >>> import jax.numpy as jnp, jaxcslc as jc
    >>> from jaxcslc.control import abbreviated_gravity
    >>> network = jc.derive(jc.puma560())
    >>> gravity = abbreviated_gravity(network, jnp.ones(43), joints=(2, 3))
    >>> [name for name, value in zip(network.names, gravity.k) if value]
    ['kG1', 'kG3', 'kG4', 'kG5']
    """
    n = network.joint_count
    for joint in joints:
        if not 1 <= joint <= n:
            raise ValueError(f"joints: there is no joint {joint}; expected 1 to {n}")
    poses = np.random.default_rng(0).uniform(-np.pi, np.pi, (_POSES, n))
    with jax.ensure_compile_time_eval():  # also where `k` is traced
        columns = np.asarray(
            jax.jacobian(lambda k: network.gravity_term(k, poses))(jnp.zeros(network.size))
        )
    acts = np.max(np.abs(columns), axis=0) > _NOTHING  # (n, p)
    others = np.delete(acts, [joint - 1 for joint in joints], axis=0)
    kept = acts.any(axis=0) & ~others.any(axis=0)
    k = jnp.asarray(k)
    return Gravity(network, jnp.where(jnp.asarray(kept), k, jnp.zeros_like(k)))
