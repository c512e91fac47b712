from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..codegen import Expressions, Motion, Value
from ..identification.friction import state_after
from ..network import CSLC
from ..network.terms import ExpressionFunctions
from ._c_inputs import input_entries, input_inertias
from ._rigid_body import RigidBodies, rigid_bodies


@dataclass(frozen=True)
class Dynamics:
    """What an operation is computed from: a network with coefficients, and one way to compute it.

    **Attributes**

    - `network`, `k`: (p,) its coefficients.
    - `motion`: the joints' positions, velocities and accelerations.
    - `rigid_body`: the rigid-body part, payload included.
    - `lengths`: (n,) of pre-sliding [rad or m]; 0 where dry friction follows the sign of velocity.
    """

    network: CSLC
    k: Float[np.ndarray, " coefficients"]
    motion: Motion
    rigid_body: RigidBodies
    lengths: Float[np.ndarray, " joints"]

    @property
    def contacts(self) -> dict[int, Value]:
        """By joint, the state of a contact that yields before it slides."""
        joints = np.flatnonzero(self.lengths).tolist()
        return {joint: self.motion.graph.input(f"w[{joint}]") for joint in joints}


def torque(dynamics: Dynamics) -> list[Value]:
    total = dynamics.rigid_body.torque()
    entries = input_entries(dynamics.network, dynamics.motion, dynamics.contacts)
    for joint, index, value in entries:
        total[joint] = total[joint] + value * float(dynamics.k[index])
    return total


def mass_matrix(dynamics: Dynamics) -> list[Value]:
    rows = dynamics.rigid_body.mass_matrix()
    for i, j, value in input_inertias(dynamics.network, dynamics.k):
        rows[i][j] = rows[i][j] + value
        rows[j][i] = rows[i][j]
    return [value for row in rows for value in row]


def gravity(dynamics: Dynamics) -> list[Value]:
    return dynamics.rigid_body.torque(("gravity",))


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
    for joint, index, value in input_entries(network, motion, dynamics.contacts):
        rows[joint][index] = rows[joint][index] + value
    return [value for row in rows for value in row]


def pre_sliding(dynamics: Dynamics) -> list[Value]:
    motion, functions = dynamics.motion, ExpressionFunctions(dynamics.motion)
    states = [motion.graph.constant(0.0)] * dynamics.network.joint_count
    for joint, w in dynamics.contacts.items():
        change = motion.graph.input(f"dq[{joint}]")
        states[joint] = state_after(w, change, float(dynamics.lengths[joint]), functions)
    return states


@dataclass(frozen=True)
class Operation:
    """One function of the C code.

    **Attributes**

    - `name`: of the function, after the robot's.
    - `summary`: the comment above it.
    - `inputs`: which of `q`, `qd`, `qdd` it takes.
    - `output`: name of the array that it fills.
    - `values`: what it fills it with; None where `Dynamics.rigid_body` cannot say.
    - `has_friction`: whether it takes states of contacts, too, where there are any.
    """

    name: str
    summary: str
    inputs: tuple[str, ...]
    output: str
    values: Callable[[Dynamics], list[Value] | None]
    has_friction: bool = False


OPERATIONS = (
    Operation(
        "torque", "Torque of every joint.", ("q", "qd", "qdd"), "tau", torque, has_friction=True
    ),
    Operation("mass_matrix", "Mass matrix, row by row.", ("q",), "mass", mass_matrix),
    Operation("gravity", "Torque of every joint against gravity.", ("q",), "tau", gravity),
    Operation(
        "regressor",
        "What the coefficients are multiplied by: joint by joint, one entry a coefficient.",
        ("q", "qd", "qdd"),
        "regressor",
        regressor,
        has_friction=True,
    ),
)
"""What the C code of every network offers: a new function is one entry and what computes it."""

STATE_OPERATIONS = (
    Operation(
        "pre_sliding",
        "States of contacts after joints moved by dq. Both states may be one array.",
        ("dq", "w"),
        "next",
        pre_sliding,
    ),
)
"""What it offers where dry friction yields before it slides."""


@dataclass(frozen=True)
class CFunction:
    """An operation with its inputs and expressions."""

    operation: Operation
    inputs: tuple[str, ...]
    graph: Expressions
    values: list[Value]

    @property
    def cost(self) -> int:
        """Additions, multiplications and calls of functions."""
        return self.graph.cost(self.values)

    @property
    def is_finite(self) -> bool:
        """Whether all constants are numbers that C can write."""
        operations = self.graph.operations
        return all(np.isfinite(operations[i].number) for i in self.graph.needed(self.values))


def c_functions(
    network: CSLC,
    k: Float[np.ndarray, " coefficients"],
    lengths: Float[np.ndarray, " joints"],
) -> list[CFunction]:
    """Every operation, computed in the way that needs the fewest operations."""
    ways = list(rigid_bodies(network, k))
    yields = bool(np.any(lengths))
    functions: list[CFunction] = []
    for operation in (*OPERATIONS, *(STATE_OPERATIONS if yields else ())):
        inputs = (*operation.inputs, *(("w",) if yields and operation.has_friction else ()))
        candidates: list[CFunction] = []
        for rigid_body in ways:
            motion = Motion(network.joint_count)
            with np.errstate(over="ignore", invalid="ignore"):  # refused below
                values = operation.values(Dynamics(network, k, motion, rigid_body(motion), lengths))
            if values is not None:
                candidates.append(CFunction(operation, inputs, motion.graph, values))
        function = min(candidates, key=lambda candidate: candidate.cost)
        if not function.is_finite:
            raise ValueError(
                f"{operation.name}: a constant overflows; expected coefficients and lengths whose"
                " products and reciprocals are finite numbers"
            )
        functions.append(function)
    return functions
