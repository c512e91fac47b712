"""Laws of a joint's friction, torque offset and spring, one class per law.

Each gives names, units and inputs (Eqns. 2.5-3, 2.5-4). `JointTerm` in `_joint_term` makes a term
of a law; `_registry` says which laws a robot has.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from jaxcslc.manipulator import STATIC_SLOPE, Manipulator

from ._input_term import AbstractFunctions
from ._joint_term import AbstractJointLaw, LawProperties


_BOTH_WAYS = ("forwards", "backwards")


class Viscous(AbstractJointLaw):
    """Friction in proportion to velocity (Eqn. 2.5-3)."""

    @property
    def properties(self) -> LawProperties:
        return LawProperties(
            kind="viscous",
            symbols=("kv",),
            description="viscous friction of joint {}",
            units=("N m s/rad", "N s/m"),
            positive=True,
        )

    def inputs(self, functions: AbstractFunctions, q: Any, qd: Any) -> tuple[Any, ...]:
        del functions, q
        return (qd,)


class AsymmetricViscous(AbstractJointLaw):
    """Viscous friction with a coefficient for either direction of motion (Fig. 8.2-2)."""

    @property
    def properties(self) -> LawProperties:
        return LawProperties(
            kind="asymmetric_viscous",
            symbols=("kvp", "kvn"),
            directions=_BOTH_WAYS,
            description="viscous friction of joint {}",
            units=("N m s/rad", "N s/m"),
            positive=True,
        )

    def inputs(self, functions: AbstractFunctions, q: Any, qd: Any) -> tuple[Any, ...]:
        del q
        return functions.positive(qd), functions.negative(qd)


class Dry(AbstractJointLaw):
    """Coulomb friction, in proportion to the sign of velocity (Eqn. 2.5-3)."""

    @property
    def properties(self) -> LawProperties:
        return LawProperties(
            kind="dry",
            symbols=("kd",),
            description="dry friction of joint {}",
            units=("N m", "N"),
            positive=True,
        )

    def inputs(self, functions: AbstractFunctions, q: Any, qd: Any) -> tuple[Any, ...]:
        del q
        return (functions.sign(qd),)


class AsymmetricDry(AbstractJointLaw):
    """Coulomb friction with a coefficient for either direction of motion."""

    @property
    def properties(self) -> LawProperties:
        return LawProperties(
            kind="asymmetric_dry",
            symbols=("kdp", "kdn"),
            directions=_BOTH_WAYS,
            description="dry friction of joint {}",
            units=("N m", "N"),
            positive=True,
        )

    def inputs(self, functions: AbstractFunctions, q: Any, qd: Any) -> tuple[Any, ...]:
        del q
        sign = functions.sign(qd)
        return functions.positive(sign), functions.negative(sign)


class Root(AbstractJointLaw):
    """Friction with the square root of the speed.

    Beside viscous friction it bends the line, so that its coefficient may have either sign.
    """

    @property
    def properties(self) -> LawProperties:
        return LawProperties(
            kind="root",
            symbols=("kr",),
            description="friction of joint {} with the root of its speed",
            units=("N m (s/rad)^0.5", "N (s/m)^0.5"),
            positive=False,
        )

    def inputs(self, functions: AbstractFunctions, q: Any, qd: Any) -> tuple[Any, ...]:
        del q
        return (functions.sign(qd) * functions.sqrt(functions.absolute(qd)),)


class QuadraticFriction(AbstractJointLaw):
    """Friction with the square of the speed, qd |qd|: fans, seals in oil, fluid in hoses.

    Beside viscous friction it bends the line, so that its coefficient may have either sign.
    """

    @property
    def properties(self) -> LawProperties:
        return LawProperties(
            kind="quadratic",
            symbols=("kq",),
            description="friction of joint {} with the square of its speed",
            units=("N m (s/rad)^2", "N (s/m)^2"),
            positive=False,
        )

    def inputs(self, functions: AbstractFunctions, q: Any, qd: Any) -> tuple[Any, ...]:
        del q
        return (qd * functions.absolute(qd),)


class Offset(AbstractJointLaw):
    """A constant torque."""

    @property
    def properties(self) -> LawProperties:
        return LawProperties(
            kind="offset",
            symbols=("ko",),
            description="torque offset of joint {}",
            units=("N m", "N"),
            positive=False,
        )

    def inputs(self, functions: AbstractFunctions, q: Any, qd: Any) -> tuple[Any, ...]:
        del q
        return (functions.constant(1.0, qd),)


class Spring(AbstractJointLaw):
    """A joint spring: torque in proportion to position."""

    @property
    def properties(self) -> LawProperties:
        return LawProperties(
            kind="spring",
            symbols=("ke",),
            description="stiffness of joint {}",
            units=("N m/rad", "N/m"),
            positive=True,
            part="spring",
        )

    def inputs(self, functions: AbstractFunctions, q: Any, qd: Any) -> tuple[Any, ...]:
        del functions, qd
        return (q,)


class StaticFriction(AbstractJointLaw):
    """Static friction beyond dry friction: sign(qd) exp(-slope |qd|) (Eqn. 2.5-4, Fig. 8.2-1).

    **Attributes**

    - `slopes`: (n,) of each joint that has a torque [s/rad or s/m], a leaf; those of joints
      without static friction are not used.
    """

    slopes: Float[Array | np.ndarray, "*batch joints"]

    @property
    def properties(self) -> LawProperties:
        return LawProperties(
            kind="static",
            symbols=("ks",),
            description="static friction of joint {} beyond dry",
            units=("N m", "N"),
            positive=False,  # what is left of static friction beyond dry friction
        )

    @classmethod
    def from_robot(cls, robot: Manipulator) -> "StaticFriction":
        """Make static friction with the robot's slopes, or with `STATIC_SLOPE` if it has none."""
        slopes = np.array(robot.static_slopes or (STATIC_SLOPE,) * robot.joint_count, float)
        return cls(slopes[list(robot.independent_joints)])

    def with_slopes(
        self, slopes: Sequence[float] | Float[Array | np.ndarray, " joints"]
    ) -> "StaticFriction":
        """Return static friction with other slopes, (n,); numbers become a NumPy array.

        **Raises** `ValueError` for a wrong number of slopes, and for numbers not above 0.
        """
        values = slopes if isinstance(slopes, Array) else np.array(slopes, float)
        if isinstance(values, np.ndarray) and not np.all((values > 0) & (values < np.inf)):
            raise ValueError(f"static slopes: expected numbers above 0, got {values.tolist()}")
        shape = self.slopes.shape
        if values.shape != shape:
            raise ValueError(
                f"static slopes: expected {shape[-1]}, one a joint, got {values.shape}"
            )
        return StaticFriction(values)

    def inputs(self, functions: AbstractFunctions, q: Any, qd: Any) -> tuple[Any, ...]:
        del q
        decay = functions.exp(-(functions.absolute(qd) * self.slopes))
        return (functions.sign(qd) * decay,)

    # `jax.jit(network.torque)` looks the method up by its hash, and arrays have none.
    def __hash__(self) -> int:
        if isinstance(self.slopes, Tracer):
            return id(self.slopes)
        values = np.asarray(self.slopes)
        return hash((values.shape, values.tobytes()))
