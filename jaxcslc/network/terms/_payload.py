from fractions import Fraction

from ...derivation import BODY, Addend, Coefficient, inertial_terms
from ...manipulator import LinkInertia, Manipulator, RobotError
from ._link_motion import paths_of
from ._recursive import RecursiveEvaluator


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
    see what of a payload the arm can feel at all.

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


def payload_coefficients(carrying: Manipulator) -> tuple[Coefficient, ...]:
    """One coefficient for each of the ten terms of a `carrier`'s body."""
    found: list[Coefficient] = []
    for name, term in zip(PAYLOAD, inertial_terms(carrying), strict=True):
        label = "*".join(f"{factor}p" for factor in term.factors)
        positive = name in ("pIxx", "pIyy", "pIzz", "pm")
        addend = Addend(Fraction(1), (), term)
        found.append(Coefficient(name, "payload", label, _UNITS[name[1]], positive, (addend,)))
    return tuple(found)


def payload_evaluator(carrying: Manipulator) -> RecursiveEvaluator:
    """Newton-Euler over a `carrier`'s body.

    All ten numbers, not the fewest that the torque depends on: whether a body can exist is a
    question to all of them, and a motion, or an arm of few joints, that leaves some of them
    open says so in a fit.
    """
    size = len(BODY)
    unit = tuple(tuple(float(i == j) for j in range(size)) for i in range(size))
    link = inertial_terms(carrying)[0].link
    links = range(carrying.joint_count)
    return RecursiveEvaluator(
        body=tuple(unit if i == link else ((),) * size for i in links),
        joints=carrying.joints,
        gravity=carrying.gravity,
        places=tuple(tuple(range(size)) if i == link else () for i in links),
        motors=(),
        paths=paths_of(carrying.parents),
        size=size,
    )
