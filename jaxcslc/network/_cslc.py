from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..derivation import Algebra, Coefficient, constant_values
from ..manipulator import LinkParameters, Manipulator
from ._evaluator import AbstractEvaluator
from ._friction import friction_inputs, friction_regressor
from ._link_values import coefficient_values
from ._order import order_per_joint


Numbers = Float[Array | np.ndarray, "... joints"]
PerJoint = Sequence[float] | Float[Array | np.ndarray, " joints"]
Vector = Float[Array | np.ndarray, " coefficients"]


class CSLC(eqx.Module):
    """A Context-Sensitive Linear Combiner: the inverse dynamics of one robot, linear in `k`.

        M(q) qdd + V(q, qd) + G(q) + F(qd) = torque        (Eqn. 2.5-2)

    The vector `k` holds the inertial coefficients, then one coefficient a joint for each
    friction term, as `coefficients` lists them. Positions, velocities and accelerations are
    (..., n) with any leading batch axes, in rad (or m), per s and per s²; torques are N m (or
    N). Every method is a pure function that can be jitted, vmapped and differentiated, in the
    precision of its inputs.

    Built by `derive`.

    **Attributes**

    - `coefficients`: names, expressions and units, in the order of `k`.
    - `algebra`: the exact derivation: tables of inputs and links.
    - `evaluator`: how the rigid-body part is computed.
    """

    coefficients: tuple[Coefficient, ...] = eqx.field(static=True)
    algebra: Algebra = eqx.field(static=True)
    evaluator: AbstractEvaluator

    @property
    def robot(self) -> Manipulator:
        """What it was derived from."""
        return self.algebra.robot

    @property
    def names(self) -> tuple[str, ...]:
        """Coefficient names in the order of `k`."""
        return tuple(coefficient.name for coefficient in self.coefficients)

    @property
    def joint_count(self) -> int:
        return self.robot.joint_count

    @property
    def size(self) -> int:
        """Number of coefficients, p."""
        return len(self.coefficients)

    @property
    def _inertial(self) -> int:
        return len(self.algebra.coefficients)

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
        rigid = self.evaluator.torque(k[: self._inertial], q, qd, qdd)
        return rigid + self._friction(k, qd)

    def regressor(self, q: Numbers, qd: Numbers, qdd: Numbers) -> Float[Array, "..."]:
        """The matrix that `k` is multiplied by: `regressor @ k == torque`, (..., n, p)."""
        _, q, qd, qdd = self._checked(None, q, qd, qdd)
        parts = [self.evaluator.regressor(q, qd, qdd)]
        if self.robot.friction:
            parts.append(friction_regressor(self.robot.friction, qd))
        return jnp.concatenate(parts, axis=-1)

    def mass_matrix(self, k: Vector, q: Numbers) -> Float[Array, "..."]:
        """M(q), (..., n, n), motor inertias included (Eqn. 2.5-6) [kg m²]."""
        k, q = self._checked(k, q)
        return self.evaluator.mass_matrix(k[: self._inertial], q)

    def velocity_term(self, k: Vector, q: Numbers, qd: Numbers) -> Float[Array, "..."]:
        """V(q, qd): centrifugal and Coriolis torques (Eqn. 2.4-6), (..., n) [N m]."""
        k, q, qd = self._checked(k, q, qd)
        return self.evaluator.velocity_term(k[: self._inertial], q, qd)

    def gravity_term(self, k: Vector, q: Numbers) -> Float[Array, "..."]:
        """G(q): the gravity effect vector (Eqn. 2.4-7), (..., n) [N m]."""
        k, q = self._checked(k, q)
        return self.evaluator.gravity_term(k[: self._inertial], q)

    def friction_term(self, k: Vector, qd: Numbers) -> Float[Array, "..."]:
        """F(qd): viscous and dry friction (Eqn. 2.5-3) and torque offset, (..., n) [N m]."""
        k, qd = self._checked(k, qd)
        return self._friction(k, qd)

    def forward_dynamics(
        self, k: Vector, q: Numbers, qd: Numbers, tau: Numbers
    ) -> Float[Array, "..."]:
        """Accelerations that torques `tau` (..., n) produce, (..., n) [rad/s²].

        Solves M qdd = tau - V - G - F. Not finite where M is singular, which it is for no
        possible mass distribution.
        """
        k, q, qd, tau = self._checked(k, q, qd, tau)
        bias = self.torque(k, q, qd, jnp.zeros_like(q))
        mass = self.evaluator.mass_matrix(k[: self._inertial], q)
        return jnp.linalg.solve(mass, (tau - bias)[..., None])[..., 0]

    def coefficients_from(
        self,
        links: Sequence[LinkParameters],
        *,
        viscous: PerJoint | None = None,
        dry: PerJoint | None = None,
        offset: PerJoint | None = None,
    ) -> Float[Array, " coefficients"]:
        """The vector `k` of a robot whose physical parameters are known, (p,).

        **Arguments**

        - `links`: one `LinkParameters` a joint; lengths and gravity are those of `robot`.
        - `viscous`, `dry`, `offset`: (n,) friction coefficients; zero if omitted.

        **Raises**

        - `ValueError`: if the number of links or friction values is not that of the joints, or
          a friction term is given that the network does not have.

        >>> import jaxcslc as jc
        >>> robot = jc.puma560().with_gravity((0, 0, -9.814))
        >>> network = jc.derive(robot)
        >>> k = network.coefficients_from(robot.links, viscous=robot.viscous, dry=robot.dry)
        >>> round(float(k[network.names.index("kM25")]), 3)  # Appendix B prints 6.792
        6.792
        """
        n = self.joint_count
        if len(links) != n:
            raise ValueError(f"links: expected {n} entries, one a joint, got {len(links)}")
        given = {"viscous": viscous, "dry": dry, "offset": offset}
        parts = [
            coefficient_values(self.algebra.coefficients, links, constant_values(self.robot))
            if self.algebra.lengths == "symbolic"
            else coefficient_values(self.algebra.coefficients, links, {})
        ]
        for term, value in given.items():
            if value is not None and term not in self.robot.friction:
                raise ValueError(
                    f"{term}: the network has no such friction term; it has"
                    f" {', '.join(self.robot.friction) or 'none'}"
                )
        for term in self.robot.friction:
            value = jnp.zeros(n) if given[term] is None else jnp.asarray(given[term])
            if value.shape != (n,):
                raise ValueError(f"{term}: expected {n} values, one a joint, got {value.shape}")
            parts.append(value.astype(parts[0].dtype))
        return jnp.concatenate(parts)

    def friction_inputs(self, qd: Numbers) -> list[Float[Array, "..."]]:
        """What each friction term's coefficients multiply, (..., n) each, in `robot.friction`'s
        order: qd, sgn(qd), 1 (Eqn. 2.5-3)."""
        (qd,) = self._checked(None, qd)[1:]
        return friction_inputs(self.robot.friction, qd)

    @property
    def support(self) -> tuple[tuple[int, ...], ...]:
        """For each joint, the coefficients that its torque can depend on, in ascending order."""
        n, start, terms = self.joint_count, self._inertial, len(self.robot.friction)
        return tuple(
            (*inertial, *(start + term * n + joint for term in range(terms)))
            for joint, inertial in enumerate(self.evaluator.support)
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
        inputs = friction_inputs(self.robot.friction, qd)
        return tuple(
            jnp.concatenate([rows, *(values[joint][None] for values in inputs)])
            for joint, rows in enumerate(self.evaluator.columns(q, qd, qdd))
        )

    @property
    def counts(self) -> dict[str, dict[str, int]]:
        """Size of each subnetwork: inputs, links and coefficients (thesis 5.1, Appendix B).

        Derives the closed-form tables if the network did not need them until now.
        """
        counts: dict[str, dict[str, int]] = {}
        for name in ("mass", "velocity", "gravity"):
            table = getattr(self.algebra, name)
            counts[name] = {
                "inputs": len(table.inputs),
                "links": len(table.links),
                "nodes": len(table.columns),
                "coefficients": len(table.coefficients),
            }
        for term in self.robot.friction:
            n = self.joint_count
            counts[term] = {"inputs": n, "links": n, "nodes": n, "coefficients": n}
        return counts

    @property
    def order_per_joint(self) -> tuple[int, ...]:
        """How many coefficients each joint's torque depends on, friction included (5.2.5)."""
        return order_per_joint(self.algebra, self.robot)

    @property
    def order(self) -> int:
        """Network order (4.2): independent patterns needed, at the least, to determine `k`."""
        return max(self.order_per_joint)

    def __repr__(self) -> str:
        groups: dict[str, int] = {}
        for coefficient in self.coefficients:
            groups[coefficient.group] = groups.get(coefficient.group, 0) + 1
        sizes = ", ".join(f"{count} {group}" for group, count in groups.items())
        return (
            f"CSLC({self.robot.name}: {self.joint_count} joints, {self.size} coefficients:"
            f" {sizes}; {type(self.evaluator).__name__})"
        )

    def _friction(self, k: Array, qd: Array) -> Array:
        n, start = self.joint_count, self._inertial
        total = jnp.zeros_like(qd)
        for i, inputs in enumerate(friction_inputs(self.robot.friction, qd)):
            weights = k[start + i * n : start + (i + 1) * n]
            total = total + jnp.broadcast_to(weights, qd.shape) * inputs
        return total

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
