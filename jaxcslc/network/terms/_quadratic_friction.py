from typing import Any, ClassVar

from ._input_term import AbstractFunctions
from ._joint_term import AbstractJointLaw


class QuadraticFriction(AbstractJointLaw):
    """Friction with the square of the speed, qd |qd|: fans, seals in oil, fluid in hoses.

    Beside viscous friction it bends the line, so that its coefficient may have either sign.
    """

    kind: ClassVar[str] = "quadratic"
    part: ClassVar[str] = "friction"
    symbols: ClassVar[tuple[str, ...]] = ("kq",)
    directions: ClassVar[tuple[str, ...]] = ()
    description: ClassVar[str] = "friction of joint {} with the square of its speed"
    units: ClassVar[tuple[str, str]] = ("N m (s/rad)^2", "N (s/m)^2")
    positive: ClassVar[bool] = False

    def inputs(self, functions: AbstractFunctions, q: Any, qd: Any) -> tuple[Any, ...]:
        del q
        return (qd * functions.absolute(qd),)
