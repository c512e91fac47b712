"""The network of one robot: a rigid body, friction, springs, coupled joints and a payload.

The formula is Eqn. 2.5-2. Methods `with_...` and `without_...` return networks with other terms.
Counts and orders are those of the thesis (4.2, 5.1, 5.2.5). `derive` builds the network of a robot:
it chooses the lengths that stay symbols, and the evaluator of the rigid body.
"""

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal, TypeVar, cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._display import html_of
from .._text_table import counted
from ..codegen import Motion, Value
from ..derivation import Algebra, Lengths, constant_values, derive_algebra
from ..manipulator import JointLimits, LinkParameters, Manipulator, RobotError
from ._layout import coefficient_values
from ._linear_network import AbstractLinearNetwork, Vector
from .terms import (
    JOINT_LAWS,
    PARTS,
    AbstractInputTerm,
    AbstractManipulatorTerm,
    AbstractRigidBody,
    CoupledTerm,
    JointProjection,
    JointTerm,
    LoadFriction,
    ProjectedTerm,
    RigidBodyRecursion,
    RigidBodyTables,
    carrier,
    payload_term,
)


Numbers = Float[Array | np.ndarray, "... joints"]
Entry = TypeVar("Entry")


# One number a joint, two for either direction, or three a pair of coupled joints.
FrictionValues = Sequence[float] | Sequence[Sequence[float]] | Float[Array | np.ndarray, "..."]


def input_terms(
    robot: Manipulator, rigid: AbstractRigidBody | ProjectedTerm
) -> tuple[AbstractInputTerm, ...]:
    """The terms of the robot's friction model, in its order, then those of coupled joints, and
    last the friction that follows the torque of `rigid`, links and motors."""
    laws = [JOINT_LAWS[kind] for kind in robot.friction_terms]
    joint_terms = [JointTerm.of(law, robot) for law in laws if law.properties.needs != "torque"]
    return (*joint_terms, *CoupledTerm.from_robot(robot), *LoadFriction.from_robot(robot, rigid))


