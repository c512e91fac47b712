import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..derivation import Algebra, Coefficient, derive_algebra
from ..manipulator import LinkParameters, Manipulator
from ._known import known_coefficients
from ._order import order_per_joint
from .terms import (
    AbstractEvaluator,
    FrictionTerm,
    RecursiveEvaluator,
    carrier,
    coefficient_values,
    coupling_matrix,
    friction_inputs,
    friction_regressor,
    friction_rows,
    friction_terms,
    friction_torque,
    payload_coefficients,
    payload_evaluator,
)


Numbers = Float[Array | np.ndarray, "... joints"]
PerJoint = Sequence[float] | Float[Array | np.ndarray, " joints"]
PerDirection = Sequence[Sequence[float]] | Float[Array | np.ndarray, "joints 2"]
PerPair = Sequence[Sequence[float]] | Float[Array | np.ndarray, "pairs 3"]
# Terms that are part of the inertia or of where the joints are, not of how fast they move.
_NOT_FRICTION = ("coupled_inertia", "spring")
Vector = Float[Array | np.ndarray, " coefficients"]


class CSLC(eqx.Module):
    """A Context-Sensitive Linear Combiner: the inverse dynamics of one robot, linear in `k`.

        M(q) qdd + V(q, qd) + G(q) + F(qd) = torque        (Eqn. 2.5-2)

    and joint springs' torque S(q), where the robot has them. The vector `k` holds the inertial
    coefficients, then one coefficient a joint for each friction term (two for an asymmetric
    one), then three for each coupled pair of joints, then ten of a payload if it has one
    (`with_payload`), as `coefficients` lists them. Positions,
    velocities and accelerations are (..., n) with any leading batch axes, in rad (or m), per s
    and per s²; torques are N m (or N). Every method is a pure function that can be jitted,
    vmapped and differentiated, in the precision of its inputs.

    Built by `derive`.

    **Attributes**

    - `coefficients`: names, expressions and units, in the order of `k`.
    - `algebra`: the exact derivation: tables of inputs and links.
    - `evaluator`: how the rigid-body part is computed.
    - `static_slopes`: of each joint's static friction [s/rad or s/m], the one thing that torque
      is not linear in; None without static friction. See `with_static_slopes`.
    - `payload`: how the torque of a payload is computed; None without one. See `with_payload`.
    """

    coefficients: tuple[Coefficient, ...] = eqx.field(static=True)
    algebra: Algebra = eqx.field(static=True)
    evaluator: AbstractEvaluator
    static_slopes: tuple[Any, ...] | Float[Array, "..."] | None = None
    payload: RecursiveEvaluator | None = None

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

    @property
    def _own(self) -> int:
        """Number of coefficients without the payload's."""
        return self.size - (0 if self.payload is None else self.payload.size)

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
        total = self.evaluator.torque(k[: self._inertial], q, qd, qdd)
        if self.payload is not None:
            total = total + self.payload.torque(k[self._own :], q, qd, qdd)
        return total + self._terms_torque(k, q, qd, qdd) if self.terms else total

    def regressor(self, q: Numbers, qd: Numbers, qdd: Numbers) -> Float[Array, "..."]:
        """The matrix that `k` is multiplied by: `regressor @ k == torque`, (..., n, p)."""
        _, q, qd, qdd = self._checked(None, q, qd, qdd)
        parts = [self.evaluator.regressor(q, qd, qdd)]
        if self.terms:
            inputs = self._inputs(self.terms, *(_by_joint(x) for x in (q, qd, qdd)))
            parts.append(friction_regressor(self.terms, inputs, q[..., 0] * 0, self.joint_count))
        if self.payload is not None:
            parts.append(self.payload.regressor(q, qd, qdd))
        return jnp.concatenate(parts, axis=-1)

    def mass_matrix(self, k: Vector, q: Numbers) -> Float[Array, "..."]:
        """M(q), (..., n, n), motor inertias included (Eqn. 2.5-6) [kg m²]."""
        k, q = self._checked(k, q)
        return self._mass(k, q)

    def velocity_term(self, k: Vector, q: Numbers, qd: Numbers) -> Float[Array, "..."]:
        """V(q, qd): centrifugal and Coriolis torques (Eqn. 2.4-6), (..., n) [N m]."""
        k, q, qd = self._checked(k, q, qd)
        own = self.evaluator.velocity_term(k[: self._inertial], q, qd)
        if self.payload is None:
            return own
        return own + self.payload.velocity_term(k[self._own :], q, qd)

    def gravity_term(self, k: Vector, q: Numbers) -> Float[Array, "..."]:
        """G(q): the gravity effect vector (Eqn. 2.4-7), (..., n) [N m]."""
        k, q = self._checked(k, q)
        own = self.evaluator.gravity_term(k[: self._inertial], q)
        if self.payload is None:
            return own
        return own + self.payload.gravity_term(k[self._own :], q)

    def friction_term(self, k: Vector, qd: Numbers) -> Float[Array, "..."]:
        """F(qd): all friction (Eqn. 2.5-3, 2.5-4) and torque offset, (..., n) [N m]."""
        k, qd = self._checked(k, qd)
        words = [term.word for term in self.terms if term.word not in _NOT_FRICTION]
        return self._terms_torque(k, qd, qd, qd, words)

    def spring_term(self, k: Vector, q: Numbers) -> Float[Array, "..."]:
        """S(q): torques of joint springs, stiffness times position, (..., n) [N m]."""
        k, q = self._checked(k, q)
        return self._terms_torque(k, q, q, q, ["spring"])

    def forward_dynamics(
        self, k: Vector, q: Numbers, qd: Numbers, tau: Numbers
    ) -> Float[Array, "..."]:
        """Accelerations that torques `tau` (..., n) produce, (..., n) [rad/s²].

        Solves M qdd = tau - V - G - F - S. Not finite where M is singular, which it is for no
        possible mass distribution.
        """
        k, q, qd, tau = self._checked(k, q, qd, tau)
        bias = self.torque(k, q, qd, jnp.zeros_like(q))
        mass = self._mass(k, q)
        return jnp.linalg.solve(mass, (tau - bias)[..., None])[..., 0]

    def coefficients_from(
        self,
        links: Sequence[LinkParameters],
        *,
        viscous: PerJoint | None = None,
        dry: PerJoint | None = None,
        offset: PerJoint | None = None,
        static: PerJoint | None = None,
        root: PerJoint | None = None,
        spring: PerJoint | None = None,
        asymmetric_viscous: PerDirection | None = None,
        asymmetric_dry: PerDirection | None = None,
        coupled: PerPair | None = None,
        payload: LinkParameters | None = None,
    ) -> Float[Array, " coefficients"]:
        """The vector `k` of a robot whose physical parameters are known, (p,).

        **Arguments**

        - `links`: one `LinkParameters` a joint; lengths and gravity are those of `robot`.
        - `viscous`, `dry`, `offset`, `static`, `root`, `spring`: (n,) coefficients of friction
          terms, zero for joints without the term; all zero if omitted.
        - `asymmetric_viscous`, `asymmetric_dry`: (n, 2), forwards and backwards.
        - `coupled`: (pairs, 3), shared inertia, viscous and dry friction of coupled joints.
        - `payload`: in the frame of the link that carries it; nothing if omitted.

        **Raises**

        - `ValueError`: if the number of links or friction values is not that of the joints, or
          a friction term, or a payload, is given that the network, or one of its joints, does
          not have.

        >>> import jaxcslc as jc
        >>> robot = jc.puma560().with_gravity((0, 0, -9.814))
        >>> network = jc.derive(robot)
        >>> k = network.coefficients_from(robot.links, viscous=robot.viscous, dry=robot.dry)
        >>> round(float(k[network.names.index("kM25")]), 3)  # Appendix B prints 6.792
        6.792
        """
        given = {
            "viscous": viscous,
            "dry": dry,
            "offset": offset,
            "static": static,
            "root": root,
            "spring": spring,
            "asymmetric_viscous": asymmetric_viscous,
            "asymmetric_dry": asymmetric_dry,
            "coupled": coupled,
        }
        own = known_coefficients(self.algebra, self.terms, links, given)
        if self.payload is None:
            if payload is not None:
                raise ValueError("payload: the network has none; expected one `with_payload()`")
            return own
        ten = jnp.zeros(self.payload.size)
        if payload is not None:
            ten = coefficient_values(self.coefficients[self._own :], [payload] * len(links), {})
        return jnp.concatenate([own, ten.astype(own.dtype)])

    def with_static_slopes(
        self, slopes: Sequence[float] | Float[Array | np.ndarray, " joints"]
    ) -> "CSLC":
        """The same network with other slopes of static friction, (n,) [s/rad or s/m].

        Those of joints without static friction are not used. Numbers and NumPy arrays become
        constants of functions that are compiled. A JAX array stays one, a leaf of the network
        that transformations see: a compiled function that takes the slopes, or the network, as
        an argument can be called with others, vmapped over them and differentiated by them. (Of
        a network that holds an array, `equinox.filter_jit` compiles methods; `jax.jit` cannot.)

        **Raises** `ValueError` for a wrong number of slopes, and for numbers not above 0.

        >>> import jax, jax.numpy as jnp, jaxcslc as jc
        >>> robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
        >>> network = jc.derive(robot.with_friction("viscous", "dry", "static"))
        >>> k, qd = jnp.ones(network.size), jnp.array([0.5])
        >>> held = lambda slopes: network.with_static_slopes(slopes).friction_term(k, qd)[0]
        >>> round(float(jax.grad(held)(jnp.array([2.0]))[0]), 4)  # -0.5 exp(-2 * 0.5)
        -0.1839
        """
        n = self.joint_count
        if isinstance(slopes, Array):
            given: Any = slopes
            shape = slopes.shape
        else:
            given = np.asarray(slopes, float)
            shape = given.shape
            if not np.all((given > 0) & (given < np.inf)):
                raise ValueError(f"static slopes: expected numbers above 0, got {given.tolist()}")
            given = tuple(given.ravel().tolist())
        if shape != (n,):
            raise ValueError(f"static slopes: expected {n}, one a joint, got {shape}")
        return dataclasses.replace(self, static_slopes=given)

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
        carrying = carrier(self.robot, link)
        return dataclasses.replace(
            self,
            coefficients=(*self.coefficients, *payload_coefficients(carrying)),
            payload=payload_evaluator(carrying),
        )

    @property
    def carrying_link(self) -> int | None:
        """The link that carries the payload, counted from 1; None without one."""
        if self.payload is None:
            return None
        return self.coefficients[-1].addends[0].term.link + 1

    @property
    def terms(self) -> tuple[FrictionTerm, ...]:
        """The groups of coefficients that follow the inertial ones, in the order of `k`."""
        return friction_terms(self.robot)

    def without_friction(self, k: Vector) -> Float[Array, " coefficients"]:
        """The coefficients of the same robot if nothing rubbed: those of friction set to zero.

        Springs and the inertia that coupled joints share stay.

        >>> import jax.numpy as jnp, jaxcslc as jc
        >>> network = jc.derive(jc.puma560())
        >>> float(network.without_friction(jnp.ones(43)).sum())  # 6 viscous and 6 dry less
        31.0
        """
        kept = np.ones(self.size)
        start = self._inertial
        for term in self.terms:
            if term.word not in _NOT_FRICTION:
                kept[start : start + term.size] = 0.0
            start += term.size
        k = jnp.asarray(k)
        return k * jnp.asarray(kept, k.dtype)

    def term_inputs(self, q: Numbers, qd: Numbers, qdd: Numbers) -> list[list[Float[Array, "..."]]]:
        """What the coefficients of each of `terms` multiply: (...,) for each of its `joints`."""
        q, qd, qdd = self._checked(None, q, qd, qdd)[1:]
        return self._inputs(self.terms, *(_by_joint(x) for x in (q, qd, qdd)))

    @property
    def support(self) -> tuple[tuple[int, ...], ...]:
        """For each joint, the coefficients that its torque can depend on, in ascending order."""
        own: list[list[int]] = [[] for _ in range(self.joint_count)]
        start = self._inertial
        for term in self.terms:
            for j, place in zip(term.joints, term.places, strict=True):
                own[j].append(start + place)
            start += term.size
        if self.payload is not None:
            for j, places in enumerate(self.payload.support):
                own[j] += [self._own + place for place in places]
        return tuple(
            (*inertial, *sorted(added))
            for inertial, added in zip(self.evaluator.support, own, strict=True)
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
        inputs = self._inputs(self.terms, list(q), list(qd), list(qdd))
        rows = friction_rows(self.terms, inputs, self._inertial)
        if self.payload is not None:
            felt = self.payload.columns(q, qd, qdd)
            for joint, (places, values) in enumerate(zip(self.payload.support, felt, strict=True)):
                rows |= {(joint, self._own + p): row for p, row in zip(places, values, strict=True)}
        return tuple(
            jnp.concatenate(
                [rigid, *(rows[joint, p][None] for p in support if p >= self._inertial)]
            )
            for joint, (support, rigid) in enumerate(
                zip(self.support, self.evaluator.columns(q, qd, qdd), strict=True)
            )
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
        for term in self.terms:
            n, before = len(term.joints), counts.get(term.word, dict.fromkeys(counts["mass"], 0))
            counts[term.word] = {
                "inputs": before["inputs"] + n,
                "links": before["links"] + n,
                "nodes": len(set(term.joints)),
                "coefficients": before["coefficients"] + term.size,
            }
        if self._carrying is not None:
            added = [getattr(self._carrying, name) for name in ("mass", "velocity", "gravity")]
            counts["payload"] = {
                "inputs": sum(len(table.inputs) for table in added),
                "links": sum(len(table.links) for table in added),
                "nodes": sum(len(table.columns) for table in added),
                "coefficients": len(self._carrying.coefficients),
            }
        return counts

    @property
    def _carrying(self) -> Algebra | None:
        """The closed form of the payload's torque, in as many coefficients as can be felt."""
        link = self.carrying_link
        return None if link is None else derive_algebra(carrier(self.robot, link), "numeric")

    @property
    def order_per_joint(self) -> tuple[int, ...]:
        """How many coefficients each joint's torque depends on, friction included (5.2.5).

        Of a payload, as many as joints can feel one by one, out of the ten.
        """
        own = order_per_joint(self.algebra, self.robot)
        if self._carrying is None:
            return own
        felt = order_per_joint(self._carrying, self._carrying.robot)
        return tuple(mine + more for mine, more in zip(own, felt, strict=True))

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

    def _inputs(
        self, terms: Sequence[FrictionTerm], q: Any, qd: Any, qdd: Any
    ) -> list[list[Array]]:
        """Inputs of terms; motion has an entry a joint, and so have the slopes."""
        slopes: Any = self.static_slopes
        if isinstance(slopes, Array):
            slopes = _by_joint(slopes.astype(qd[0].dtype))
        return friction_inputs(terms, slopes or (), q, qd, qdd)

    def _terms_torque(
        self, k: Array, q: Array, qd: Array, qdd: Array, words: Sequence[str] | None = None
    ) -> Array:
        """What all terms add to the torque, or those of some words."""
        terms: list[FrictionTerm] = []
        places: list[int] = []
        start = self._inertial
        for term in self.terms:
            if words is None or term.word in words:
                terms.append(term)
                places += range(start, start + term.size)
            start += term.size
        if not terms:
            return jnp.zeros_like(qd)
        inputs = self._inputs(terms, *(_by_joint(x) for x in (q, qd, qdd)))
        own = k[self._inertial : self._own] if words is None else k[np.array(places)]
        return friction_torque(terms, inputs, own, jnp.zeros_like(qd[..., 0]), self.joint_count)

    def _mass(self, k: Array, q: Array) -> Array:
        mass = self.evaluator.mass_matrix(k[: self._inertial], q)
        if self.payload is not None:
            mass = mass + self.payload.mass_matrix(k[self._own :], q)
        start = self._inertial
        for term in self.terms:
            if term.word == "coupled_inertia":
                shared = sum(
                    k[start + place] * jnp.asarray(coupling_matrix(pair, self.joint_count), q.dtype)
                    for place, pair in enumerate(term.pairs)
                )
                mass = mass + jnp.broadcast_to(shared, mass.shape)
            start += term.size
        return mass

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


def _by_joint(x: Float[Array, "*batch joints"]) -> list[Float[Array, "*batch"]]:
    return [x[..., joint] for joint in range(x.shape[-1])]
