"""Terms whose coefficients multiply closed-form inputs, and the functions for these inputs.

One formula serves JAX's arrays (`JAX_FUNCTIONS`), NumPy's (`HOST_FUNCTIONS`) and the expressions
of `_input_expressions`.
"""

import abc
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._term import AbstractManipulatorTerm, Coefficients, Joints, Matrices


class AbstractFunctions(abc.ABC):
    """Functions of one number that a term's inputs are written with.

    Sums, differences, products, whole powers and quotients by numbers are plain operators. One
    formula, written with these, computes arrays in JAX (`JAX_FUNCTIONS`) and becomes C code
    (`jaxcslc.export`).
    """

    @abc.abstractmethod
    def constant(self, number: Any, like: Any) -> Any:
        """A number as a value of the kind and shape of `like`."""

    @abc.abstractmethod
    def sign(self, x: Any) -> Any:
        """-1, 0 or 1."""

    @abc.abstractmethod
    def absolute(self, x: Any) -> Any: ...

    @abc.abstractmethod
    def positive(self, x: Any) -> Any:
        """The greater of x and 0."""

    @abc.abstractmethod
    def negative(self, x: Any) -> Any:
        """The lesser of x and 0."""

    @abc.abstractmethod
    def sqrt(self, x: Any) -> Any:
        """Square root; at 0 its derivative counts as 0."""

    @abc.abstractmethod
    def exp(self, x: Any) -> Any: ...

    @abc.abstractmethod
    def tanh(self, x: Any) -> Any: ...

    @abc.abstractmethod
    def sin(self, x: Any) -> Any: ...

    @abc.abstractmethod
    def cos(self, x: Any) -> Any: ...

    @abc.abstractmethod
    def rigid_torque(
        self, rigid: Any, k: Any, q: Sequence[Any], qd: Sequence[Any], qdd: Sequence[Any]
    ) -> list[Any]:
        """Compute every joint's torque of links and motors: `rigid`, with coefficients `k`."""


class _ArrayFunctions(AbstractFunctions):
    """Functions of arrays of any shape, by NumPy or by JAX's NumPy."""

    def __init__(self, namespace: Any) -> None:
        self._xp = namespace

    def constant(self, number: Any, like: Any) -> Any:
        return self._xp.full_like(like, number)

    def sign(self, x: Any) -> Any:
        return self._xp.sign(x)

    def absolute(self, x: Any) -> Any:
        return self._xp.abs(x)

    def positive(self, x: Any) -> Any:
        return self._xp.maximum(x, 0.0)

    def negative(self, x: Any) -> Any:
        return self._xp.minimum(x, 0.0)

    def sqrt(self, x: Any) -> Any:
        # The root of 0 has no derivative, and 0 times infinity is no number: 1 stands in for it.
        where = self._xp.where
        return where(x > 0, self._xp.sqrt(where(x > 0, x, 1.0)), 0.0)

    def exp(self, x: Any) -> Any:
        return self._xp.exp(x)

    def tanh(self, x: Any) -> Any:
        return self._xp.tanh(x)

    def sin(self, x: Any) -> Any:
        return self._xp.sin(x)

    def cos(self, x: Any) -> Any:
        return self._xp.cos(x)

    def rigid_torque(
        self, rigid: Any, k: Any, q: Sequence[Any], qd: Sequence[Any], qdd: Sequence[Any]
    ) -> list[Any]:
        motion = (jnp.stack([jnp.asarray(x) for x in values], axis=-1) for values in (q, qd, qdd))
        return by_joint(rigid.torque(jnp.asarray(k), *motion))


JAX_FUNCTIONS = _ArrayFunctions(jnp)
"""The functions of JAX, elementwise on arrays."""
HOST_FUNCTIONS = _ArrayFunctions(np)
"""Those of NumPy."""


class AbstractInputTerm(AbstractManipulatorTerm):
    """A term whose coefficients multiply inputs that are written in closed form, joint by joint.

    All but rigid bodies: friction, torque offsets, springs, coupled joints. Other programs than
    JAX's evaluate the same inputs (C code, adaptive networks).

    **Attributes**

    - `joint_count`: n of the robot.
    """

    joint_count: eqx.AbstractVar[int]

    @property
    @abc.abstractmethod
    def input_joints(self) -> tuple[int, ...]:
        """The joint whose torque each input enters, from 0."""

    @property
    @abc.abstractmethod
    def input_indices(self) -> tuple[int, ...]:
        """Index of the term's coefficient that multiplies each input."""

    @property
    @abc.abstractmethod
    def keyword(self) -> str:
        """The argument of `CSLC.coefficients_from` that the coefficients are part of."""

    @property
    @abc.abstractmethod
    def value_shape(self) -> tuple[int, ...]:
        """The shape of that argument."""

    @property
    @abc.abstractmethod
    def value_index(self) -> tuple[tuple[int, ...], ...]:
        """Position of each coefficient in that argument, as an index of an array."""

    @property
    @abc.abstractmethod
    def value_meaning(self) -> str:
        """Meaning of that argument's entries, for messages."""

    @abc.abstractmethod
    def inputs(
        self, functions: AbstractFunctions, q: Sequence[Any], qd: Sequence[Any], qdd: Sequence[Any]
    ) -> list[Any]:
        """Compute one value per entry of `input_joints`, from motion with one entry per joint.

        Entries are whatever `functions` works on.
        """

    @property
    @abc.abstractmethod
    def inertia_matrices(self) -> Float[np.ndarray, "coefficients joints joints"]:
        """Factor of each coefficient in the mass matrix."""

    @property
    def has_host_columns(self) -> bool:
        return True

    @property
    def support(self) -> tuple[tuple[int, ...], ...]:
        reach: list[list[int]] = [[] for _ in range(self.joint_count)]
        for joint, index in zip(self.input_joints, self.input_indices, strict=True):
            reach[joint].append(index)
        return tuple(tuple(sorted(indices)) for indices in reach)

    def mass_matrix(self, k: Coefficients, q: Joints) -> Matrices:
        matrix = jnp.tensordot(k, jnp.asarray(self.inertia_matrices, k.dtype), 1)
        return jnp.broadcast_to(matrix, (*q.shape, self.joint_count))

    def velocity_term(self, k: Coefficients, q: Joints, qd: Joints) -> Joints:
        del k, qd
        return jnp.zeros_like(q)

    def gravity_term(self, k: Coefficients, q: Joints) -> Joints:
        del k
        return jnp.zeros_like(q)


def by_joint(x: Float[Array, "*batch joints"]) -> list[Float[Array, "*batch"]]:
    """Split an array into one array per joint."""
    return [x[..., joint] for joint in range(x.shape[-1])]
