import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ..derivation import Algebra, Coefficient, constant_values
from ..manipulator import LinkParameters, Manipulator
from ._evaluator import AbstractEvaluator
from ._friction import (
    FrictionTerm,
    coupling_matrix,
    friction_inputs,
    friction_regressor,
    friction_rows,
    friction_terms,
    friction_torque,
)
from ._link_values import coefficient_values
from ._order import order_per_joint


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
    one), then three for each coupled pair of joints, as `coefficients` lists them. Positions,
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
    """

    coefficients: tuple[Coefficient, ...] = eqx.field(static=True)
    algebra: Algebra = eqx.field(static=True)
    evaluator: AbstractEvaluator
    static_slopes: tuple[Any, ...] | Float[Array, "..."] | None = None

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
        return rigid + self._terms_torque(k, q, qd, qdd) if self.terms else rigid

    def regressor(self, q: Numbers, qd: Numbers, qdd: Numbers) -> Float[Array, "..."]:
        """The matrix that `k` is multiplied by: `regressor @ k == torque`, (..., n, p)."""
        _, q, qd, qdd = self._checked(None, q, qd, qdd)
        parts = [self.evaluator.regressor(q, qd, qdd)]
        if self.terms:
            inputs = self._inputs(self.terms, *(_by_joint(x) for x in (q, qd, qdd)))
            parts.append(friction_regressor(self.terms, inputs, q[..., 0] * 0, self.joint_count))
        return jnp.concatenate(parts, axis=-1)

    def mass_matrix(self, k: Vector, q: Numbers) -> Float[Array, "..."]:
        """M(q), (..., n, n), motor inertias included (Eqn. 2.5-6) [kg m²]."""
        k, q = self._checked(k, q)
        return self._mass(k, q)

    def velocity_term(self, k: Vector, q: Numbers, qd: Numbers) -> Float[Array, "..."]:
        """V(q, qd): centrifugal and Coriolis torques (Eqn. 2.4-6), (..., n) [N m]."""
        k, q, qd = self._checked(k, q, qd)
        return self.evaluator.velocity_term(k[: self._inertial], q, qd)

    def gravity_term(self, k: Vector, q: Numbers) -> Float[Array, "..."]:
        """G(q): the gravity effect vector (Eqn. 2.4-7), (..., n) [N m]."""
        k, q = self._checked(k, q)
        return self.evaluator.gravity_term(k[: self._inertial], q)

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
    ) -> Float[Array, " coefficients"]:
        """The vector `k` of a robot whose physical parameters are known, (p,).

        **Arguments**

        - `links`: one `LinkParameters` a joint; lengths and gravity are those of `robot`.
        - `viscous`, `dry`, `offset`, `static`, `root`, `spring`: (n,) coefficients of friction
          terms, zero for joints without the term; all zero if omitted.
        - `asymmetric_viscous`, `asymmetric_dry`: (n, 2), forwards and backwards.
        - `coupled`: (pairs, 3), shared inertia, viscous and dry friction of coupled joints.

        **Raises**

        - `ValueError`: if the number of links or friction values is not that of the joints, or
          a friction term is given that the network, or one of its joints, does not have.

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
        parts = [
            coefficient_values(self.algebra.coefficients, links, constant_values(self.robot))
            if self.algebra.lengths != "numeric"
            else coefficient_values(self.algebra.coefficients, links, {})
        ]
        names = (*self.robot.friction_terms, *(["coupled"] if self.robot.coupled else []))
        for word, value in given.items():
            if value is not None and word not in names:
                raise ValueError(
                    f"{word}: the network has no such friction term; it has"
                    f" {', '.join(names) or 'none'}"
                )
        for term in self.terms:
            word = "coupled" if term.pairs else term.word
            columns = 3 if term.pairs else 2 if term.part else 0
            rows = len(term.pairs) if term.pairs else n
            values = _values(word, given[word], rows, columns)
            if term.pairs:
                parts.append(values[:, ("inertia", "viscous", "dry").index(term.word[8:])])
                continue
            if not isinstance(values, Tracer):
                for j in sorted(set(range(n)) - set(term.joints)):
                    if np.any(np.asarray(values[j]) != 0):
                        raise ValueError(f"{word}: joint {j + 1} has no such friction term")
            if columns:
                values = values[:, "+-".index(term.part)]
            parts.append(values[np.array(term.joints)])
        return jnp.concatenate([jnp.asarray(part, parts[0].dtype) for part in parts])

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

    @property
    def terms(self) -> tuple[FrictionTerm, ...]:
        """The groups of coefficients that follow the inertial ones, in the order of `k`."""
        return friction_terms(self.robot)

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
        return tuple(
            (*inertial, *sorted(friction))
            for inertial, friction in zip(self.evaluator.support, own, strict=True)
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
        own = k[self._inertial :] if words is None else k[np.array(places)]
        return friction_torque(terms, inputs, own, jnp.zeros_like(qd[..., 0]), self.joint_count)

    def _mass(self, k: Array, q: Array) -> Array:
        mass = self.evaluator.mass_matrix(k[: self._inertial], q)
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


def _values(word: str, given: Any, rows: int, columns: int) -> Any:
    """Coefficients of a term as they were given, or zeros. **Raises** `ValueError` by shape."""
    shape = (rows, columns) if columns else (rows,)
    values = np.zeros(shape) if given is None else jnp.asarray(given)
    if values.shape != shape:
        if columns == 3:
            raise ValueError(
                f"{word}: expected {rows} by 3 values, inertia, viscous and dry of each pair,"
                f" got {values.shape}"
            )
        each = "two a joint, forwards and backwards" if columns else "one a joint"
        raise ValueError(
            f"{word}: expected {rows * max(columns, 1)} values, {each}, got {values.shape}"
        )
    return values
