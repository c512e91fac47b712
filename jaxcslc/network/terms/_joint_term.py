"""Terms that apply one law to joints, with coefficients of each joint's own.

The laws themselves are in `_friction_laws`.
"""

import abc
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from jaxcslc._environment import array_namespace
from jaxcslc.derivation import Coefficient
from jaxcslc.manipulator import Manipulator

from ._input_term import HOST_FUNCTIONS, JAX_FUNCTIONS, AbstractFunctions, AbstractInputTerm
from ._term import Coefficients, Columns, Joints, Regressor, Rows


class LawProperties(NamedTuple):
    """Names, meaning and units of a law's coefficients.

    **Attributes**

    - `kind`: the kind, as in a robot's friction model, and the group of the coefficients.
    - `symbols`: letters that names of coefficients begin with, one for each input.
    - `description`: of a coefficient, with `{}` for the number of the joint.
    - `units`: of revolute and of prismatic joints.
    - `positive`: whether coefficients are positive by construction: friction opposes motion.
    - `part`: the sum of the equation of motion that it belongs to, `"friction"` or `"spring"`.
    - `directions`: of the inputs, as `("forwards", "backwards")`; empty for one input.
    """

    kind: str
    symbols: tuple[str, ...]
    description: str
    units: tuple[str, str]
    positive: bool
    part: str = "friction"
    directions: tuple[str, ...] = ()


class AbstractJointLaw(eqx.Module):
    """A formula for a joint's torque by its own position and velocity: friction, offset, spring.

    Array fields, (n,) each, are what the formula is not linear in, such as slopes: leaves of the
    network that transformations see. A new law is a file like `_static_friction.py`, listed in
    `_registry.py`, and its kind is listed in `jaxcslc/manipulator/_friction.py`.
    """

    @property
    @abc.abstractmethod
    def properties(self) -> LawProperties:
        """Names, units and kind."""

    @abc.abstractmethod
    def inputs(self, functions: AbstractFunctions, q: Any, qd: Any) -> tuple[Any, ...]:
        """Return the factors of a joint's coefficients, one value per symbol.

        Written as for one joint: array fields of `self` are that joint's entries here.

        - `functions`: those that are not plain operators.
        - `q`, `qd`: position and velocity.
        """


