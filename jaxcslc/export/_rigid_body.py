"""The rigid-body part of a network with certain coefficients, as expressions for C code."""

from collections.abc import Callable, Collection, Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from functools import reduce
from operator import add

import numpy as np
from jaxtyping import Float

from .._rank import numerical_rank
from ..bodies import body_map
from ..codegen import Motion, Value
from ..derivation import BODY
from ..manipulator import Manipulator
from ..network import (
    CSLC,
    PARTS,
    AbstractExpressedBodies,
    ClosedForm,
    JointProjection,
    ProjectedTerm,
    RecursiveBodies,
    RigidBodyRecursion,
)


# Coefficients that bodies can have are reproduced by bodies to this part of the largest.
_ROUNDING = 1e-13


@dataclass(frozen=True)
class RigidBodies:
    """The rigid-body part of a network, payload included, as expressions of the joints' motion.

    **Attributes**

    - `addends`: bodies whose torques add up, with their coefficients.
    - `columns`: bodies of the network's coefficients, with how many each has; none where the
      coefficients are not those of bodies.
    - `shares`: for each independent joint, the bodies' joints that move with it, and their shares.
    """

    addends: tuple[tuple[AbstractExpressedBodies, list[float]], ...]
    columns: tuple[tuple[AbstractExpressedBodies, int], ...]
    shares: tuple[tuple[tuple[int, float], ...], ...]

    def torque(self, parts: Collection[str] = PARTS) -> list[Value]:
        """Return the torque of every joint, or some parts of it."""
        torques = [bodies.torque(k, parts) for bodies, k in self.addends]
        return self._projected([reduce(add, x) for x in zip(*torques, strict=True)])

    def mass_matrix(self) -> list[list[Value]]:
        """Return the mass matrix row by row."""
        matrices = [bodies.mass_matrix(k) for bodies, k in self.addends]
        rows = [
            [reduce(add, x) for x in zip(*row, strict=True)] for row in zip(*matrices, strict=True)
        ]
        return self._of_columns([self._projected(row) for row in rows])

    def regressor(self) -> list[list[Value]] | None:
        """Return a row per joint: columns of the inertial coefficients, then of the payload's.

        None where the coefficients are not those of bodies.
        """
        rows: list[list[Value]] = []
        for bodies, size in self.columns:
            entries, zero = bodies.entries(), bodies.motion.graph.constant(0.0)
            rows = rows or [[] for _ in bodies.motion.q]
            for joint, row in enumerate(rows):
                row += [entries.get((joint, index), zero) for index in range(size)]
        return self._of_columns(rows) if rows else None

    def _of_columns(self, rows: Sequence[Sequence[Value]]) -> list[list[Value]]:
        columns = [self._projected(column) for column in zip(*rows, strict=True)]
        return [list(row) for row in zip(*columns, strict=True)]

    def _projected(self, values: Sequence[Value]) -> list[Value]:
        """S' times a vector."""
        return [
            reduce(add, (values[joint] * share for joint, share in shares))
            for shares in self.shares
        ]


def rigid_bodies(
    network: CSLC, k: Float[np.ndarray, " coefficients"]
) -> Iterator[Callable[[Motion], RigidBodies]]:
    """Yield the ways to compute the rigid-body part, each a function of the joints' motion.

    By recursion over bodies, with which a payload is one; and by tables, which it is added to.
    """
    algebra, projection = network.algebra, JointProjection.of(network.robot)
    joints = range(algebra.robot.joint_count)
    shares = tuple(((i, 1.0),) for i in joints) if projection is None else projection.shares
    inertial, payload = k[network.layout.inertial].tolist(), _payload(network)
    carried = k[network.layout.payload].tolist() if payload is not None else []

    def with_payload(
        motion: Motion, bodies: AbstractExpressedBodies
    ) -> list[AbstractExpressedBodies]:
        return [bodies] if payload is None else [bodies, payload.expressed(motion)]

    def by_recursion(motion: Motion) -> RigidBodies:
        assert linked is not None
        columns: list[AbstractExpressedBodies] = []
        if algebra.lengths == "numeric":
            of_network = RigidBodyRecursion.from_algebra(algebra).expressed(motion)
            columns = with_payload(motion, of_network)
        sizes = len(inertial), len(carried)
        addend = _one_by_one(algebra.robot, motion), linked
        return RigidBodies((addend,), tuple(zip(columns, sizes, strict=False)), shares)

    def by_tables(motion: Motion) -> RigidBodies:
        bodies = with_payload(motion, ClosedForm(motion, algebra))
        addends = tuple(zip(bodies, (inertial, carried), strict=False))
        return RigidBodies(addends, tuple((x, len(of_x)) for x, of_x in addends), shares)

    def of_all(make: Callable[[Motion], RigidBodies]) -> Callable[[Motion], RigidBodies]:
        if projection is None:
            return make
        onto = projection
        return lambda motion: make(projected_motion(motion, onto))

    linked = body_numbers(network, k)
    if linked is not None:
        yield of_all(by_recursion)
    if network.rigid_body.has_tables:
        yield of_all(by_tables)


