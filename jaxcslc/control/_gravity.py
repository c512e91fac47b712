import abc
from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..network import CSLC
from ._controller import Joints


# Gravity's columns are compared at this many random poses: a column that vanishes at all of them
# vanishes everywhere.
_POSES = 7
_ZERO = 1e-12


class AbstractPositionTorque(abc.ABC):
    """A torque that depends on joint positions alone, such as gravity or a repulsive potential.

    **Attributes**

    - `array_generic`: whether `torque` computes NumPy results from NumPy arrays; see
      `AbstractController.array_generic`.
    """

    array_generic: ClassVar[bool] = False

    @abc.abstractmethod
    def torque(self, q: Joints) -> Joints:
        """The torque at positions `q`.

        **Arguments**

        - `q`: (*batch, n) [rad or m]; NumPy or JAX arrays.

        **Returns**

        (*batch, n) [N m or N].
        """


class Gravity(eqx.Module, AbstractPositionTorque):
    """Gravity compensation with a network's gravity term G(q) (Eqn. 2.4-7).

    **Attributes**

    - `network`, `k`: (p,) the dynamics.

    >>> import jax.numpy as jnp, jaxcslc as jc
    >>> from jaxcslc.control import Gravity
    >>> network = jc.derive(jc.puma560())
    >>> gravity = Gravity(network, network.coefficients_from(jc.puma560().links))
    >>> gravity.torque(jnp.zeros(6)).shape
    (6,)
    """

    network: CSLC
    k: Float[Array, " coefficients"]

    @classmethod
    def of_joints(
        cls,
        network: CSLC,
        k: Float[Array | np.ndarray, " coefficients"],
        joints: Sequence[int],
    ) -> "Gravity":
        """Gravity compensation of some joints, by the coefficients that act on no other joint.

        For joints 2 and 3 of the PUMA 560 these are all but k₂ᴳ, that of the wrist: the
        abbreviated gravity compensation of the thesis's PID controller (7.4), which the thesis
        does not print. `sim.AbbreviatedGravity` computes the same from link parameters.

        **Arguments**

        - `network`, `k`: (p,) the dynamics.
        - `joints`: counted from 1.

        **Raises**

        - `ValueError`: there is no such joint.

        >>> import jax.numpy as jnp, jaxcslc as jc
        >>> from jaxcslc.control import Gravity
        >>> network = jc.derive(jc.puma560())
        >>> gravity = Gravity.of_joints(network, jnp.ones(43), joints=(2, 3))
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
        acts = np.max(np.abs(columns), axis=0) > _ZERO  # (n, p)
        others = np.delete(acts, [joint - 1 for joint in joints], axis=0)
        mask = acts.any(axis=0) & ~others.any(axis=0)
        k = jnp.asarray(k)
        return cls(network, jnp.where(jnp.asarray(mask), k, jnp.zeros_like(k)))

    def torque(self, q: Joints) -> Joints:
        """G(q), the torque that holds the arm still."""
        return self.network.gravity_term(self.k, q)
