"""Payload: a body of ten unknown inertial parameters, fixed to a link (thesis 8.2.4)."""

from fractions import Fraction
from functools import lru_cache

from jaxcslc.derivation import BODY, Addend, Coefficient, inertial_terms
from jaxcslc.manipulator import LinkInertia, Manipulator, RobotError

from ._rigid_body_recursion import RigidBodyRecursion


PAYLOAD = tuple(f"p{entry}" for entry in BODY)
"""Names of a payload's ten coefficients, in their order in `k`."""

_NOTHING = LinkInertia(
    zero=("m", "rx", "ry", "rz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz"), motor=False
)
_UNITS = {"I": "kg m²", "h": "kg m", "m": "kg"}


def carrier(robot: Manipulator, link: int | None = None) -> Manipulator:
    """The robot without any mass but that of a body fixed to one link, its last one if omitted.

    What the thesis calls an additional link (8.2.4), of ten unknown inertial parameters: rigidly
    attached, it has no joint of its own, and its frame can be the carrying link's. Derive it to
    see which parameters of a payload the arm's torques depend on at all.

    **Arguments**

    - `robot`: that carries.
    - `link`: that carries the body, counted from 1; the last one if None.

    **Raises**

    - `RobotError`: there is no such link; counted from 1.

    >>> import jaxcslc as jc
    >>> from jaxcslc.network import carrier
    >>> jc.derive(carrier(jc.puma560()), lengths="numeric").size
    10
    """
    n = robot.joint_count
    link = n if link is None else link
    if not 1 <= link <= n:
        raise RobotError(f"robot {robot.name!r}: there is no link {link}; expected 1 to {n}")
    body = LinkInertia("full", motor=False)
    return Manipulator(
        name=f"payload of {robot.name}",
        joints=robot.joints,
        inertia=tuple(body if i == link else _NOTHING for i in range(1, n + 1)),
        gravity=robot.gravity,
        friction=(),
    )


def payload_term(carrying: Manipulator) -> RigidBodyRecursion:
    """Newton-Euler over the body of a `carrier`, with a coefficient for each of its ten numbers.

    All ten numbers, not the fewest that the torque depends on: whether a body is physically
    possible depends on all of them, and a fit reports those that a motion, or an arm of few
    joints, leaves undetermined.
    """
    size = len(BODY)
    unit = tuple(tuple(float(i == j) for j in range(size)) for i in range(size))
    link = inertial_terms(carrying)[0].link
    links = range(carrying.joint_count)
    body = tuple(unit if i == link else ((),) * size for i in links)
    indices = tuple(tuple(range(size)) if i == link else () for i in links)
    coefficients = _coefficients(carrying)
    return RigidBodyRecursion.from_bodies(carrying, body, indices, (), coefficients, "payload")


@lru_cache(maxsize=64)  # coefficients are compared by identity
def _coefficients(carrying: Manipulator) -> tuple[Coefficient, ...]:
    coefficients: list[Coefficient] = []
    for name, term in zip(PAYLOAD, inertial_terms(carrying), strict=True):
        label = "*".join(f"{factor}p" for factor in term.factors)
        positive = name in ("pIxx", "pIyy", "pIzz", "pm")
        addend = Addend(Fraction(1), (), term)
        coefficients.append(
            Coefficient(name, "payload", label, _UNITS[name[1]], positive, (addend,))
        )
    return tuple(coefficients)
