"""The network of one robot: a rigid body, friction, springs, coupled joints and a payload.

The formula is Eqn. 2.5-2. Methods `with_...` and `without_...` return networks with other terms.
Counts and orders are those of the thesis (4.2, 5.1, 5.2.5).
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ..codegen import Motion, Value
from ..derivation import Algebra, constant_values, derive_algebra
from ..manipulator import LinkParameters, Manipulator
from ._layout import coefficient_values
from ._term_sum import AbstractTermSum
from .terms import (
    AbstractInputTerm,
    AbstractManipulatorTerm,
    AbstractRigidBody,
    JointProjection,
    JointTerm,
    LoadFriction,
    ProjectedTerm,
    StaticFriction,
    carrier,
    input_terms,
    payload_term,
    term_entries,
)


def counts_of(
    algebra: Algebra, terms: Sequence[AbstractInputTerm], carrying_link: int | None
) -> dict[str, dict[str, int]]:
    """Size of each subnetwork: inputs, links and coefficients (thesis 5.1, Appendix B).

    - `algebra`: of the rigid body; `terms`: of everything beside it.
    - `carrying_link`: of a payload, counted from 1; None without one.
    """
    counts = _rigid_body_counts(algebra)
    for term in terms:
        n = len(term.input_joints)
        nodes = len(set(term.input_joints))
        counts[term.kind] = {"inputs": n, "links": n, "nodes": nodes, "coefficients": term.size}
    for payload in _payload_algebra(algebra, carrying_link):
        parts = _rigid_body_counts(payload).values()
        total = {name: sum(part[name] for part in parts) for name in ("inputs", "links", "nodes")}
        counts["payload"] = total | {"coefficients": len(payload.coefficients)}
    return counts


def order_per_joint(
    algebra: Algebra, terms: Sequence[AbstractInputTerm], carrying_link: int | None
) -> tuple[int, ...]:
    """Count the independent coefficients that each joint's torque depends on (thesis 4.2, 5.2.5).

    For a network whose output is linear in its coefficients and whose hidden nodes feed one
    context-sensitive product each, the order of an output is the number of coefficients that
    reach it. Arguments as of `counts_of`.
    """
    projection, n = JointProjection.of(algebra.robot), algebra.robot.joint_count
    moved = [[i] for i in range(n)]
    if projection is not None:
        moved = [[joint for joint, _ in shares] for shares in projection.shares]
    orders = [0] * len(moved)
    for rigid in (algebra, *_payload_algebra(algebra, carrying_link)):
        reach: list[set[int]] = [set() for _ in range(n)]
        for link in rigid.mass.links:
            for joint in rigid.mass.columns[link.column]:
                reach[joint] |= {index for index, _ in link.weights}
        for table in (rigid.velocity, rigid.gravity):
            for link in table.links:
                reach[table.columns[link.column][0]] |= {index for index, _ in link.weights}
        for output, joints in enumerate(moved):
            orders[output] += len({index for joint in joints for index in reach[joint]})
    for term in terms:
        for joint in term.input_joints:
            orders[joint] += 1
    return tuple(orders)


def _payload_algebra(algebra: Algebra, carrying_link: int | None) -> tuple[Algebra, ...]:
    """The closed form of a payload's torque in base parameters; empty without a payload."""
    if carrying_link is None:
        return ()
    return (derive_algebra(carrier(algebra.robot, carrying_link), "numeric"),)


def _rigid_body_counts(algebra: Algebra) -> dict[str, dict[str, int]]:
    tables = {name: getattr(algebra, name) for name in ("mass", "velocity", "gravity")}
    return {
        name: {
            "inputs": len(table.inputs),
            "links": len(table.links),
            "nodes": len(table.columns),
            "coefficients": len(table.coefficients),
        }
        for name, table in tables.items()
    }


# One number a joint, two for either direction, or three a pair of coupled joints.
FrictionValues = Sequence[float] | Sequence[Sequence[float]] | Float[Array | np.ndarray, "..."]


