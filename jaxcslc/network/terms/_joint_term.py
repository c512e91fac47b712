import abc
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...derivation import Coefficient
from ...manipulator import Manipulator
from ._input_term import JAX_FUNCTIONS, AbstractFunctions, AbstractInputTerm
from ._term import Coefficients, Joints, Regressor, Rows


class AbstractJointLaw(eqx.Module):
    """A formula for a joint's torque by its own position and velocity: friction, offset, spring.

    A final subclass sets the class variables, writes `inputs`, and is listed in `_registry.py`;
    its `kind` is listed in `jaxcslc.manipulator`. Array fields, (n,) each, are what the formula
    is not linear in, such as slopes: leaves that transformations see.

    **Attributes**

    - `kind`: the word of a robot's friction model, and the group of the coefficients.
    - `part`: `"friction"` or `"spring"`.
    - `symbols`: letters that names of coefficients begin with, one for each input.
    - `directions`: of the inputs, as `("forwards", "backwards")`; empty for one input.
    - `description`: of a coefficient, with `{}` for the number of the joint.
    - `units`: of revolute and of prismatic joints.
    - `positive`: whether coefficients are positive by construction: friction opposes motion.
    """

    kind: eqx.AbstractClassVar[str]
    part: eqx.AbstractClassVar[str]
    symbols: eqx.AbstractClassVar[tuple[str, ...]]
    directions: eqx.AbstractClassVar[tuple[str, ...]]
    description: eqx.AbstractClassVar[str]
    units: eqx.AbstractClassVar[tuple[str, str]]
    positive: eqx.AbstractClassVar[bool]

    @abc.abstractmethod
    def inputs(
        self, functions: AbstractFunctions, q: Any, qd: Any, *parameters: Any
    ) -> tuple[Any, ...]:
        """What each of a joint's coefficients is multiplied by, one value a symbol.

        - `functions`: those that are not plain operators.
        - `q`, `qd`: of one joint, or of any number of joints side by side.
        - `parameters`: the entries of the law's array fields, in their order.
        """


class JointTerm(AbstractInputTerm):
    """A law of the joints that have it, with coefficients of each joint's own.

    The coefficients are those of the first symbol, joint by joint, then those of the next.

    **Attributes**

    - `law`: the formula.
    - `joints`: those that have it, from 0; `joint_count`: n of the robot.
    """

    law: AbstractJointLaw
    coefficients: tuple[Coefficient, ...] = eqx.field(static=True)
    joints: tuple[int, ...] = eqx.field(static=True)
    joint_count: int = eqx.field(static=True)

    @classmethod
    def of(cls, law: AbstractJointLaw, robot: Manipulator) -> "JointTerm":
        """The term of the robot's joints whose friction model names the law's kind."""
        kinds = robot.friction_per_joint
        joints = tuple(joint for joint, words in enumerate(kinds) if law.kind in words)
        prismatic = tuple(robot.joints[joint].kind == "P" for joint in joints)
        return cls(law, _coefficients(type(law), joints, prismatic), joints, robot.joint_count)

    @property
    def kind(self) -> str:
        return self.law.kind

    @property
    def keyword(self) -> str:
        return self.law.kind

    @property
    def parts(self) -> tuple[str, ...]:
        return (self.law.part,)

    @property
    def input_joints(self) -> tuple[int, ...]:
        return self.joints * len(self.law.symbols)

    @property
    def input_indices(self) -> tuple[int, ...]:
        return tuple(range(self.size))

    @property
    def value_shape(self) -> tuple[int, ...]:
        return (self.joint_count, *self._directions)

    @property
    def value_index(self) -> tuple[tuple[int, ...], ...]:
        if not self.law.directions:
            return (self.joints,)
        columns = range(len(self.law.symbols))
        return self.input_joints, tuple(column for column in columns for _ in self.joints)

    @property
    def value_meaning(self) -> str:
        if not self.law.directions:
            return "one a joint"
        return f"{' and '.join(self.law.directions)} of each joint"

    @property
    def inertia_matrices(self) -> Float[np.ndarray, "coefficients joints joints"]:
        return np.zeros((self.size, self.joint_count, self.joint_count))

    def inputs(
        self, functions: AbstractFunctions, q: Sequence[Any], qd: Sequence[Any], qdd: Sequence[Any]
    ) -> list[Any]:
        del qdd
        parameters = jax.tree.leaves(self.law)
        values = [
            self.law.inputs(
                functions, q[j], qd[j], *(functions.constant(x[j], qd[j]) for x in parameters)
            )
            for j in self.joints
        ]
        return [value for symbol in zip(*values, strict=True) for value in symbol]

    def columns(self, q: Rows, qd: Rows, qdd: Rows) -> tuple[Float[Array, "_ samples"], ...]:
        del qdd
        inputs = self._inputs(q, qd, 0)
        return tuple(
            jnp.stack([x[joint] for x in inputs]) if joint in self.joints else q[:0]
            for joint in range(self.joint_count)
        )

    def regressor(self, q: Joints, qd: Joints, qdd: Joints) -> Regressor:
        del qdd
        shape = (*q.shape, len(self.joints))
        # One row of the identity a coefficient: a product costs less than many small arrays.
        eye = jnp.asarray(np.eye(self.joint_count)[:, list(self.joints)], q.dtype)
        blocks = [
            jnp.broadcast_to(x[..., None, list(self.joints)], shape) * jnp.broadcast_to(eye, shape)
            for x in self._inputs(q, qd, -1)
        ]
        return blocks[0] if len(blocks) == 1 else jnp.concatenate(blocks, axis=-1)

    def torque(self, k: Coefficients, q: Joints, qd: Joints, qdd: Joints) -> Joints:
        del qdd
        zero = jnp.zeros((), k.dtype)
        total: Array | None = None
        for x, own in zip(self._inputs(q, qd, -1), self._by_symbol(k), strict=True):
            factors = dict(zip(self.joints, own, strict=True))
            row = jnp.stack([factors.get(joint, zero) for joint in range(self.joint_count)])
            share = x * jnp.broadcast_to(row, x.shape)
            total = share if total is None else total + share
        assert total is not None
        return total

    @property
    def _directions(self) -> tuple[int, ...]:
        return (len(self.law.directions),) if self.law.directions else ()

    def _by_symbol(self, k: Array) -> list[Array]:
        return list(k.reshape(len(self.law.symbols), len(self.joints)))

    def _inputs(self, q: Array, qd: Array, axis: int) -> tuple[Array, ...]:
        """Inputs of all joints at once, which are on this axis."""
        shape = [1] * q.ndim
        shape[axis] = self.joint_count
        parameters = (
            jnp.broadcast_to(jnp.reshape(jnp.asarray(leaf, q.dtype), shape), q.shape)
            for leaf in jax.tree.leaves(self.law)
        )
        return self.law.inputs(JAX_FUNCTIONS, q, qd, *parameters)


# Made once for a law and its joints: coefficients are compared by identity.
@lru_cache(maxsize=256)
def _coefficients(
    law: type[AbstractJointLaw], joints: tuple[int, ...], prismatic: tuple[bool, ...]
) -> tuple[Coefficient, ...]:
    found: list[Coefficient] = []
    for number, symbol in enumerate(law.symbols):
        direction = f", {law.directions[number]}" if law.directions else ""
        found += [
            Coefficient(
                f"{symbol}{joint + 1}",
                law.kind,
                law.description.format(joint + 1) + direction,
                law.units[slides],
                law.positive,
            )
            for joint, slides in zip(joints, prismatic, strict=True)
        ]
    return tuple(found)
