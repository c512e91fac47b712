from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..network import CSLC
from ..network.straight_line import Expressions, Motion, Value
from ..network.terms import JointProjection
from ._c_inputs import input_entries, input_inertias
from ._rigid_body import (
    AbstractRigidBody,
    ProjectedRigidBody,
    RecursiveRigidBody,
    TabulatedRigidBody,
    bodies_of_coefficients,
    projected_motion,
)


@dataclass(frozen=True)
class Dynamics:
    """What an operation is computed from: a network with coefficients, and one way to compute it.

    **Attributes**

    - `network`, `k`: (p,) its coefficients.
    - `motion`: the joints' positions, velocities and accelerations.
    - `rigid_body`: the rigid-body part, payload included.
    """

    network: CSLC
    k: Float[np.ndarray, " coefficients"]
    motion: Motion
    rigid_body: AbstractRigidBody


def torque(dynamics: Dynamics) -> list[Value]:
    total = dynamics.rigid_body.torque()
    for joint, index, value in input_entries(dynamics.network, dynamics.motion):
        total[joint] = total[joint] + value * float(dynamics.k[index])
    return total


def mass_matrix(dynamics: Dynamics) -> list[Value]:
    rows = dynamics.rigid_body.mass_matrix()
    for i, j, value in input_inertias(dynamics.network, dynamics.k):
        rows[i][j] = rows[i][j] + value
        rows[j][i] = rows[i][j]
    return [value for row in rows for value in row]


def gravity(dynamics: Dynamics) -> list[Value]:
    return dynamics.rigid_body.gravity()


def regressor(dynamics: Dynamics) -> list[Value] | None:
    network, motion = dynamics.network, dynamics.motion
    rigid = dynamics.rigid_body.regressor()
    if rigid is None:
        return None
    layout = network.layout
    rows = [[motion.graph.constant(0.0)] * layout.size for _ in rigid]
    inertial = layout.inertial.stop
    for row, values in zip(rows, rigid, strict=True):
        row[layout.inertial], row[layout.payload] = values[:inertial], values[inertial:]
    for joint, index, value in input_entries(network, motion):
        rows[joint][index] = rows[joint][index] + value
    return [value for row in rows for value in row]


@dataclass(frozen=True)
class Operation:
    """One function of the C code.

    **Attributes**

    - `name`: of the function, after the robot's.
    - `summary`: the comment above it.
    - `inputs`: which of `q`, `qd`, `qdd` it takes.
    - `output`: name of the array that it fills.
    - `values`: what it fills it with; None where `Dynamics.rigid_body` cannot say.
    """

    name: str
    summary: str
    inputs: tuple[str, ...]
    output: str
    values: Callable[[Dynamics], list[Value] | None]


OPERATIONS = (
    Operation("torque", "Torque of every joint.", ("q", "qd", "qdd"), "tau", torque),
    Operation("mass_matrix", "Mass matrix, row by row.", ("q",), "mass", mass_matrix),
    Operation("gravity", "Torque of every joint against gravity.", ("q",), "tau", gravity),
    Operation(
        "regressor",
        "What the coefficients are multiplied by: joint by joint, one entry a coefficient.",
        ("q", "qd", "qdd"),
        "regressor",
        regressor,
    ),
)
"""What the C code of every network offers: a new function is one entry and what computes it."""


@dataclass(frozen=True)
class CFunction:
    """An operation with its expressions."""

    operation: Operation
    graph: Expressions
    values: list[Value]

    @property
    def cost(self) -> int:
        """Additions, multiplications and calls of functions."""
        return self.graph.cost(self.values)


def c_functions(network: CSLC, k: Float[np.ndarray, " coefficients"]) -> list[CFunction]:
    """Every operation, computed in the way that needs the fewest operations."""
    rigid_bodies = _rigid_bodies(network, k)
    functions: list[CFunction] = []
    for operation in OPERATIONS:
        candidates: list[CFunction] = []
        for rigid_body in rigid_bodies:
            motion = Motion(network.joint_count)
            values = operation.values(Dynamics(network, k, motion, rigid_body(motion)))
            if values is not None:
                candidates.append(CFunction(operation, motion.graph, values))
        functions.append(min(candidates, key=lambda candidate: candidate.cost))
    return functions


def _rigid_bodies(
    network: CSLC, k: Float[np.ndarray, " coefficients"]
) -> list[Callable[[Motion], AbstractRigidBody]]:
    """The ways to compute the rigid-body part: by recursion over bodies, and by tables."""
    projection = JointProjection.of(network.robot)

    def candidates() -> Iterator[Callable[[Motion], AbstractRigidBody]]:
        bodies = bodies_of_coefficients(network, k)
        if bodies is not None:
            yield lambda motion: RecursiveRigidBody(motion, network, bodies)
        if network.rigid_body.has_tables:
            yield lambda motion: TabulatedRigidBody(motion, network, k)

    if projection is None:
        return list(candidates())
    return [_projected(rigid_body, projection) for rigid_body in candidates()]


def _projected(
    rigid_body: Callable[[Motion], AbstractRigidBody], projection: JointProjection
) -> Callable[[Motion], AbstractRigidBody]:
    return lambda motion: ProjectedRigidBody(
        rigid_body(projected_motion(motion, projection)), projection
    )
