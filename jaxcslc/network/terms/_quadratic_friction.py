from typing import Any

from ._input_term import AbstractFunctions
from ._joint_term import AbstractJointLaw, LawProperties


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