class CSLC(AbstractTermSum):
    """A Context-Sensitive Linear Combiner: the inverse dynamics of one robot, linear in `k`.

        M(q) qdd + V(q, qd) + G(q) + F(qd) = torque        (Eqn. 2.5-2)

    and joint springs' torque S(q), where the robot has them. A network is a sum of `terms`, each
    with coefficients of its own; `k` holds them one after the other, and `layout` says where.

    Built by `derive`.

    **Attributes**

    - `algebra`: the exact derivation: tables of inputs and links.
    - `terms`: the rigid body, then friction, springs and coupled joints, then a payload.

    >>> import jaxcslc as jc
    >>> pendulum = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> network = jc.derive(pendulum, lengths="numeric")
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
            if isinstance(term, AbstractRigidBody):
                entries = term.entries(motion)
            else:
                assert isinstance(term, AbstractInputTerm)
                entries = term_entries(term, motion)
            yield from ((joint, indices[index], value) for joint, index, value in entries)

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
          `static`, `root`, `quadratic`, `spring`, `load`: (n,), zero for joints without the term;
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
        if self.payload is None and payload is not None:
            raise ValueError("payload: the network has none; expected one `with_payload()`")
        return coefficient_values(self.algebra, self.terms, links, friction, payload)

    @property
    def static_slopes(self) -> Float[Array | np.ndarray, "..."] | None:
        """(n,) of each joint's static friction [s/rad or s/m]; None without static friction."""
        law = self._static_friction
        return None if law is None else law.slopes

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
            if isinstance(term, JointTerm) and term.law is self._static_friction
            else term
            for term in self.terms
        )
        return CSLC(algebra=self.algebra, terms=terms)

    def without_law(self, kind: str, joints: Sequence[int]) -> "CSLC":
        """Return the network without a friction law, or a spring, of some joints, counted from 1.

        **Raises** `ValueError` if the network has no such term.

        >>> import jaxcslc as jc
        >>> network = jc.derive(jc.puma560())
        >>> network.without_law("dry", (1, 2)).names[-4:]
        ('kd3', 'kd4', 'kd5', 'kd6')
        """
        self.layout.of(kind)
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
                terms += LoadFriction.of(kind, robot, term.rigid, term.load)
            elif isinstance(term, JointTerm) and (fewer := JointTerm.of(term.law, robot)).size:
                terms.append(fewer)
        return CSLC(algebra=dataclasses.replace(self.algebra, robot=robot), terms=tuple(terms))

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
        return CSLC(
            algebra=dataclasses.replace(self.algebra, robot=robot),
            terms=(self.terms[0], *input_terms(robot, self._rigid_term)),
        )

    @property
    def load_terms(self) -> tuple[LoadFriction, ...]:
        """The terms of dry friction that grows with the load, one for each of its two kinds."""
        return tuple(term for term in self.terms if isinstance(term, LoadFriction))

    def with_load(self, k: Float[Array | np.ndarray, " coefficients"] | None) -> "CSLC":
        """Return the network with load-dependent friction that follows the torque of `k`, (p,).

        With this, torque is linear in all coefficients. None: of no torque, as before a fit.

        **Raises** `ValueError` for a network without such friction.

        >>> import jax.numpy as jnp, jaxcslc as jc
        >>> robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
        >>> network = jc.derive(robot.with_friction("load"), lengths="numeric")
        >>> k, still = jnp.array([0.5, 0.3, -0.1, 0.2]), jnp.zeros(1)
        >>> load = network.with_load(k).torque(k, still, still, jnp.ones(1))
        >>> moving = network.with_load(k).torque(k, still, 1e-9 * jnp.ones(1), jnp.ones(1))
        >>> round(float((moving / load)[0]), 6)
        1.2
        """
        if not self.load_terms:
            raise ValueError(f"load: {self.robot.name!r} has no friction of kind 'load'")
        load = None if k is None else k[self.layout.inertial]
        terms = (
            term.with_load(load) if isinstance(term, LoadFriction) else term for term in self.terms
        )
        return CSLC(algebra=self.algebra, terms=tuple(terms))

    def without_load(self) -> "CSLC":
        """Return the network without load-dependent friction, if it has any."""
        network = self
        for term in self.load_terms:
            network = network.without_law(term.kind, range(1, self.joint_count + 1))
        return network

    @property
    def _rigid_term(self) -> AbstractRigidBody | ProjectedTerm:
        rigid = self.terms[0]
        assert isinstance(rigid, AbstractRigidBody | ProjectedTerm)
        return rigid

    @property
    def _static_friction(self) -> StaticFriction | None:
        laws = (term.law for term in self.terms if isinstance(term, JointTerm))
        return next((law for law in laws if isinstance(law, StaticFriction)), None)

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
        if self.load_terms:
            raise ValueError(
                "payload: friction of kind 'load' does not know it; expected an arm without"
            )
        payload = ProjectedTerm.of(
            payload_term(carrier(self.robot, link)), JointProjection.of(self.robot)
        )
        return CSLC(algebra=self.algebra, terms=(*self.terms, payload))

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
        return counts_of(self.algebra, self.input_terms, self.carrying_link)

    @property
    def order_per_joint(self) -> tuple[int, ...]:
        """Number of coefficients that each joint's torque depends on, friction included (5.2.5).

        Of a payload's ten, as many as the joint's torque can tell apart.
        """
        return order_per_joint(self.algebra, self.input_terms, self.carrying_link)

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
            f"CSLC({self.robot.name}: {self.joint_count} joints, {self.size} coefficients:"
            f" {sizes}; {type(self.rigid_body).__name__})"
        )
