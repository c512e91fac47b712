"""Expressions of the dynamics of linked bodies: torque, mass matrix, columns of the regressor."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from ....codegen import Expressions, Motion, StraightLine, Value
from ....manipulator import Joint
from ._recursion import newton_euler


@dataclass(frozen=True)
class LinkedBodies:
    """A chain or tree of bodies whose ten numbers are linear functions of coefficients.

    **Attributes**

    - `joints`, `parents`, `gravity`: of the robot; a parent of -1 is the base.
    - `body`: for every link, the matrix (10, coefficients of the link) from its coefficients to
      its numbers, in the order of `BODY`.
    - `indices`: for every link, its coefficients.
    - `motors`: a joint and the coefficient of its motor's inertia, each.
    """

    joints: tuple[Joint, ...]
    parents: tuple[int, ...]
    gravity: tuple[float, float, float]
    body: tuple[tuple[tuple[float, ...], ...], ...]
    indices: tuple[tuple[int, ...], ...]
    motors: tuple[tuple[int, int], ...]

    def numbers(self, graph: Expressions) -> tuple[list[list[Any]], list[Any]]:
        """Every link's ten numbers and every motor's inertia, of inputs `k[0]`, `k[1]`, ..."""
        k: dict[int, Value] = {}
        for index in sorted({*sum(self.indices, ()), *(index for _, index in self.motors)}):
            k[index] = graph.input(f"k[{index}]")
        bodies: list[list[Any]] = []
        for rows, indices in zip(self.body, self.indices, strict=True):
            sums = [
                [k[index] * factor for index, factor in zip(indices, row, strict=True) if factor]
                for row in rows
            ]
            bodies.append([sum(terms[1:], terms[0]) if terms else 0.0 for terms in sums])
        motors: list[Any] = [0.0] * len(self.joints)
        for joint, index in self.motors:
            motors[joint] = k[index]
        return bodies, motors


@lru_cache(maxsize=64)
def torque_code(
    bodies: LinkedBodies, *, rates: bool = True, accelerations: bool = True
) -> StraightLine:
    """Torque of every joint; of one at rest, or at a constant velocity."""
    motion = Motion(len(bodies.joints))
    still = [0.0] * len(bodies.joints)
    recursion = newton_euler(motion, bodies.joints, bodies.parents, bodies.gravity)
    values = recursion.torque(
        *bodies.numbers(motion.graph),
        motion.qd if rates else still,
        motion.qdd if accelerations else still,
    )
    return StraightLine(motion, tuple(motion.values(values)))


@lru_cache(maxsize=64)
def mass_matrix_code(bodies: LinkedBodies) -> StraightLine:
    """The mass matrix, row by row."""
    motion = Motion(len(bodies.joints))
    recursion = newton_euler(motion, bodies.joints, bodies.parents, bodies.gravity)
    rows = recursion.mass_matrix(*bodies.numbers(motion.graph))
    return StraightLine(motion, tuple(v for row in rows for v in motion.values(row)))


@lru_cache(maxsize=64)
def columns_code(bodies: LinkedBodies, entries: tuple[tuple[int, int], ...]) -> StraightLine:
    """Entries (joint, coefficient) of the regressor."""
    motion = Motion(len(bodies.joints))
    rows = regressor_rows(motion, bodies)
    zero = motion.graph.constant(0.0)
    return StraightLine(motion, tuple(rows[joint].get(index, zero) for joint, index in entries))


def regressor_rows(motion: Motion, bodies: LinkedBodies) -> list[dict[int, Value]]:
    """For each joint the entries of the regressor that are not always zero, by coefficient."""
    recursion = newton_euler(motion, bodies.joints, bodies.parents, bodies.gravity)
    units = [
        (link, index, [row[column] for row in bodies.body[link]])
        for link, indices in enumerate(bodies.indices)
        for column, index in enumerate(indices)
    ]
    torques = recursion.columns([(link, unit) for link, _, unit in units], motion.qd, motion.qdd)
    rows: list[dict[int, Value]] = []
    for of_joint in torques:
        values = motion.values(of_joint)
        row = {index: x for (_, index, _), x in zip(units, values, strict=True) if not x.is_zero}
        rows.append(row)
    for joint, index in bodies.motors:
        rows[joint][index] = motion.qdd[joint]
    return rows
