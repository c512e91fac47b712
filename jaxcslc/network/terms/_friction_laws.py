from typing import Any, ClassVar

from ._input_term import AbstractFunctions
from ._joint_term import AbstractJointLaw


_BOTH_WAYS = ("forwards", "backwards")


class Viscous(AbstractJointLaw):
    """Friction in proportion to velocity (Eqn. 2.5-3)."""

    kind: ClassVar[str] = "viscous"
    part: ClassVar[str] = "friction"
    symbols: ClassVar[tuple[str, ...]] = ("kv",)
    directions: ClassVar[tuple[str, ...]] = ()
    description: ClassVar[str] = "viscous friction of joint {}"
    units: ClassVar[tuple[str, str]] = ("N m s/rad", "N s/m")
    positive: ClassVar[bool] = True

    def inputs(self, functions: AbstractFunctions, q: Any, qd: Any) -> tuple[Any, ...]:
        del functions, q
        return (qd,)


class AsymmetricViscous(AbstractJointLaw):
    """Viscous friction with a coefficient for either direction of motion."""

    kind: ClassVar[str] = "asymmetric_viscous"
    part: ClassVar[str] = "friction"
    symbols: ClassVar[tuple[str, ...]] = ("kvp", "kvn")
    directions: ClassVar[tuple[str, ...]] = _BOTH_WAYS
    description: ClassVar[str] = "viscous friction of joint {}"
    units: ClassVar[tuple[str, str]] = ("N m s/rad", "N s/m")
    positive: ClassVar[bool] = True

    def inputs(self, functions: AbstractFunctions, q: Any, qd: Any) -> tuple[Any, ...]:
        del q
        return functions.positive(qd), functions.negative(qd)


class Dry(AbstractJointLaw):
    """Coulomb friction, the sign of velocity (Eqn. 2.5-4)."""

    kind: ClassVar[str] = "dry"
    part: ClassVar[str] = "friction"
    symbols: ClassVar[tuple[str, ...]] = ("kd",)
    directions: ClassVar[tuple[str, ...]] = ()
    description: ClassVar[str] = "dry friction of joint {}"
    units: ClassVar[tuple[str, str]] = ("N m", "N")
    positive: ClassVar[bool] = True

    def inputs(self, functions: AbstractFunctions, q: Any, qd: Any) -> tuple[Any, ...]:
        del q
        return (functions.sign(qd),)


class AsymmetricDry(AbstractJointLaw):
    """Coulomb friction with a coefficient for either direction of motion."""

    kind: ClassVar[str] = "asymmetric_dry"
    part: ClassVar[str] = "friction"
    symbols: ClassVar[tuple[str, ...]] = ("kdp", "kdn")
    directions: ClassVar[tuple[str, ...]] = _BOTH_WAYS
    description: ClassVar[str] = "dry friction of joint {}"
    units: ClassVar[tuple[str, str]] = ("N m", "N")
    positive: ClassVar[bool] = True

    def inputs(self, functions: AbstractFunctions, q: Any, qd: Any) -> tuple[Any, ...]:
        del q
        sign = functions.sign(qd)
        return functions.positive(sign), functions.negative(sign)


class Root(AbstractJointLaw):
    """Friction with the square root of the speed; beside a line it only bends it."""

    kind: ClassVar[str] = "root"
    part: ClassVar[str] = "friction"
    symbols: ClassVar[tuple[str, ...]] = ("kr",)
    directions: ClassVar[tuple[str, ...]] = ()
    description: ClassVar[str] = "friction of joint {} with the root of its speed"
    units: ClassVar[tuple[str, str]] = ("N m (s/rad)^0.5", "N (s/m)^0.5")
    positive: ClassVar[bool] = False

    def inputs(self, functions: AbstractFunctions, q: Any, qd: Any) -> tuple[Any, ...]:
        del q
        return (functions.sign(qd) * functions.sqrt(functions.absolute(qd)),)


class Offset(AbstractJointLaw):
    """A constant torque (Fig. 8.2-1)."""

    kind: ClassVar[str] = "offset"
    part: ClassVar[str] = "friction"
    symbols: ClassVar[tuple[str, ...]] = ("ko",)
    directions: ClassVar[tuple[str, ...]] = ()
    description: ClassVar[str] = "torque offset of joint {}"
    units: ClassVar[tuple[str, str]] = ("N m", "N")
    positive: ClassVar[bool] = False

    def inputs(self, functions: AbstractFunctions, q: Any, qd: Any) -> tuple[Any, ...]:
        del q
        return (functions.constant(1.0, qd),)


class Spring(AbstractJointLaw):
    """A joint spring: torque in proportion to position (Fig. 8.2-2)."""

    kind: ClassVar[str] = "spring"
    part: ClassVar[str] = "spring"
    symbols: ClassVar[tuple[str, ...]] = ("ke",)
    directions: ClassVar[tuple[str, ...]] = ()
    description: ClassVar[str] = "stiffness of joint {}"
    units: ClassVar[tuple[str, str]] = ("N m/rad", "N/m")
    positive: ClassVar[bool] = True

    def inputs(self, functions: AbstractFunctions, q: Any, qd: Any) -> tuple[Any, ...]:
        del functions, qd
        return (q,)
