"""Terms whose coefficients multiply closed-form inputs, and the functions for these inputs.

One formula serves JAX's arrays (`JAX_FUNCTIONS`), NumPy's (`HOST_FUNCTIONS`) and expressions of
generated code (`ExpressionFunctions`).
"""

import abc
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from jaxcslc._environment import array_namespace
from jaxcslc.codegen import Motion, Value

from ._joint_projection import ProjectedTerm
from ._term import AbstractManipulatorTerm, Coefficients, Columns, Joints, Regressor, Rows


class AbstractFunctions(abc.ABC):
    """Functions of one number that a term's inputs are written with.

    Sums, differences, products, whole powers and quotients by numbers are plain operators. One
    formula, written with these, computes arrays in JAX (`JAX_FUNCTIONS`) and becomes C code
    (`jaxcslc.export`).
    """

    @abc.abstractmethod
    def apply(self, name: str, x: Any) -> Any:
        """Return a function of x, by the name that it has in `jaxcslc.codegen`."""

    @abc.abstractmethod
    def constant(self, number: Any, like: Any) -> Any:
        """Return a number as a value of the kind and shape of `like`."""

    @abc.abstractmethod
    def rigid_torque(
        self, rigid: Any, k: Any, q: Sequence[Any], qd: Sequence[Any], qdd: Sequence[Any]
    ) -> Sequence[Any]:
        """Compute every joint's torque of links and motors: `rigid`, with coefficients `k`."""

    def sign(self, x: Any) -> Any:
        """-1, 0 or 1."""
        return self.apply("sign", x)

    def absolute(self, x: Any) -> Any:
        return self.apply("fabs", x)

    def positive(self, x: Any) -> Any:
        """Return the greater of x and 0."""
        return self.apply("positive", x)

    def negative(self, x: Any) -> Any:
        """Return the lesser of x and 0."""
        return self.apply("negative", x)

    def sqrt(self, x: Any) -> Any:
        """Square root; at 0 its derivative counts as 0."""
        return self.apply("sqrt", x)

    def exp(self, x: Any) -> Any:
        return self.apply("exp", x)

    def tanh(self, x: Any) -> Any:
        return self.apply("tanh", x)

    def sin(self, x: Any) -> Any:
        return self.apply("sin", x)

    def cos(self, x: Any) -> Any:
        return self.apply("cos", x)


class _ArrayFunctions(AbstractFunctions):
    """Functions of arrays of any shape, by NumPy or by JAX's NumPy."""

    def __init__(self, namespace: Any) -> None:
        self._xp = xp = namespace
        self._functions: dict[str, Callable[[Any], Any]] = {
            "fabs": xp.abs,
            "positive": lambda x: xp.maximum(x, 0.0),
            "negative": lambda x: xp.minimum(x, 0.0),
            # The root of 0 has no derivative, and 0 times infinity is no number: 1 stands in for 0.
            "sqrt": lambda x: xp.where(x > 0, xp.sqrt(xp.where(x > 0, x, 1.0)), 0.0),
        }

    def apply(self, name: str, x: Any) -> Any:
        return self._functions.get(name, getattr(self._xp, name, None))(x)  # pyright: ignore[reportOptionalCall]

    def constant(self, number: Any, like: Any) -> Any:
        return self._xp.full_like(like, number)

    def rigid_torque(
        self, rigid: Any, k: Any, q: Sequence[Any], qd: Sequence[Any], qdd: Sequence[Any]
    ) -> Sequence[Any]:
        if self._xp is jnp:
            motion = (jnp.stack([jnp.asarray(x) for x in row], axis=-1) for row in (q, qd, qdd))
            return by_joint(rigid.torque(jnp.asarray(k), *motion))
        # By columns of NumPy's arrays: nothing is compiled.
        rows = rigid.columns(*(np.stack(x) for x in (q, qd, qdd)))
        load = np.asarray(k, q[0].dtype)
        return [load[np.array(s, int)] @ x for s, x in zip(rigid.support, rows, strict=True)]


JAX_FUNCTIONS = _ArrayFunctions(jnp)
"""The functions of JAX, elementwise on arrays."""
HOST_FUNCTIONS = _ArrayFunctions(np)
"""Those of NumPy."""