class CSLC(AbstractLinearNetwork):
    """A Context-Sensitive Linear Combiner: the inverse dynamics of one robot, linear in `k`.

        M(q) qdd + V(q, qd) + G(q) + F(qd) = torque        (Eqn. 2.5-2)

    and joint springs' torque S(q), where the robot has them. A network is a sum of `terms`, each
    with coefficients of its own; `k` holds them one after the other, and `layout` says where.

    Built by `derive`.

    **Attributes**

    - `algebra`: the exact derivation: tables of inputs and links.
    - `terms`: the rigid body, then friction, springs and coupled joints, then a payload.

    >>> import jaxcslc as jc
    >>> network = jc.derive(jc.examples.pendulum(), lengths="numeric")
    >>> network.names, [term.kind for term in network.terms]
    (('kB1', 'kB2', 'kB3', 'kv1', 'kd1'), ['rigid_body', 'viscous', 'dry'])
    """

    algebra: Algebra = eqx.field(static=True)
    terms: tuple[AbstractManipulatorTerm, ...]

    @property
    def robot(self) -> Manipulator:
        """Robot that the network was derived from, with all joints, followers included."""
        return self.algebra.robot

    @property
    def name(self) -> str:
        """The robot's name."""
        return self.robot.name

    @property
    def output_kind(self) -> str:
        return "joint"

    @property
    def output_quantity(self) -> str:
        return "torque"

    @property
    def output_labels(self) -> tuple[str, ...]:
        """The joints' names, where the robot has such, or else `"1"` to `"n"`."""
        if self.robot.has_joint_names:
            return self.output_names
        return tuple(str(joint + 1) for joint in self.robot.independent_joints)

    @property
    def output_names(self) -> tuple[str, ...]:
        """The joints' names, or `"joint 1"` to `"joint n"`."""
        return self._of_independent(self.robot.joint_names)

    @property
    def output_units(self) -> tuple[str, ...]:
        """Units of the joints' torques."""
        return self._of_independent(self.robot.torque_units)

    @property
    def motion_count(self) -> int:
        """Number of columns of the motion: one per joint, except joints that follow others."""
        return len(self.robot.independent_joints)

    @property
    def joint_kinds(self) -> str:
        """Kinds of the joints that have torques, as in `"RRPRRR"`."""
        return "".join(self._of_independent(self.robot.kinds))

    @property
    def joint_limits(self) -> tuple[JointLimits, ...]:
        """Limits of each of the joints according to the robot's file."""
        return self._of_independent(self.robot.joint_limits)

    @property
    def friction_per_joint(self) -> tuple[tuple[str, ...], ...]:
        """The friction terms of each of the joints."""
        return self._of_independent(self.robot.friction_per_joint)

    @property
    def known_values(self) -> Mapping[str, float]:
        """Values of the coefficients that are made of known masses alone, by name (C.1.2).

        See `Manipulator.with_known`. `LeastSquares` keeps them, without standard errors; learning
        rules adapt all coefficients.

        **Raises** `RobotError` if a length that multiplies one of them has no value.

        >>> import jaxcslc as jc
        >>> arm = jc.puma560().with_known(6, mass=0.09, centre_of_gravity=(0.0, 0.0, 0.032))
        >>> jc.derive(arm, lengths="numeric").known_values
        {'kB24': 0.09}
        """
        known = [x for x in self.algebra.coefficients if x.is_known]
        symbolic = any(addend.constants for x in known for addend in x.addends)
        constants = constant_values(self.robot) if symbolic else {}
        return {x.name: x.known_value(constants) for x in known}

    def positions_of_all_joints(self, q: Numbers) -> Float[Array | np.ndarray, "... all_joints"]:
        """Positions of all the robot's joints, those included that follow others."""
        projection = JointProjection.of(self.robot)
        return q if projection is None else projection.positions(q)

    def mass_matrix(self, k: Vector, q: Numbers) -> Float[Array, "..."]:
        """M(q), (..., n, n), motor inertias included (Eqn. 2.5-6) [kg m²]."""
        k, q = self._checked(k, q)
        shape = (*q.shape, self.joint_count)
        return self._part("mass", k, lambda term, k: term.part("mass_matrix", k, q), shape)

    def velocity_term(self, k: Vector, q: Numbers, qd: Numbers) -> Float[Array, "..."]:
        """V(q, qd): centrifugal and Coriolis torques (Eqn. 2.4-6), (..., n) [N m]."""
        k, q, qd = self._checked(k, q, qd)
        return self._part("velocity", k, lambda term, k: term.part("velocity", k, q, qd), q.shape)

    def gravity_term(self, k: Vector, q: Numbers) -> Float[Array, "..."]:
        """G(q): the gravity effect vector (Eqn. 2.4-7), (..., n) [N m]."""
        k, q = self._checked(k, q)
        return self._part("gravity", k, lambda term, k: term.part("gravity", k, q), q.shape)

    def friction_term(self, k: Vector, qd: Numbers) -> Float[Array, "..."]:
        """F(qd): friction (Eqn. 2.5-3, 2.5-4) and torque offset, (..., n) [N m].

        Without what follows the load, which is no function of velocities alone.
        """
        k, qd = self._checked(k, qd)
        still = jnp.zeros_like(qd)
        return self._part("friction", k, lambda term, k: term.torque(k, still, qd, still), qd.shape)

    def spring_term(self, k: Vector, q: Numbers) -> Float[Array, "..."]:
        """S(q): torques of joint springs, stiffness times position, (..., n) [N m]."""
        k, q = self._checked(k, q)
        still = jnp.zeros_like(q)
        return self._part("spring", k, lambda term, k: term.torque(k, q, still, still), q.shape)

    def forward_dynamics(
        self, k: Vector, q: Numbers, qd: Numbers, tau: Numbers
    ) -> Float[Array, "..."]:
        """Accelerations that torques `tau` (..., n) produce, (..., n) [rad/s²].

        Solves M qdd = tau - V - G - F - S. Not finite where M is singular, which it is for no
        possible mass distribution. Friction that follows the load depends on accelerations, by
        the sign of the load: the signs are searched for, which is exact at once where the load is
        that of `k`.
        """
        k, q, qd, tau = self._checked(k, q, qd, tau)
        still, loads = jnp.zeros_like(q), self.load_terms
        plain = [term for term in self.terms if not isinstance(term, LoadFriction)]
        bias = self._sum(plain, k, lambda term, k: term.torque(k, q, qd, still), q.shape)
        mass = self.mass_matrix(k, q)
        for term in loads:
            factors = term.factors(k[self.layout.term_slice(term)])
            mass, bias = term.on_the_left(factors, q, qd, tau, mass, bias)
        return jnp.linalg.solve(mass, (tau - bias)[..., None])[..., 0]

    def without_friction(self, k: Vector) -> Float[Array, " coefficients"]:
        """Return the coefficients of the same robot without friction: those of friction set to
        zero.

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
    def rigid_body(self) -> AbstractRigidBody:
        """The term of the links and motors."""
        rigid = self.terms[0]
        if isinstance(rigid, ProjectedTerm):
            return rigid.term
        assert isinstance(rigid, AbstractRigidBody)
        return rigid

    @property
    def input_terms(self) -> tuple[AbstractInputTerm, ...]:
        """Friction, torque offsets, springs and coupled joints."""
        return tuple(term for term in self.terms if isinstance(term, AbstractInputTerm))

    @property
    def payload(self) -> AbstractManipulatorTerm | None:
        """The term of the payload, or None. See `with_payload`."""
        last = self.terms[-1]
        return last if last.kind == "payload" else None

    @property
    def has_column_entries(self) -> bool:
        """True if all terms are of kinds that can be written as expressions."""
        kinds = AbstractRigidBody | AbstractInputTerm
        return all(isinstance(term, kinds) for term in self.terms)

    def column_entries(self, motion: Motion) -> Iterator[tuple[int, int, Value]]:
        """Joint, coefficient and value of the regressor's entries that are not always zero.

        As expressions of the motion, for programs other than JAX's; with the numbers that the
        terms have, which JAX must not be tracing.
        """
        for term in self.terms:
            indices = self.layout.indices(term.kind).tolist()
            assert isinstance(term, AbstractRigidBody | AbstractInputTerm)
            for joint, index, value in term.entries(motion):
                yield joint, indices[index], value

    def coefficients_from(
        self,
        links: Sequence[LinkParameters],
        *,
        payload: LinkParameters | None = None,
        **friction: FrictionValues | None,
    ) -> Float[Array, " coefficients"]:
        """Return the vector `k` of a robot whose physical parameters are known, (p,).

        **Arguments**

        - `links`: one `LinkParameters` a joint; lengths and gravity are those of `robot`.
        - `payload`: in the frame of the link that carries it; none if omitted.
        - `friction`: by the kind of the term, zero if omitted. `viscous`, `dry`, `offset`,
          `static`, `root`, `quadratic`, `spring`, `load`: (n,), zero for joints without the term;
          `asymmetric_viscous`, `asymmetric_dry`: (n, 2), forwards and backwards; `coupled`:
          (pairs, 3), shared inertia, viscous and dry friction of coupled joints.

        **Raises** `ValueError`: if the number of links or friction values is not that of the
        joints, or if the network, or one of its joints, lacks a term or a payload that has values.

        >>> import jaxcslc as jc
        >>> robot = jc.puma560().with_gravity((0, 0, -9.814))
        >>> network = jc.derive(robot)
        >>> k = network.coefficients_from(robot.links, viscous=robot.viscous, dry=robot.dry)
        >>> round(float(k[network.names.index("kM25")]), 3)  # Appendix B prints 6.792
        6.792
        """
        if self.payload is None and payload is not None:
            raise ValueError("payload: the network has none; expected one `with_payload()`")
        return coefficient_values(self.algebra, self.terms, links, friction, payload)

    @property
    def static_slopes(self) -> Float[Array | np.ndarray, "..."] | None:
        """(n,) of each joint's static friction [s/rad or s/m]; None without static friction."""
        laws = (term.law for term in self.terms if isinstance(term, JointTerm))
        return next((law.slopes for law in laws if law.slopes is not None), None)

    def with_static_slopes(
        self, slopes: Sequence[float] | Float[Array | np.ndarray, " joints"]
    ) -> "CSLC":
        """Return the network with other slopes of static friction, (n,) [s/rad or s/m].

        Those of joints without static friction are not used. Slopes are a leaf of the network: a
        compiled function that takes the slopes, or the network, as an argument can be called
        with others, vmapped over them and differentiated by them.

        **Raises** `ValueError` for a network without static friction, for a wrong number of
        slopes, and for numbers not above 0.

        >>> import jax, jax.numpy as jnp, jaxcslc as jc
        >>> network = jc.derive(jc.examples.pendulum("viscous", "dry", "static"))
        >>> k, qd = jnp.ones(network.size), jnp.array([0.5])
        >>> friction = lambda s: network.with_static_slopes(s).friction_term(k, qd)[0]
        >>> round(float(jax.grad(friction)(jnp.array([2.0]))[0]), 4)  # -0.5 exp(-2 * 0.5)
        -0.1839
        """
        if self.static_slopes is None:
            raise ValueError(f"static slopes: {self.robot.name!r} has no static friction")
        return self._with_terms(
            term.with_slopes(slopes)
            if isinstance(term, JointTerm) and term.law.slopes is not None
            else term
            for term in self.terms
        )

    def without_law(self, kind: str, joints: Sequence[int]) -> "CSLC":
        """Return the network without a friction law, or a spring, of some joints, counted from 1.

        **Raises** `ValueError` if the network has no such term.

        >>> import jaxcslc as jc
        >>> network = jc.derive(jc.puma560())
        >>> network.without_law("dry", (1, 2)).names[-4:]
        ('kd3', 'kd4', 'kd5', 'kd6')
        """
        self.layout.term_slice(kind)
        robot, independent = self.robot, self.robot.independent_joints
        for joint in joints:
            kinds = self.friction_per_joint[joint - 1]
            remaining = (other for other in kinds if other != kind)
            robot = robot.with_friction(*remaining, joint=independent[joint - 1] + 1)
        terms: list[AbstractManipulatorTerm] = []
        for term in self.terms:
            if term.kind != kind:
                terms.append(term)
            elif isinstance(term, LoadFriction):
                changed = {fewer.kind: fewer for fewer in input_terms(robot, self._rigid_term)}
                if kind in changed:
                    terms.append(dataclasses.replace(changed[kind], load=term.load))
            elif isinstance(term, JointTerm) and (fewer := JointTerm.of(term.law, robot)).size:
                terms.append(fewer)
        return self._with_terms(terms, robot)

    def with_joint_friction(self, kinds: Sequence[Sequence[str]]) -> "CSLC":
        """Return the network with other friction laws, and springs, of its joints.

        **Arguments**

        - `kinds`: of each joint.

        **Raises**

        - `RobotError`: kinds that are unknown, listed twice or collinear.
        - `ValueError`: for a network with a payload, or another number of joints.

        >>> import jaxcslc as jc
        >>> network = jc.derive(jc.puma560())
        >>> network.with_joint_friction([("dry", "offset")] * 6).names[-7:]
        ('kd6', 'ko1', 'ko2', 'ko3', 'ko4', 'ko5', 'ko6')
        """
        if self.payload is not None or len(kinds) != self.joint_count:
            raise ValueError(
                f"expected a network without payload and {self.joint_count} joints' friction,"
                f" got {len(kinds)}"
            )
        robot = self.robot
        for joint, kinds_of_joint in zip(robot.independent_joints, kinds, strict=True):
            robot = robot.with_friction(*kinds_of_joint, joint=joint + 1)
        return self._with_terms((self.terms[0], *input_terms(robot, self._rigid_term)), robot)

    @property
    def load_terms(self) -> tuple[LoadFriction, ...]:
        """The terms of dry friction that grows with the load, one for each of its two kinds."""
        return tuple(term for term in self.terms if isinstance(term, LoadFriction))

    def with_load(self, k: Float[Array | np.ndarray, " coefficients"] | None) -> "CSLC":
        """Return the network with load-dependent friction that follows the torque of `k`, (p,).

        With this, torque is linear in all coefficients. None: of no torque, as before a fit.

        **Raises** `ValueError` for a network without such friction.

        >>> import jax.numpy as jnp, jaxcslc as jc
        >>> network = jc.derive(jc.examples.pendulum("load"), lengths="numeric")
        >>> k, still = jnp.array([0.5, 0.3, -0.1, 0.2]), jnp.zeros(1)
        >>> load = network.with_load(k).torque(k, still, still, jnp.ones(1))
        >>> moving = network.with_load(k).torque(k, still, 1e-9 * jnp.ones(1), jnp.ones(1))
        >>> round(float((moving / load)[0]), 6)
        1.2
        """
        if not self.load_terms:
            raise ValueError(f"load: {self.robot.name!r} has no friction of kind 'load'")
        load = None if k is None else k[self.layout.inertial]
        return self._with_terms(
            dataclasses.replace(term, load=load) if isinstance(term, LoadFriction) else term
            for term in self.terms
        )

    def without_load(self) -> "CSLC":
        """Return the network without load-dependent friction, if it has any."""
        network = self
        for term in self.load_terms:
            network = network.without_law(term.kind, range(1, self.joint_count + 1))
        return network

    def _of_independent(self, entries: Sequence[Entry]) -> tuple[Entry, ...]:
        """Select, from entries of all the robot's joints, those of the joints that have torques."""
        return tuple(entries[i] for i in self.robot.independent_joints)

    def _part(
        self, part: str, k: Array, share: Callable[[Any, Array], Array], shape: tuple[int, ...]
    ) -> Array:
        """The shares of the terms that belong to a sum of the equation of motion."""
        return self._sum([term for term in self.terms if part in term.parts], k, share, shape)

    @property
    def _rigid_term(self) -> AbstractRigidBody | ProjectedTerm:
        rigid = self.terms[0]
        assert isinstance(rigid, AbstractRigidBody | ProjectedTerm)
        return rigid

    def _with_terms(
        self, terms: Iterable[AbstractManipulatorTerm], robot: Manipulator | None = None
    ) -> "CSLC":
        algebra = self.algebra
        if robot is not None:
            algebra = dataclasses.replace(algebra, robot=robot)
        return CSLC(algebra=algebra, terms=tuple(terms))

    def with_payload(self, link: int | None = None) -> "CSLC":
        """Return the network with a payload: a body rigidly attached to a link (thesis 8.2.4).

        Its ten inertial parameters are the last coefficients of `k`, in group `"payload"`: the
        inertia tensor about the origin of the carrying link's frame, the first moments and the
        mass, pIxx pIyy pIzz pIxy pIxz pIyz phx phy phz pm. Zeros are no payload. A recording of
        the loaded arm alone cannot separate payload and link: fix the arm's coefficients at an
        earlier identification, or fit an unloaded recording jointly.

        **Arguments**

        - `link`: which one carries, counted from 1; the last one if omitted.

        **Raises**

        - `RobotError`: there is no such link.
        - `ValueError`: the network has a payload already, or friction of kind `"load"`.

        >>> import jax.numpy as jnp, numpy as np, jaxcslc as jc
        >>> network = jc.derive(jc.examples.pendulum(), lengths="numeric").with_payload()
        >>> ball = jc.LinkParameters(2.0, np.array([0.5, 0.0, 0.0]), np.zeros((3, 3)))
        >>> nothing = jc.LinkParameters(0.0, np.zeros(3), np.zeros((3, 3)))
        >>> k = network.coefficients_from([nothing], payload=ball)
        >>> rest = jnp.zeros(1)
        >>> bool(jnp.allclose(network.torque(k, rest, rest, rest), 2.0 * 9.81 * 0.5))
        True
        """
        if self.payload is not None:
            raise ValueError(f"{self.robot.name!r} has a payload already")
        if self.load_terms:
            raise ValueError(
                "payload: friction of kind 'load' does not know it; expected an arm without"
            )
        payload = ProjectedTerm.of(
            payload_term(carrier(self.robot, link)), JointProjection.of(self.robot)
        )
        return self._with_terms((*self.terms, payload))

    @property
    def carrying_link(self) -> int | None:
        """The link that carries the payload, counted from 1; None without one."""
        if self.payload is None:
            return None
        return self.payload.coefficients[-1].addends[0].term.link + 1

    @property
    def counts(self) -> dict[str, dict[str, int]]:
        """Size of each subnetwork: inputs, links and coefficients (thesis 5.1, Appendix B).

        Derives the closed-form tables if the network did not need them until now.
        """
        counts = _rigid_body_counts(self.algebra)
        for term in self.input_terms:
            n, nodes = len(term.input_joints), len(set(term.input_joints))
            counts[term.kind] = {"inputs": n, "links": n, "nodes": nodes, "coefficients": term.size}
        for payload in self._payload_algebra:
            parts = _rigid_body_counts(payload).values()
            names = ("inputs", "links", "nodes")
            total = {name: sum(part[name] for part in parts) for name in names}
            counts["payload"] = total | {"coefficients": len(payload.coefficients)}
        return counts

    @property
    def order_per_joint(self) -> tuple[int, ...]:
        """Number of coefficients that each joint's torque depends on, friction included (5.2.5).

        For a network whose output is linear in its coefficients and whose hidden nodes feed one
        context-sensitive product each, the order of an output is the number of coefficients that
        reach it (4.2). Of a payload's ten, as many as the joint's torque can tell apart.
        """
        projection = JointProjection.of(self.robot)
        rigid = (RigidBodyTables.from_algebra(x) for x in (self.algebra, *self._payload_algebra))
        terms = *(ProjectedTerm.of(x, projection) for x in rigid), *self.input_terms
        return tuple(
            sum(map(len, of_terms)) for of_terms in zip(*(x.support for x in terms), strict=True)
        )

    @property
    def _payload_algebra(self) -> tuple[Algebra, ...]:
        """The closed form of a payload's torque in base parameters; empty without a payload."""
        link = self.carrying_link
        return () if link is None else (derive_algebra(carrier(self.robot, link), "numeric"),)

    @property
    def order(self) -> int:
        """Network order (thesis 4.2): the coefficients of the joint that depends on most of them.

        As many independent patterns determine the coefficients of any joint from its own torque
        alone. Joints share coefficients, so that all joints together need fewer:
        `least_patterns`. (The thesis takes the order for that number, 5.2.5.)
        """
        return max(self.order_per_joint)

    def __repr__(self) -> str:
        groups = [coefficient.group for coefficient in self.coefficients]
        sizes = ", ".join(f"{groups.count(group)} {group}" for group in self.layout.groups)
        return (
            f"CSLC({self.robot.name}: {counted(self.joint_count, 'joint')},"
            f" {counted(self.size, 'coefficient')}:"
            f" {sizes}; {type(self.rigid_body).__name__})"
        )

    def _repr_html_(self) -> str:
        """Return tables of the joints and of the coefficients, for notebooks."""
        return html_of(self.robot) + super()._repr_html_()


