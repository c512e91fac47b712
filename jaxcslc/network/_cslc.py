import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..derivation import Algebra, Coefficient, derive_algebra
from ..manipulator import LinkParameters, Manipulator
from ._coefficient_values import check_keywords, expression_values, inertial_values, input_values
from ._counts import input_counts, order_per_joint, payload_counts, rigid_body_counts
from ._layout import Layout, layout_of
from .terms import (
    AbstractInputTerm,
    AbstractTerm,
    JointTerm,
    RigidBodyRecursion,
    RigidBodyTables,
    StaticFriction,
    carrier,
    payload_term,
)


Numbers = Float[Array | np.ndarray, "... joints"]
# One number a joint, two for either direction, or three a pair of coupled joints.
FrictionValues = Sequence[float] | Sequence[Sequence[float]] | Float[Array | np.ndarray, "..."]
Vector = Float[Array | np.ndarray, " coefficients"]
_NOTHING = LinkParameters(0.0, np.zeros(3), np.zeros((3, 3)))


class CSLC(eqx.Module):
    """A Context-Sensitive Linear Combiner: the inverse dynamics of one robot, linear in `k`.

        M(q) qdd + V(q, qd) + G(q) + F(qd) = torque        (Eqn. 2.5-2)

    and joint springs' torque S(q), where the robot has them. A network is a sum of `terms`, each
    with coefficients of its own; `k` holds them one after the other, and `layout` says where.
    Positions, velocities and accelerations are (..., n) with any leading batch axes, in rad (or
    m), per s and per s²; torques are N m (or N). Every method is a pure function that can be
    jitted, vmapped and differentiated, in the precision of its inputs.

    Built by `derive`.

    **Attributes**

    - `algebra`: the exact derivation: tables of inputs and links.
    - `terms`: the rigid body, then friction, springs and coupled joints, then a payload.
    """

    algebra: Algebra = eqx.field(static=True)
    terms: tuple[AbstractTerm, ...]

    @property
    def layout(self) -> Layout:
        """Which entries of `k` are which coefficients."""
        return layout_of(self.terms)

    @property
    def robot(self) -> Manipulator:
        """What it was derived from."""
        return self.algebra.robot

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
        return self.robot.joint_count

    @property
    def size(self) -> int:
        """Number of coefficients, p."""
        return self.layout.size

    @property
    def rigid_body(self) -> RigidBodyTables | RigidBodyRecursion:
        """The term of the links and motors."""
        rigid = self.terms[0]
        assert isinstance(rigid, RigidBodyTables | RigidBodyRecursion)
        return rigid

    @property
    def input_terms(self) -> tuple[AbstractInputTerm, ...]:
        """Friction, torque offsets, springs and coupled joints."""
        return tuple(term for term in self.terms if isinstance(term, AbstractInputTerm))

    @property
    def payload(self) -> RigidBodyRecursion | None:
        """The term of the payload, or None. See `with_payload`."""
        last = self.terms[-1]
        return last if isinstance(last, RigidBodyRecursion) and last.kind == "payload" else None

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

    def coefficients_from(
        self,
        links: Sequence[LinkParameters],
        *,
        payload: LinkParameters | None = None,
        **friction: FrictionValues | None,
    ) -> Float[Array, " coefficients"]:
        """The vector `k` of a robot whose physical parameters are known, (p,).

        **Arguments**

        - `links`: one `LinkParameters` a joint; lengths and gravity are those of `robot`.
        - `payload`: in the frame of the link that carries it; none if omitted.
        - `friction`: by the kind of the term, zero if omitted. `viscous`, `dry`, `offset`,
          `static`, `root`, `spring`: (n,), zero for joints without the term;
          `asymmetric_viscous`, `asymmetric_dry`: (n, 2), forwards and backwards; `coupled`:
          (pairs, 3), shared inertia, viscous and dry friction of coupled joints.

        **Raises**

        - `ValueError`: if the number of links or friction values is not that of the joints, or
          if the network, or one of its joints, lacks a term or a payload that has values.

        >>> import jaxcslc as jc
        >>> robot = jc.puma560().with_gravity((0, 0, -9.814))
        >>> network = jc.derive(robot)
        >>> k = network.coefficients_from(robot.links, viscous=robot.viscous, dry=robot.dry)
        >>> round(float(k[network.names.index("kM25")]), 3)  # Appendix B prints 6.792
        6.792
        """
        parts = [inertial_values(self.algebra, links)]
        check_keywords(self.input_terms, friction)
        parts += [input_values(term, friction) for term in self.input_terms]
        if self.payload is None and payload is not None:
            raise ValueError("payload: the network has none; expected one `with_payload()`")
        if self.payload is not None:
            bodies = [payload or _NOTHING] * len(links)
            parts.append(expression_values(self.payload.coefficients, bodies, {}))
        return jnp.concatenate([jnp.asarray(part, parts[0].dtype) for part in parts])

    @property
    def static_slopes(self) -> Float[Array | np.ndarray, "..."] | None:
        """(n,) of each joint's static friction [s/rad or s/m]; None without static friction."""
        law = self._static_friction
        return None if law is None else law.slopes

    def with_static_slopes(
        self, slopes: Sequence[float] | Float[Array | np.ndarray, " joints"]
    ) -> "CSLC":
        """The same network with other slopes of static friction, (n,) [s/rad or s/m].

        Those of joints without static friction are not used. Slopes are a leaf of the network: a
        compiled function that takes the slopes, or the network, as an argument can be called
        with others, vmapped over them and differentiated by them.

        **Raises** `ValueError` for a network without static friction, for a wrong number of
        slopes, and for numbers not above 0.

        >>> import jax, jax.numpy as jnp, jaxcslc as jc
        >>> robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
        >>> network = jc.derive(robot.with_friction("viscous", "dry", "static"))
        >>> k, qd = jnp.ones(network.size), jnp.array([0.5])
        >>> friction = lambda s: network.with_static_slopes(s).friction_term(k, qd)[0]
        >>> round(float(jax.grad(friction)(jnp.array([2.0]))[0]), 4)  # -0.5 exp(-2 * 0.5)
        -0.1839
        """
        if self._static_friction is None:
            raise ValueError(f"static slopes: {self.robot.name!r} has no static friction")
        law = self._static_friction.with_slopes(slopes)
        terms = tuple(
            dataclasses.replace(term, law=law)
            if isinstance(term, JointTerm) and term.kind == law.kind
            else term
            for term in self.terms
        )
        return CSLC(self.algebra, terms)

    @property
    def _static_friction(self) -> StaticFriction | None:
        laws = (term.law for term in self.terms if isinstance(term, JointTerm))
        return next((law for law in laws if isinstance(law, StaticFriction)), None)

    def with_payload(self, link: int | None = None) -> "CSLC":
        """The same network with a payload: a body rigidly attached to a link (thesis 8.2.4).

        Its ten inertial parameters are the last coefficients of `k`, in group `"payload"`: the
        inertia tensor about the origin of the carrying link's frame, the first moments and the
        mass, pIxx pIyy pIzz pIxy pIxz pIyz phx phy phz pm. Zeros are no payload. A recording of
        the loaded arm alone cannot tell payload and link apart: know the arm's own coefficients
        before, or fit an unloaded recording beside it.

        **Arguments**

        - `link`: which one carries, counted from 1; the last one if omitted.

        **Raises**

        - `RobotError`: there is no such link.
        - `ValueError`: the network has a payload already.

        >>> import jax.numpy as jnp, numpy as np, jaxcslc as jc
        >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
        >>> network = jc.derive(arm, lengths="numeric").with_payload()
        >>> ball = jc.LinkParameters(2.0, np.array([0.5, 0.0, 0.0]), np.zeros((3, 3)))
        >>> nothing = jc.LinkParameters(0.0, np.zeros(3), np.zeros((3, 3)))
        >>> k = network.coefficients_from([nothing], payload=ball)
        >>> rest = jnp.zeros(1)
        >>> bool(jnp.allclose(network.torque(k, rest, rest, rest), 2.0 * 9.81 * 0.5))
        True
        """
        if self.payload is not None:
            raise ValueError(f"{self.robot.name!r} has a payload already")
        return CSLC(self.algebra, (*self.terms, payload_term(carrier(self.robot, link))))

    @property
    def carrying_link(self) -> int | None:
        """The link that carries the payload, counted from 1; None without one."""
        if self.payload is None:
            return None
        return self.payload.coefficients[-1].addends[0].term.link + 1

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
                int(own[index])
                for own, term in zip(indices, self.terms, strict=True)
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

    @property
    def counts(self) -> dict[str, dict[str, int]]:
        """Size of each subnetwork: inputs, links and coefficients (thesis 5.1, Appendix B).

        Derives the closed-form tables if the network did not need them until now.
        """
        counts = rigid_body_counts(self.algebra)
        counts |= {term.kind: input_counts(term) for term in self.input_terms}
        for algebra in self._payload_algebra:
            counts["payload"] = payload_counts(algebra)
        return counts

    @property
    def order_per_joint(self) -> tuple[int, ...]:
        """How many coefficients each joint's torque depends on, friction included (5.2.5).

        Of a payload's ten, as many as the joint's torque can tell apart.
        """
        return order_per_joint((self.algebra, *self._payload_algebra), self.input_terms)

    @property
    def _payload_algebra(self) -> tuple[Algebra, ...]:
        """The closed form of the payload's torque in base parameters; empty without one."""
        link = self.carrying_link
        return () if link is None else (derive_algebra(carrier(self.robot, link), "numeric"),)

    @property
    def order(self) -> int:
        """Network order (4.2): independent patterns needed, at the least, to determine `k`."""
        return max(self.order_per_joint)

    def __repr__(self) -> str:
        groups = [coefficient.group for coefficient in self.coefficients]
        sizes = ", ".join(f"{groups.count(group)} {group}" for group in self.layout.groups)
        return (
            f"CSLC({self.robot.name}: {self.joint_count} joints, {self.size} coefficients:"
            f" {sizes}; {type(self.rigid_body).__name__})"
        )

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