def _payload(network: CSLC) -> RigidBodyRecursion | None:
    payload = network.payload
    term = payload.term if isinstance(payload, ProjectedTerm) else payload
    assert term is None or isinstance(term, RigidBodyRecursion)
    return term


def projected_motion(motion: Motion, projection: JointProjection) -> Motion:
    """Return the motion of all joints, as expressions of that of the independent ones."""
    whole = copy(motion)
    rows = list(zip(projection.matrix, projection.offset, strict=True))

    def of_all(values: Sequence[Value], with_offset: bool) -> list[Value]:
        return [
            reduce(add, (x * share for x, share in zip(values, row, strict=True) if share))
            + (offset if with_offset else 0.0)
            for row, offset in rows
        ]

    whole.q, whole.qd = of_all(motion.q, True), of_all(motion.qd, False)
    whole.qdd = of_all(motion.qdd, False)
    return whole


def _one_by_one(robot: Manipulator, motion: Motion) -> RecursiveBodies:
    """Bodies whose coefficients are ten numbers of each link, then the motors' inertias."""
    n, size = robot.joint_count, len(BODY)
    unit = tuple(map(tuple, np.eye(size).tolist()))
    indices = tuple(tuple(range(size * i, size * (i + 1))) for i in range(n))
    motors = tuple((i, size * n + i) for i in range(n))
    return RigidBodyRecursion.from_bodies(robot, (unit,) * n, indices, motors).expressed(motion)


def body_numbers(network: CSLC, k: Float[np.ndarray, " coefficients"]) -> list[float] | None:
    """Return numbers of bodies that have these coefficients, payload included.

    In the order of `_one_by_one`, most of them zero. Bodies need not be possible: what is regrouped
    into a base parameter is zero. None if no numbers have the coefficients: symbolic ones that were
    identified one by one are rarely consistent, and bodies of known masses (C.1.2) are not looked
    for.
    """
    algebra, size = network.algebra, len(BODY)
    n, inertial = algebra.robot.joint_count, k[network.layout.inertial]
    links, motors = np.zeros((n, size)), np.zeros(n)
    if algebra.lengths == "numeric":
        for value, unit in zip(inertial, algebra.unit_inertias, strict=True):
            links[unit.link] += value * np.array(unit.body)
            motors[unit.link] += value * unit.motor
    elif any(inertia.has_known for inertia in network.robot.inertia):
        return None
    else:
        numbers = _basic_solution(network, inertial)
        if numbers is None:
            return None
        links, motors = numbers[: size * n].reshape(n, size), numbers[size * n :]
    if network.carrying_link is not None:
        links[network.carrying_link - 1] += k[network.layout.payload]
    return [*links.ravel().tolist(), *motors.tolist()]


def _basic_solution(
    network: CSLC, inertial: Float[np.ndarray, " inertial"]
) -> Float[np.ndarray, " numbers"] | None:
    """Return as many numbers of links and motors as their matrix has rank, others zero."""
    from scipy.linalg import qr

    of_bodies, of_motors = body_map(network.algebra)
    matrix = np.concatenate([of_bodies.reshape(len(inertial), -1), of_motors], axis=1)
    # Later numbers are preferred last.
    _, _, order = qr(matrix, mode="economic", pivoting=True)
    rank = numerical_rank(matrix)
    numbers = np.zeros(matrix.shape[1])
    numbers[order[:rank]] = np.linalg.lstsq(matrix[:, order[:rank]], inertial)[0]
    exact = np.max(np.abs(matrix @ numbers - inertial)) <= _ROUNDING * np.max(np.abs(inertial))
    return numbers if exact else None
