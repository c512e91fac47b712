import abc
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..derivation import Coefficient
from ..manipulator import Manipulator
from ._layout import Layout, layout_of
from .terms import AbstractTerm


Numbers = Float[Array | np.ndarray, "... joints"]
Vector = Float[Array | np.ndarray, " coefficients"]


class AbstractTermSum(eqx.Module):
    """Inverse dynamics as a sum of terms, each linear in coefficients of its own.

    Positions, velocities and accelerations are (..., n) with any leading batch axes, in rad (or
    m), per s and per s²; torques are N m (or N). Every method is a pure function that can be
    jitted, vmapped and differentiated, in the precision of its inputs.

    **Attributes**

    - `terms`: the addends; `k` holds their coefficients one after the other.
    - `robot`: whose dynamics they are.
    """

    terms: eqx.AbstractVar[tuple[AbstractTerm, ...]]

    @property
    @abc.abstractmethod
    def robot(self) -> Manipulator: ...

    @property
    def layout(self) -> Layout:
        """Which entries of `k` are which coefficients."""
        return layout_of(self.terms)

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """Names, expressions and units, in the order of `k`."""
        return self.layout.coefficients

    @property
    def names(self) -> tuple[str, ...]:
        """Coefficient names in the order of `k`."""
        return self.layout.names

    @property
    def joint_count(self) -> int:
        """Number of joints, n."""
        return self.robot.joint_count

    @property
    def size(self) -> int:
        """Number of coefficients, p."""
        return self.layout.size

    def torque(self, k: Vector, q: Numbers, qd: Numbers, qdd: Numbers) -> Float[Array, "..."]:
        """Torque of every joint, (..., n) [N m]: the output of the whole network.

        - `k`: (p,); `q`, `qd`, `qdd`: (..., n).

        >>> import jax.numpy as jnp, jaxcslc as jc
        >>> network = jc.derive(jc.puma560())
        >>> k = network.coefficients_from(jc.puma560().links)
        >>> rest = jnp.zeros(6)
        >>> bool(jnp.allclose(network.torque(k, rest, rest, rest), network.gravity_term(k, rest)))
        True
        """
        k, q, qd, qdd = self._checked(k, q, qd, qdd)
        return self._sum(self.terms, k, lambda term, k: term.torque(k, q, qd, qdd), q.shape)

    def regressor(self, q: Numbers, qd: Numbers, qdd: Numbers) -> Float[Array, "..."]:
        """The matrix that `k` is multiplied by: `regressor @ k == torque`, (..., n, p)."""
        _, q, qd, qdd = self._checked(None, q, qd, qdd)
        return jnp.concatenate([term.regressor(q, qd, qdd) for term in self.terms], axis=-1)

    def mass_matrix(self, k: Vector, q: Numbers) -> Float[Array, "..."]:
        """M(q), (..., n, n), motor inertias included (Eqn. 2.5-6) [kg m²]."""
        k, q = self._checked(k, q)
        shape = (*q.shape, self.joint_count)
        return self._sum(self._of("mass"), k, lambda term, k: term.mass_matrix(k, q), shape)

    def velocity_term(self, k: Vector, q: Numbers, qd: Numbers) -> Float[Array, "..."]:
        """V(q, qd): centrifugal and Coriolis torques (Eqn. 2.4-6), (..., n) [N m]."""
        k, q, qd = self._checked(k, q, qd)
        terms = self._of("velocity")
        return self._sum(terms, k, lambda term, k: term.velocity_term(k, q, qd), q.shape)

    def gravity_term(self, k: Vector, q: Numbers) -> Float[Array, "..."]:
        """G(q): the gravity effect vector (Eqn. 2.4-7), (..., n) [N m]."""
        k, q = self._checked(k, q)
        terms = self._of("gravity")
        return self._sum(terms, k, lambda term, k: term.gravity_term(k, q), q.shape)

    def friction_term(self, k: Vector, qd: Numbers) -> Float[Array, "..."]:
        """F(qd): all friction (Eqn. 2.5-3, 2.5-4) and torque offset, (..., n) [N m]."""
        k, qd = self._checked(k, qd)
        still = jnp.zeros_like(qd)
        terms = self._of("friction")
        return self._sum(terms, k, lambda term, k: term.torque(k, still, qd, still), qd.shape)

    def spring_term(self, k: Vector, q: Numbers) -> Float[Array, "..."]:
        """S(q): torques of joint springs, stiffness times position, (..., n) [N m]."""
        k, q = self._checked(k, q)
        still = jnp.zeros_like(q)
        terms = self._of("spring")
        return self._sum(terms, k, lambda term, k: term.torque(k, q, still, still), q.shape)

    def forward_dynamics(
        self, k: Vector, q: Numbers, qd: Numbers, tau: Numbers
    ) -> Float[Array, "..."]:
        """Accelerations that torques `tau` (..., n) produce, (..., n) [rad/s²].

        Solves M qdd = tau - V - G - F - S. Not finite where M is singular, which it is for no
        possible mass distribution.
        """
        k, q, qd, tau = self._checked(k, q, qd, tau)
        bias = self.torque(k, q, qd, jnp.zeros_like(q))
        mass = self.mass_matrix(k, q)
        return jnp.linalg.solve(mass, (tau - bias)[..., None])[..., 0]

    def without_friction(self, k: Vector) -> Float[Array, " coefficients"]:
        """The coefficients of the same robot without friction: those of friction set to zero.

        Springs and the inertia that coupled joints share stay.

        >>> import jax.numpy as jnp, jaxcslc as jc
        >>> network = jc.derive(jc.puma560())
        >>> float(network.without_friction(jnp.ones(43)).sum())  # 6 viscous and 6 dry less
        31.0
        """
        mask = np.ones(self.size)
        mask[self.layout.friction] = 0.0
        k = jnp.asarray(k)
        return k * jnp.asarray(mask, k.dtype)

    @property
    def support(self) -> tuple[tuple[int, ...], ...]:
        """For each joint, the coefficients that its torque can depend on, in ascending order."""
        indices = self.layout.split(np.arange(self.size))
        return tuple(
            tuple(
                int(of_term[index])
                for of_term, term in zip(indices, self.terms, strict=True)
                for index in term.support[joint]
            )
            for joint in range(self.joint_count)
        )

    def columns(
        self,
        q: Float[Array, "joints samples"],
        qd: Float[Array, "joints samples"],
        qdd: Float[Array, "joints samples"],
    ) -> tuple[Float[Array, "_ samples"], ...]:
        """The regressor without what is always zero: for each joint, (its support, samples).

        Joints first and samples last, unlike `regressor`: the layout to factorise many patterns
        in (a PUMA 560 has 100 such rows where the regressor has 6 x 43).
        """
        columns = [term.columns(q, qd, qdd) for term in self.terms]
        return tuple(jnp.concatenate(rows) for rows in zip(*columns, strict=True))

    def _of(self, part: str) -> tuple[AbstractTerm, ...]:
        """The terms that belong to a sum of the equation of motion."""
        return tuple(term for term in self.terms if part in term.parts)

    def _sum(
        self,
        terms: Sequence[AbstractTerm],
        k: Array,
        share: Callable[[Any, Array], Array],
        shape: tuple[int, ...],
    ) -> Array:
        """The shares of terms, each of its own coefficients; zeros if there are none."""
        layout = self.layout
        shares = [share(term, k[layout.of(term)]) for term in terms]
        return sum(shares[1:], shares[0]) if shares else jnp.zeros(shape, k.dtype)

    def _checked(self, k: Any, *motion: Any) -> tuple[Array, ...]:
        """Arrays of the right sizes, integers made floats; sizes are static, so errors are."""
        arrays = [jnp.asarray(x) for x in motion]
        for array in arrays:
            if array.ndim == 0 or array.shape[-1] != self.joint_count:
                raise ValueError(
                    f"expected arrays of shape (..., {self.joint_count}) for"
                    f" {self.robot.name!r}, got {array.shape}"
                )
        dtype = jnp.result_type(float, *arrays) if not arrays else jnp.result_type(*arrays)
        if not jnp.issubdtype(dtype, jnp.floating):
            dtype = jnp.result_type(float)
        coefficients = jnp.zeros(0, dtype) if k is None else jnp.asarray(k)
        if k is not None and coefficients.shape != (self.size,):
            raise ValueError(f"k: expected shape ({self.size},), got {coefficients.shape}")
        shape = jnp.broadcast_shapes(*(array.shape for array in arrays))
        return (
            coefficients.astype(dtype),
            *(jnp.broadcast_to(array.astype(dtype), shape) for array in arrays),
        )