def _rigid_body_counts(algebra: Algebra) -> dict[str, dict[str, int]]:
    tables = {name: getattr(algebra, name) for name in PARTS}
    return {
        name: {
            "inputs": len(table.inputs),
            "links": len(table.links),
            "nodes": len(table.columns),
            "coefficients": len(table.coefficients),
        }
        for name, table in tables.items()
    }


# Up to this many links straight-line code compiles in a few seconds and outruns the recursion.
_LARGEST_TABLES = 1500
# Beyond this many independent angles tables are large whatever the twists: not worth deriving
# them to find out. (A Panda, 7 angles: 27,243 velocity links.)
_MOST_ANGLES = 6
# Base parameters of 20 joints take 4 s, of 30 joints half a minute, and the time grows with the
# fourth power.
_MOST_JOINTS = 40


def derive(
    robot: Manipulator,
    *,
    lengths: Literal["symbolic", "numeric", "auto"] | Sequence[str] = "auto",
    evaluator: Literal["auto", "tables", "recursive", "rolled", "unrolled"] = "auto",
) -> CSLC:
    """Derive a robot's inverse dynamics and build the network that computes them.

    Of a robot some of whose joints follow others (`load_robot(mimic="couple")`), motion and torque
    are those of the `robot.independent_joints`.

    **Arguments**

    - `robot`: from `load_robot`, `puma560`, `panda` or `Manipulator.from_modified_dh`.
    - `lengths`: `"symbolic"`: the thesis's coefficients, valid whatever the lengths are.
      `"numeric"`: the base parameters, the fewest coefficients that describe the torque; use it
      for identification unless the lengths themselves are in doubt, and for any robot of more
      than 6 joints. A list of names keeps these lengths as symbols and puts the others' values
      in, mass and gravity coefficients apart (thesis 8.2.1). `"auto"`: symbolic for robots of up
      to 6 joints, numeric for others and for those from URDF and MJCF files.
    - `evaluator`: `"tables"`: straight-line code from the closed form; `"recursive"`:
      Newton-Euler, numeric lengths only, `"rolled"` as a loop over links or `"unrolled"` as
      straight-line code, whichever was measured to be quicker (see `RigidBodyRecursion`);
      `"auto"`: tables where they are small.

    **Raises**

    - `RobotError`: if a length that is to be a number has no value, a name is no length, or
      there are more than 40 joints.
    - `ValueError`: if `lengths` or `evaluator` is unknown, or for a recursive evaluator
      with symbolic lengths.

    >>> import jaxcslc as jc
    >>> jc.derive(jc.puma560())
    CSLC(PUMA 560: 6 joints, 43 coefficients: 26 mass, 5 gravity, 6 viscous, 6 dry; RigidBodyTables)
    """
    if robot.joint_count > _MOST_JOINTS:
        raise RobotError(
            f"robot {robot.name!r} has {robot.joint_count} joints; expected at most"
            f" {_MOST_JOINTS}: derivation takes minutes beyond. A part of a file is chosen by base"
            " and tip"
        )
    if lengths == "auto":
        lengths = "numeric" if _has_many_lengths(robot) else "symbolic"
    if isinstance(lengths, str) and lengths not in ("symbolic", "numeric"):
        raise ValueError(
            f"lengths must be 'symbolic', 'numeric', 'auto' or a list of names, got {lengths!r}"
        )
    symbols = lengths if isinstance(lengths, str) else tuple(lengths)
    algebra = derive_algebra(robot, cast(Lengths, symbols))
    rigid = ProjectedTerm.of(_rigid_body(algebra, evaluator), JointProjection.of(robot))
    return CSLC(algebra=algebra, terms=(rigid, *input_terms(robot, rigid)))


def _has_many_lengths(robot: Manipulator) -> bool:
    """Return whether a robot has too many lengths to keep as symbols.

    Files of CAD models give every axis an arbitrary offset, and each would be a symbol.
    """
    from_cad = robot.source is not None and robot.source.format != "toml"
    return from_cad or robot.joint_count > 6


def _rigid_body(algebra: Algebra, choice: str) -> AbstractRigidBody:
    if choice == "tables" or (choice == "auto" and _tables_are_small(algebra)):
        return RigidBodyTables.from_algebra(algebra)
    forms = {"auto": None, "recursive": None, "rolled": False, "unrolled": True}
    if choice in forms:
        return RigidBodyRecursion.from_algebra(algebra, forms[choice])
    raise ValueError(
        f"evaluator must be 'auto', 'tables', 'recursive', 'rolled' or 'unrolled', got {choice!r}"
    )


def _tables_are_small(algebra: Algebra) -> bool:
    if algebra.lengths != "numeric":
        return True
    right_angles = all(0 in link.twist for link in algebra.chain.links)
    if len(algebra.chain.angles) > (_MOST_ANGLES if right_angles else 3):
        return False
    return len(algebra.mass.links) + len(algebra.velocity.links) <= _LARGEST_TABLES