class ExpressionFunctions(AbstractFunctions):
    """The functions of terms' inputs as operations of straight-line code."""

    def __init__(self, motion: Motion) -> None:
        self.motion = motion

    def apply(self, name: str, x: Value) -> Value:
        return self.motion.graph.apply(name, x)

    def constant(self, number: float, like: Value) -> Value:
        del like
        return self.motion.graph.constant(float(number))

    def rigid_torque(
        self, rigid: Any, k: Any, q: Sequence[Value], qd: Sequence[Value], qdd: Sequence[Value]
    ) -> Sequence[Value]:
        """**Raises** `ValueError` for joints that follow others, which have no expressions."""
        del qd, qdd
        if isinstance(rigid, ProjectedTerm):
            raise ValueError("friction 'load': has no expressions where joints follow others")
        total = [self.motion.graph.constant(0.0)] * len(q)
        for joint, index, value in rigid.entries(self.motion):
            total[joint] = total[joint] + value * float(k[index])
        return total


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
        """Index of the term's coefficient that multiplies each input.

        Ascending, as often for each coefficient.
        """

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
    def has_host_columns(self) -> bool:
        return True

    @property
    def support(self) -> tuple[tuple[int, ...], ...]:
        reach: list[list[int]] = [[] for _ in range(self.joint_count)]
        for joint, index in zip(self.input_joints, self.input_indices, strict=True):
            reach[joint].append(index)
        return tuple(tuple(sorted(indices)) for indices in reach)

    @property
    def inertia_matrices(self) -> Float[np.ndarray, "coefficients joints joints"]:
        """Factor of each coefficient in the mass matrix."""
        matrices = np.zeros((self.size, self.joint_count, self.joint_count))
        if "mass" in self.parts:  # inputs are then linear in accelerations
            still = [0.0] * self.joint_count
            for column, unit in enumerate(np.eye(self.joint_count).tolist()):
                values = self.inputs(HOST_FUNCTIONS, still, still, unit)
                np.add.at(matrices, (self.input_indices, self.input_joints, column), values)
        return matrices

    def entries(self, motion: Motion) -> Iterator[tuple[int, int, Value]]:
        """Joint, coefficient and value of the regressor's entries, as expressions."""
        values = self.inputs(ExpressionFunctions(motion), motion.q, motion.qd, motion.qdd)
        yield from zip(self.input_joints, self.input_indices, values, strict=True)

    def columns(self, q: Rows, qd: Rows, qdd: Rows) -> Columns:
        inputs = self._array_inputs(list(q), list(qd), list(qdd))
        where = zip(self.input_joints, self.input_indices, strict=True)
        entries = dict(zip(where, inputs, strict=True))
        xp = array_namespace(*inputs)
        return tuple(
            xp.stack([entries[joint, index] for index in support]) if support else q[:0]
            for joint, support in enumerate(self.support)
        )

    def regressor(self, q: Joints, qd: Joints, qdd: Joints) -> Regressor:
        inputs = self._array_inputs(*map(by_joint, (q, qd, qdd)))
        return self._regressor(jnp.stack(inputs, axis=-1))

    def torque(self, k: Coefficients, q: Joints, qd: Joints, qdd: Joints) -> Joints:
        total = [jnp.zeros_like(q[..., 0])] * self.joint_count
        inputs = self._array_inputs(*map(by_joint, (q, qd, qdd)))
        for joint, index, value in zip(self.input_joints, self.input_indices, inputs, strict=True):
            total[joint] = total[joint] + k[index] * value
        return jnp.stack(total, axis=-1)

    def _regressor(self, inputs: Float[Array, "*batch inputs"]) -> Regressor:
        shape = (*inputs.shape[:-1], self.joint_count, inputs.shape[-1])
        # One row of the identity an input: a product costs less than many small arrays.
        eye = jnp.asarray(np.eye(self.joint_count)[:, list(self.input_joints)], inputs.dtype)
        rows = jnp.broadcast_to(inputs[..., None, :], shape) * jnp.broadcast_to(eye, shape)
        if inputs.shape[-1] == self.size:
            return rows
        return jnp.sum(rows.reshape(*shape[:-1], self.size, -1), axis=-1)

    def part(self, quantity: str, k: Coefficients, *motion: Joints) -> Float[Array, "..."]:
        if quantity != "mass_matrix":
            return jnp.zeros_like(motion[0])
        matrix = jnp.tensordot(k, jnp.asarray(self.inertia_matrices, k.dtype), 1)
        return jnp.broadcast_to(matrix, (*motion[0].shape, self.joint_count))

    def _array_inputs(self, q: Sequence[Any], qd: Sequence[Any], qdd: Sequence[Any]) -> list[Any]:
        """The inputs of arrays: NumPy's, unless motion or the term's own numbers are JAX's."""
        # Motion may be NumPy's while JAX traces the term's numbers.
        traced = any(isinstance(x, Tracer) for x in jax.tree.leaves(self))
        on_host = array_namespace(*q) is np and not traced
        return self.inputs(HOST_FUNCTIONS if on_host else JAX_FUNCTIONS, q, qd, qdd)


def by_joint(x: Float[Array, "*batch joints"]) -> list[Float[Array, "*batch"]]:
    """Split an array into one array per joint."""
    return [x[..., joint] for joint in range(x.shape[-1])]