class JointTerm(AbstractInputTerm):
    """A law of the joints that have it, with coefficients of each joint's own.

    The coefficients are those of the first symbol, joint by joint, then those of the next.

    **Attributes**

    - `kind`: of the law.
    - `law`: the formula.
    - `joints`: those that have it, from 0; `joint_count`: how many have torques: all that follow
      none.
    - `robot_joints`: which of the robot's they are; `robot_joint_count`: n.
    """

    law: AbstractJointLaw
    kind: str = eqx.field(static=True)
    coefficients: tuple[Coefficient, ...] = eqx.field(static=True)
    joints: tuple[int, ...] = eqx.field(static=True)
    joint_count: int = eqx.field(static=True)
    robot_joints: tuple[int, ...] = eqx.field(static=True)
    robot_joint_count: int = eqx.field(static=True)

    @classmethod
    def of(cls, law: AbstractJointLaw, robot: Manipulator) -> "JointTerm":
        """The term of the robot's joints whose friction model names the law's kind."""
        kind, friction = law.properties.kind, robot.friction_per_joint
        independent = robot.independent_joints
        joints = tuple(i for i, joint in enumerate(independent) if kind in friction[joint])
        robot_joints = tuple(independent[i] for i in joints)
        prismatic = tuple(robot.joints[joint].kind == "P" for joint in robot_joints)
        return cls(
            law=law,
            kind=kind,
            coefficients=_coefficients(law.properties, robot_joints, prismatic),
            joints=joints,
            joint_count=len(independent),
            robot_joints=robot_joints,
            robot_joint_count=robot.joint_count,
        )

    @property
    def keyword(self) -> str:
        return self.kind

    @property
    def parts(self) -> tuple[str, ...]:
        return (self.law.properties.part,)

    @property
    def input_joints(self) -> tuple[int, ...]:
        return self.joints * len(self.law.properties.symbols)

    @property
    def input_indices(self) -> tuple[int, ...]:
        return tuple(range(self.size))

    @property
    def value_shape(self) -> tuple[int, ...]:
        return (self.robot_joint_count, *self._directions)

    @property
    def value_index(self) -> tuple[tuple[int, ...], ...]:
        if not self.law.properties.directions:
            return (self.robot_joints,)
        columns = range(len(self.law.properties.symbols))
        return self.robot_joints * len(columns), tuple(
            column for column in columns for _ in self.joints
        )

    @property
    def value_meaning(self) -> str:
        if not self.law.properties.directions:
            return "one a joint"
        return f"{' and '.join(self.law.properties.directions)} of each joint"

    @property
    def inertia_matrices(self) -> Float[np.ndarray, "coefficients joints joints"]:
        return np.zeros((self.size, self.joint_count, self.joint_count))

    def inputs(
        self, functions: AbstractFunctions, q: Sequence[Any], qd: Sequence[Any], qdd: Sequence[Any]
    ) -> list[Any]:
        del qdd
        values: list[tuple[Any, ...]] = []
        for j in self.joints:
            law = jax.tree.map(lambda x, j=j: functions.constant(x[j], qd[j]), self.law)
            values.append(law.inputs(functions, q[j], qd[j]))
        return [value for symbol in zip(*values, strict=True) for value in symbol]

    def columns(self, q: Rows, qd: Rows, qdd: Rows) -> Columns:
        del qdd
        inputs = self._inputs(q, qd, 0)
        xp = array_namespace(*inputs)
        return tuple(
            xp.stack([x[joint] for x in inputs]) if joint in self.joints else q[:0]
            for joint in range(self.joint_count)
        )

    def regressor(self, q: Joints, qd: Joints, qdd: Joints) -> Regressor:
        del qdd
        shape = (*q.shape, len(self.joints))
        # One row of the identity a coefficient: a product costs less than many small arrays.
        eye = jnp.asarray(np.eye(self.joint_count)[:, list(self.joints)], q.dtype)
        blocks = [
            jnp.broadcast_to(self._of_joints(x)[..., None, :], shape) * jnp.broadcast_to(eye, shape)
            for x in self._inputs(q, qd, -1)
        ]
        return blocks[0] if len(blocks) == 1 else jnp.concatenate(blocks, axis=-1)

    def _of_joints(self, x: Joints) -> Float[Array, "*batch _"]:
        """The columns of the joints that have the law."""
        if len(self.joints) == self.joint_count:
            return x
        return jnp.take(x, np.array(self.joints), axis=-1, mode="clip")

    def torque(self, k: Coefficients, q: Joints, qd: Joints, qdd: Joints) -> Joints:
        del qdd
        zero = jnp.zeros((), k.dtype)
        total: Array | None = None
        for x, k_of_joints in zip(self._inputs(q, qd, -1), self._by_symbol(k), strict=True):
            factors = dict(zip(self.joints, k_of_joints, strict=True))
            row = jnp.stack([factors.get(joint, zero) for joint in range(self.joint_count)])
            share = x * jnp.broadcast_to(row, x.shape)
            total = share if total is None else total + share
        assert total is not None
        return total

    @property
    def _directions(self) -> tuple[int, ...]:
        return (len(self.law.properties.directions),) if self.law.properties.directions else ()

    def _by_symbol(self, k: Array) -> list[Array]:
        return list(k.reshape(len(self.law.properties.symbols), len(self.joints)))

    def _inputs(self, q: Any, qd: Any, axis: int) -> tuple[Any, ...]:
        """Inputs of all joints at once, which are on this axis."""
        shape = [1] * q.ndim
        shape[axis] = self.joint_count
        # Motion may be NumPy's while JAX traces the law's numbers.
        traced = any(isinstance(x, Tracer) for x in jax.tree.leaves(self.law))
        on_host = isinstance(q, np.ndarray) and not traced
        xp, functions = (np, HOST_FUNCTIONS) if on_host else (jnp, JAX_FUNCTIONS)

        def of_every_joint(x: Any) -> Any:
            return xp.broadcast_to(xp.reshape(xp.asarray(x, q.dtype), shape), q.shape)

        return jax.tree.map(of_every_joint, self.law).inputs(functions, q, qd)


# Made once for a law and its joints: coefficients are compared by identity.
@lru_cache(maxsize=256)
def _coefficients(
    law: LawProperties, joints: tuple[int, ...], prismatic: tuple[bool, ...]
) -> tuple[Coefficient, ...]:
    coefficients: list[Coefficient] = []
    for number, symbol in enumerate(law.symbols):
        direction = f", {law.directions[number]}" if law.directions else ""
        coefficients += [
            Coefficient(
                f"{symbol}{joint + 1}",
                law.kind,
                law.description.format(joint + 1) + direction,
                law.units[slides],
                law.positive,
            )
            for joint, slides in zip(joints, prismatic, strict=True)
        ]
    return tuple(coefficients)
