import abc
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import reduce
from operator import add

import numpy as np
from jaxtyping import Float

from .._rank import numerical_rank
from ..codegen import Motion, Value
from ..derivation import BODY, NewtonEuler
from ..inertia import body_map
from ..network import CSLC
from ..network.terms import JointProjection
from ..network.terms.rigid_body import ClosedForm, newton_euler


# Coefficients that bodies can have are reproduced by bodies to this part of the largest.
_ROUNDING = 1e-13


class AbstractRigidBody(abc.ABC):
    """The rigid-body part of a network, payload included, as expressions of the joints' motion."""

    @abc.abstractmethod
    def torque(self) -> list[Value]:
        """Of every joint."""

    @abc.abstractmethod
    def mass_matrix(self) -> list[list[Value]]:
        """Row by row."""

    @abc.abstractmethod
    def gravity(self) -> list[Value]:
        """Torque of every joint at rest."""

    @abc.abstractmethod
    def regressor(self) -> list[list[Value]] | None:
        """A row a joint: columns of the inertial coefficients, then of the payload's.

        None where the coefficients are not those of bodies.
        """


@dataclass(frozen=True)
class Bodies:
    """Inertia of a robot with certain coefficients.

    **Attributes**

    - `links`: ten numbers of each link, in the order of `BODY`, about its frame.
    - `motors`: the inertia that each joint adds to its own.
    - `payload`: like `links`, of what they carry.
    """

    links: Float[np.ndarray, "links 10"]
    motors: Float[np.ndarray, " links"]
    payload: Float[np.ndarray, "links 10"]


class RecursiveRigidBody(AbstractRigidBody):
    """Newton-Euler recursion, unrolled. A payload is one body with the link that carries it."""

    def __init__(self, motion: Motion, network: CSLC, bodies: Bodies) -> None:
        self._motion, self._network = motion, network
        self._links = (bodies.links + bodies.payload).tolist()
        self._motors = bodies.motors.tolist()
        self._recursion = _recursion(motion, network)

    def torque(self) -> list[Value]:
        motion = self._motion
        return motion.values(
            self._recursion.torque(self._links, self._motors, motion.qd, motion.qdd)
        )

    def mass_matrix(self) -> list[list[Value]]:
        rows = self._recursion.mass_matrix(self._links, self._motors)
        return [self._motion.values(row) for row in rows]

    def gravity(self) -> list[Value]:
        return self._motion.values(self._recursion.gravity_torque(self._links))

    def regressor(self) -> list[list[Value]] | None:
        network, motion = self._network, self._motion
        if network.algebra.lengths != "numeric":
            return None
        units = network.algebra.unit_inertias
        bodies = [(unit.link, unit.body) for unit in units] + _payload_units(network)
        rows = self._recursion.columns(bodies, motion.qd, motion.qdd)
        for column, unit in enumerate(units):
            if unit.motor:
                rows[unit.link][column] = motion.qdd[unit.link]
        return [motion.values(row) for row in rows]


class TabulatedRigidBody(AbstractRigidBody):
    """The closed form of the tables, and Newton-Euler recursion for a payload."""

    def __init__(
        self, motion: Motion, network: CSLC, k: Float[np.ndarray, " coefficients"]
    ) -> None:
        self._motion, self._network = motion, network
        self._k = k[network.layout.inertial]
        self._tables = ClosedForm(motion, network.algebra)
        self._recursion = _recursion(motion, network)
        payload = payload_bodies(network, k)
        self._payload = payload.tolist() if np.any(payload) else None

    def torque(self) -> list[Value]:
        total, motion = self._tables.torque(self._k), self._motion
        if self._payload is None:
            return total
        still = [0.0] * len(total)
        added = self._recursion.torque(self._payload, still, motion.qd, motion.qdd)
        return [x + y for x, y in zip(total, added, strict=True)]

    def mass_matrix(self) -> list[list[Value]]:
        total = self._tables.mass_matrix(self._k)
        if self._payload is None:
            return total
        added = self._recursion.mass_matrix(self._payload, [0.0] * len(total))
        return [
            [x + y for x, y in zip(row, other, strict=True)]
            for row, other in zip(total, added, strict=True)
        ]

    def gravity(self) -> list[Value]:
        total = self._tables.torque(self._k, ("gravity",))
        if self._payload is None:
            return total
        added = self._recursion.gravity_torque(self._payload)
        return [x + y for x, y in zip(total, added, strict=True)]

    def regressor(self) -> list[list[Value]] | None:
        motion, size = self._motion, len(self._network.algebra.coefficients)
        entries, zero = self._tables.entries(), motion.graph.constant(0.0)
        added = self._recursion.columns(_payload_units(self._network), motion.qd, motion.qdd)
        return [
            [*(entries.get((j, p), zero) for p in range(size)), *motion.values(other)]
            for j, other in enumerate(added)
        ]


