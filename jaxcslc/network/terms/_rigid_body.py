"""Quantities of rigid bodies in any form of their equations, and the rigid-body term of a network.

A form of the equations is a subclass of `AbstractExpressedBodies`: torque, mass matrix and entries
of the regressor as expressions of a motion. `codegen` turns these into arrays of JAX or NumPy, C or
CUDA. `AbstractRigidBody` is the term whose values they are.
"""

import abc
from collections.abc import Collection, Iterator, Sequence
from functools import lru_cache
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxcslc.codegen import CompiledProgram, Motion, StraightLine, Value

from ._term import AbstractManipulatorTerm, Coefficients, Columns, Joints, Regressor, Rows


PARTS = ("mass", "velocity", "gravity")
"""Sums of the equation of motion that rigid bodies belong to (Eqn. 2.5-2)."""


class AbstractExpressedBodies(abc.ABC):
    """Dynamics of rigid bodies as expressions of their joints' motion.

    Coefficients `k` are numbers, or expressions.
    """

    motion: Motion

    @abc.abstractmethod
    def torque(self, k: Any, parts: Collection[str] = PARTS) -> list[Value]:
        """Return the torque of every joint, or some parts of it."""

    @abc.abstractmethod
    def mass_matrix(self, k: Any) -> list[list[Value]]:
        """Return the mass matrix row by row."""

    @abc.abstractmethod
    def entries(self) -> dict[tuple[int, int], Value]:
        """Return the regressor's entries that are not always zero, by joint and coefficient."""


class AbstractRigidBody(AbstractManipulatorTerm):
    """The rigid-body term of a network, whatever form its equations have."""

    @property
    @abc.abstractmethod
    def has_tables(self) -> bool:
        """True if the closed form is small enough to be computed from its tables."""

    @abc.abstractmethod
    def expressed(self, motion: Motion) -> AbstractExpressedBodies:
        """Return the term as expressions of a motion."""

    @abc.abstractmethod
    def _values(
        self, quantity: str, k: Coefficients | None, *motion: Joints
    ) -> Float[Array, "*batch values"]:
        """A quantity of `code`, of positions, velocities and accelerations as far as it needs them.

        In the order of its outputs.
        """

    @abc.abstractmethod
    def _column_rows(self, q: Rows, qd: Rows, qdd: Rows) -> Float[Array, "rows samples"]:
        """The columns of all joints, of JAX's arrays."""

    @property
    def parts(self) -> tuple[str, ...]:
        return PARTS

    @property
    def has_host_columns(self) -> bool:
        return True

    def entries(self, motion: Motion) -> Iterator[tuple[int, int, Value]]:
        """Joint, coefficient and value of the regressor's entries, as expressions."""
        for (joint, index), value in self.expressed(motion).entries().items():
            yield joint, index, value

    def columns(self, q: Rows, qd: Rows, qdd: Rows) -> Columns:
        ends = np.cumsum([len(support) for support in self.support])[:-1]
        if isinstance(q, np.ndarray):
            return tuple(np.split(program(self)(q, np.asarray(qd), np.asarray(qdd)), ends))
        return tuple(jnp.split(self._column_rows(q, qd, qdd), ends))

    def write_columns(
        self, into: Sequence[Float[np.ndarray, "_ samples"]], q: Rows, qd: Rows, qdd: Rows
    ) -> None:
        rows = [row for of_joint in into for row in of_joint]
        program(self).write(rows, np.asarray(q), np.asarray(qd), np.asarray(qdd))

    def regressor(self, q: Joints, qd: Joints, qdd: Joints) -> Regressor:
        if self.size == 0:
            return jnp.zeros((*q.shape, 0), q.dtype)
        return self._values("regressor", None, q, qd, qdd).reshape(*q.shape, self.size)

    def torque(self, k: Coefficients, q: Joints, qd: Joints, qdd: Joints) -> Joints:
        return self._values("torque", k, q, qd, qdd)

    def part(self, quantity: str, k: Coefficients, *motion: Joints) -> Float[Array, "..."]:
        values, n = self._values(quantity, k, *motion), motion[0].shape[-1]
        return values.reshape(*motion[0].shape, n) if quantity == "mass_matrix" else values


@lru_cache(maxsize=256)  # terms without arrays, which are compared by their tables or bodies
def code(term: AbstractRigidBody, quantity: str) -> StraightLine:
    """Return the expressions of a quantity.

    - `quantity`: `"torque"`; of it what `"velocity"` and `"gravity"` cause; `"mass_matrix"`, row by
      row; `"regressor"`, row by row; `"columns"` in the term's support, joint by joint.
    """
    support = term.support
    motion = Motion(len(support))
    graph, bodies = motion.graph, term.expressed(motion)
    if quantity in ("regressor", "columns"):
        entries, zero = bodies.entries(), graph.constant(0.0)
        rows = support if quantity == "columns" else [range(term.size)] * len(support)
        values = [entries.get((i, index), zero) for i, row in enumerate(rows) for index in row]
    else:
        k = graph.inputs("k", term.size)
        if quantity == "mass_matrix":
            values = [value for row in bodies.mass_matrix(k) for value in row]
        else:
            values = bodies.torque(k, PARTS if quantity == "torque" else (quantity,))
    return StraightLine(motion, tuple(motion.values(values)))


@lru_cache(maxsize=64)
def program(term: AbstractRigidBody) -> CompiledProgram:
    """Return the columns of all joints, one behind the other, for NumPy's arrays."""
    columns = code(term, "columns")
    return CompiledProgram(columns.motion, columns.outputs)
