from typing import Any

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
