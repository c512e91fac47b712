"""Base classes of terms: addends of a network's outputs, linear in coefficients of their own."""

import abc
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from jaxcslc.derivation import Coefficient


Coefficients = Float[Array, " coefficients"]
Joints = Float[Array, "*batch joints"]
Matrices = Float[Array, "*batch joints joints"]
Regressor = Float[Array, "*batch joints coefficients"]
Rows = Float[Array | np.ndarray, "joints samples"]
Columns = tuple[Float[Array | np.ndarray, "_ samples"], ...]


class AbstractTerm(eqx.Module):
    """Addend of the outputs of a network, linear in coefficients of its own.

    A network is a sum of terms (`CSLC.terms`); `network.layout` says where in `k` each one's
    coefficients are. Every method takes and returns the term's own coefficients only. Positions,
    velocities and accelerations have any leading batch axes, (..., n) in rad (or m), per s and
    per s². What the outputs are not linear in is an array leaf of the term.

    **Attributes**

    - `kind`: its name, which no other term of a network has: `"rigid_body"`,
      `"viscous"`, `"coupled_inertia"`, `"payload"`.
    - `coefficients`: names, groups, expressions and units, in the term's order.
    """

    kind: eqx.AbstractVar[str]
    coefficients: eqx.AbstractVar[tuple[Coefficient, ...]]

    @property
    @abc.abstractmethod
    def parts(self) -> tuple[str, ...]:
        """Sums of the equation of motion (Eqn. 2.5-2) that the term belongs to.

        Some of `"mass"`, `"velocity"`, `"gravity"`, `"friction"` and `"spring"`.
        """

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return len(self.coefficients)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coefficients."""
        return tuple(coefficient.name for coefficient in self.coefficients)

    @property
    @abc.abstractmethod
    def support(self) -> tuple[tuple[int, ...], ...]:
        """Indices of the coefficients that each joint's torque can depend on, ascending."""

    @property
    def has_host_columns(self) -> bool:
        """True if `columns` computes NumPy's arrays by NumPy, so that nothing is compiled."""
        return False

    @property
    def at_any_motion(self) -> "AbstractTerm":
        """A term of the same columns that has them at any motion; of most terms itself."""
        return self

    @abc.abstractmethod
    def columns(self, q: Rows, qd: Rows, qdd: Rows) -> Columns:
        """Compute each joint's regressor columns in its `support`, as rows: (support, samples).

        Joints first, samples last, and nothing that is always zero: the shape that a
        factorisation of many patterns wants.
        """

    def write_columns(
        self, into: Sequence[Float[np.ndarray, "_ samples"]], q: Rows, qd: Rows, qdd: Rows
    ) -> None:
        """Write `columns` of NumPy's arrays into others of their shapes."""
        for rows, columns in zip(into, self.columns(q, qd, qdd), strict=True):
            rows[...] = columns

    @abc.abstractmethod
    def regressor(self, q: Joints, qd: Joints, qdd: Joints) -> Regressor:
        """Return the matrix that the coefficients are multiplied by, (..., n, coefficients)."""

    @abc.abstractmethod
    def torque(self, k: Coefficients, q: Joints, qd: Joints, qdd: Joints) -> Joints:
        """Return the term's share of the torque, (..., n) [N m or N]."""


class AbstractManipulatorTerm(AbstractTerm):
    """A term of a robot's inverse dynamics, which says what it adds to each part of them."""

    @abc.abstractmethod
    def part(self, quantity: str, k: Coefficients, *motion: Joints) -> Float[Array, "..."]:
        """Compute the term's share of a part of the dynamics.

        - `quantity`: `"mass_matrix"`, M(q) (..., n, n); `"velocity"`, V(q, qd) (..., n);
          `"gravity"`, G(q) (..., n).
        - `motion`: positions, for V velocities too.
        """


def content_hash(*values: Any) -> int:
    """Hash values, arrays by their numbers.

    `jax.jit(network.torque)` looks the method up by the hash of its terms, and arrays have none.
    """
    return hash(tuple(map(_hashable, values)))


def _hashable(value: Any) -> Any:
    if isinstance(value, Tracer):
        return id(value)
    if isinstance(value, np.ndarray | Array):
        numbers = np.asarray(value)
        return numbers.shape, numbers.tobytes()
    return value