def _recursion(motion: Motion, network: CSLC) -> NewtonEuler:
    robot = network.algebra.robot
    return newton_euler(motion, robot.joints, robot.parents, robot.gravity)


class ProjectedRigidBody(AbstractRigidBody):
    """The rigid-body part of all joints as that of the joints that follow none.

    **Attributes**

    - `rigid_body`: of all joints, `motion` of which is `projected_motion`.
    - `projection`: onto the independent joints.
    """

    def __init__(self, rigid_body: AbstractRigidBody, projection: JointProjection) -> None:
        self.rigid_body, self._shares = rigid_body, projection.shares

    def torque(self) -> list[Value]:
        return self._projected(self.rigid_body.torque())

    def mass_matrix(self) -> list[list[Value]]:
        rows = [self._projected(row) for row in self.rigid_body.mass_matrix()]
        columns = [self._projected(list(column)) for column in zip(*rows, strict=True)]
        return [list(row) for row in zip(*columns, strict=True)]

    def gravity(self) -> list[Value]:
        return self._projected(self.rigid_body.gravity())

    def regressor(self) -> list[list[Value]] | None:
        rows = self.rigid_body.regressor()
        if rows is None:
            return None
        columns = [self._projected(list(column)) for column in zip(*rows, strict=True)]
        return [list(row) for row in zip(*columns, strict=True)]

    def _projected(self, values: Sequence[Value]) -> list[Value]:
        """S' times a vector."""
        return [
            reduce(add, (values[joint] * share for joint, share in shares))
            for shares in self._shares
        ]


def projected_motion(motion: Motion, projection: JointProjection) -> Motion:
    """Motion of all joints, as expressions of that of the independent ones."""
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


def payload_bodies(
    network: CSLC, k: Float[np.ndarray, " coefficients"]
) -> Float[np.ndarray, "links 10"]:
    """The payload's ten numbers, at the link that carries it."""
    bodies = np.zeros((network.robot.joint_count, 10))
    if network.carrying_link is not None:
        bodies[network.carrying_link - 1] = k[network.layout.payload]
    return bodies


def _payload_units(network: CSLC) -> list[tuple[int, tuple[int | float, ...]]]:
    """For each of the payload's coefficients, the link that carries it and ten numbers."""
    if network.carrying_link is None:
        return []
    size = len(BODY)
    return [
        (network.carrying_link - 1, tuple(int(i == j) for j in range(size))) for i in range(size)
    ]


def bodies_of_coefficients(network: CSLC, k: Float[np.ndarray, " coefficients"]) -> Bodies | None:
    """Links and motors that have these coefficients, most of their numbers zero.

    They need not be possible bodies: what is regrouped into a base parameter is zero. None if no
    numbers have them: symbolic coefficients that were identified one by one are rarely consistent,
    and bodies of known masses (C.1.2) are not looked for.
    """
    n, algebra = network.robot.joint_count, network.algebra
    inertial = k[network.layout.inertial]
    links, motors = np.zeros((n, 10)), np.zeros(n)
    if algebra.lengths == "numeric":
        for value, unit in zip(inertial, algebra.unit_inertias, strict=True):
            links[unit.link] += value * np.array(unit.body)
            motors[unit.link] += value * unit.motor
        return Bodies(links, motors, payload_bodies(network, k))
    if any(inertia.has_known for inertia in network.robot.inertia):
        return None
    from scipy.linalg import qr

    of_bodies, of_motors = body_map(algebra)
    matrix = np.concatenate([of_bodies.reshape(len(inertial), -1), of_motors], axis=1)
    # A basic solution: as many numbers as the matrix has rank. Later ones are preferred last.
    _, _, order = qr(matrix, mode="economic", pivoting=True)
    rank = numerical_rank(matrix)
    basic = np.linalg.lstsq(matrix[:, order[:rank]], inertial)[0]
    numbers = np.zeros(matrix.shape[1])
    numbers[order[:rank]] = basic
    if np.max(np.abs(matrix @ numbers - inertial)) > _ROUNDING * np.max(np.abs(inertial)):
        return None
    links, motors = numbers[: 10 * n].reshape(n, 10), numbers[10 * n :]
    return Bodies(links, motors, payload_bodies(network, k))
