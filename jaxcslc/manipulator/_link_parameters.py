"""Inertia of links: which inertial terms a link has, and the values of its measurable parameters.

`LinkInertia` decides which symbols the algebra has; `LinkParameters` holds numbers. The functions
move parameters to another frame and combine bodies (thesis 2.3, 2.5).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ._joint import RobotError


InertiaForm = Literal["full", "principal"]

TENSOR_ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Entries of an inertia tensor in the order Ixx, Iyy, Izz, Ixy, Ixz, Iyz."""

_ENTRIES: dict[str, tuple[str, ...]] = {
    "full": ("m", "rx", "ry", "rz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz"),
    "principal": ("m", "rx", "ry", "rz", "Ixx", "Iyy", "Izz"),
}
_EQUAL = ("Ixx", "Iyy", "Izz")


@dataclass(frozen=True)
class LinkInertia:
    """Choice of the inertial terms that a link has in the algebra.

    **Attributes**

    - `form`: `"full"` is the pseudo-inertia matrix of Eqn. 2.3-17: mass, first moments and the
      full inertia tensor about the origin of the link's frame. `"principal"` is the
      principal-axis substitution of Eqn. 2.3-20: principal moments at the centre of gravity,
      whose axes are taken as parallel to the link frame, moved to the frame by the parallel
      axis theorem.
    - `zero`: entries that vanish by construction, out of `m rx ry rz Ixx Iyy Izz` and, for a
      full tensor, `Ixy Ixz Iyz`; `rx ry rz` are the coordinates of the centre of gravity.
    - `equal`: pairs of moments that are equal by symmetry; the second is written as the first.
    - `motor`: whether the joint has an effective motor inertia (Eqn. 2.5-6).
    - `mass`, `centre`: the link's mass [kg] and centre of gravity, three coordinates in the
      link's frame [m], where they are known. They are numbers in the algebra instead of symbols
      (C.1.2).

    Off-diagonal entries are elements of the inertia tensor, `Ixy = -∫ x y dm`: the sign of
    URDF, MJCF and most of the field, opposite to Eqn. 2.3-15.

    >>> LinkInertia("principal", zero=("rx", "ry"), equal=(("Ixx", "Iyy"),)).form
    'principal'
    """

    form: InertiaForm = "full"
    zero: tuple[str, ...] = ()
    equal: tuple[tuple[str, str], ...] = ()
    motor: bool = True
    mass: float | None = None
    centre: tuple[float, ...] | None = None

    @property
    def has_known(self) -> bool:
        """True if the mass or the centre of gravity is a number in the algebra."""
        return self.mass is not None or self.centre is not None

    def __post_init__(self) -> None:
        if self.form not in _ENTRIES:
            raise RobotError(f"inertia form must be 'full' or 'principal', got {self.form!r}")
        allowed = _ENTRIES[self.form]
        for entry in self.zero:
            if entry not in allowed:
                raise RobotError(
                    f"zero entry {entry!r} is unknown for a {self.form} inertia;"
                    f" expected one of {' '.join(allowed)}"
                )
        for pair in self.equal:
            if len(pair) != 2 or pair[0] == pair[1] or not set(pair) <= set(_EQUAL):
                raise RobotError(
                    f"equal entries must be two different moments out of {' '.join(_EQUAL)},"
                    f" got {pair!r}"
                )
            if set(pair) & set(self.zero):
                raise RobotError(f"entries {pair!r} cannot be both equal and zero")
        if self.form == "principal" and "m" in self.zero and len(self.zero) < 2:
            raise RobotError("a link of zero mass has no centre of gravity: make rx ry rz zero too")
        self._check_known()

    def _check_known(self) -> None:
        """**Raises** `RobotError` for known values that no body has, or that `zero` excludes."""
        if self.mass is not None and not 0.0 < self.mass < math.inf:
            raise RobotError(f"known mass: expected more than 0 kg, got {self.mass}")
        if self.centre is not None and not (
            len(self.centre) == 3 and all(map(math.isfinite, self.centre))
        ):
            raise RobotError(f"known centre: expected three finite numbers in m, got {self.centre}")
        if self.has_known and "m" in self.zero:
            raise RobotError("a link whose mass is listed as zero has no known mass or centre")
        for axis, value in zip("xyz", self.centre or (0.0, 0.0, 0.0), strict=True):
            if value != 0.0 and f"r{axis}" in self.zero:
                raise RobotError(f"known centre: r{axis} is listed as zero, got {value}")


class LinkParameters(eqx.Module):
    """The measurable parameters of one link and of the actuator that drives its joint.

    **Attributes**

    - `mass`: [kg].
    - `centre_of_gravity`: (3,), in the link's frame [m].
    - `inertia`: (3, 3), inertia tensor at the centre of gravity, axes of the link's frame
      [kg m²]; off-diagonal entries are tensor elements, `I[0, 1] = -∫ x y dm`.
    - `motor_inertia`: effective inertia of the motor at the joint (Eqn. 2.5-6) [kg m², or kg
      for a prismatic joint].

    A pytree of arrays: functions of it can be differentiated and vmapped.

    >>> import numpy as np
    >>> rod = LinkParameters(2.0, np.array([0.5, 0, 0]), np.diag([0, 1 / 6, 1 / 6]))
    >>> float(rod.inertia_at_frame[2, 2])  # 1/6 + 2 * 0.5**2
    0.6666666666666666
    """

    mass: Float[Array | np.ndarray, ""] | float
    centre_of_gravity: Float[Array | np.ndarray, "3"]
    inertia: Float[Array | np.ndarray, "3 3"]
    motor_inertia: Float[Array | np.ndarray, ""] | float = 0.0

    @property
    def first_moment(self) -> Float[Array | np.ndarray, "3"]:
        """Mass times centre of gravity (Eqn. 2.3-16) [kg m]."""
        return self.mass * self.centre_of_gravity

    @property
    def inertia_at_frame(self) -> Float[Array | np.ndarray, "3 3"]:
        """Inertia tensor about the origin of the link's frame (Eqns. 2.3-18, 2.3-19) [kg m²]."""
        r = self.centre_of_gravity
        return self.inertia + self.mass * (r @ r * np.eye(3) - r[:, None] * r[None, :])


def motor_inertia(rotor_inertia: float, gear_ratio: float) -> float:
    """Return the effective inertia of a motor at the joint that it drives (Eqn. 2.5-5).

    The thesis writes I / r², where r is the joint's speed over the motor's. Here the gear ratio is
    its inverse N = 1 / r, as data sheets and MuJoCo's `gear` have it, so that inertia grows to
    I N². For a prismatic joint N is in rad/m, and the result is a mass.

    **Arguments**

    - `rotor_inertia`: about the motor's axis, of all that turns with it [kg m²].
    - `gear_ratio`: turns of the motor per turn of the joint; either sign.

    **Returns** what `LinkParameters.motor_inertia` holds [kg m², or kg].

    **Raises** `RobotError` for a negative inertia, a ratio of zero, and what is not finite.

    >>> from jaxcslc.manipulator import motor_inertia
    >>> motor_inertia(2e-4, 100.0)
    2.0
    """
    if not 0.0 <= rotor_inertia < math.inf:
        raise RobotError(f"rotor_inertia: expected 0 or more kg m², got {rotor_inertia}")
    if gear_ratio == 0.0 or not math.isfinite(gear_ratio):
        raise RobotError(f"gear_ratio: expected a finite number other than 0, got {gear_ratio}")
    return rotor_inertia * gear_ratio**2


def seen_from(link: LinkParameters, pose: Float[Array | np.ndarray, "4 4"]) -> LinkParameters:
    """Return a body's parameters in another frame, in which the link's frame has pose `pose`.

    Motor inertia is of the joint and stays as it is.
    """
    rotation, origin = pose[:3, :3], pose[:3, 3]
    return LinkParameters(
        link.mass,
        rotation @ link.centre_of_gravity + origin,
        rotation @ link.inertia @ rotation.T,
        link.motor_inertia,
    )


def fixed_together(links: Sequence[LinkParameters]) -> LinkParameters:
    """Combine several bodies in the same frame into one (parallel axes, Eqns. 2.3-18, 2.3-19).

    Without mass the centre of gravity is the frame's origin. The motor inertia is the sum.

    >>> import numpy as np
    >>> ball = LinkParameters(1.0, np.array([1.0, 0, 0]), np.zeros((3, 3)))
    >>> other = LinkParameters(3.0, np.array([-1.0, 0, 0]), np.zeros((3, 3)))
    >>> both = fixed_together([ball, other])
    >>> float(both.mass), both.centre_of_gravity.tolist(), np.diag(both.inertia).tolist()
    (4.0, [-0.5, 0.0, 0.0], [0.0, 3.0, 3.0])
    """
    mass = sum((link.mass for link in links), 0.0)
    moment = sum((link.first_moment for link in links), np.zeros(3))
    about_origin = sum((link.inertia_at_frame for link in links), np.zeros((3, 3)))
    centre = moment / mass if mass else np.zeros(3)
    shift = mass * (centre @ centre * np.eye(3) - centre[:, None] * centre[None, :])
    motor = sum((link.motor_inertia for link in links), 0.0)
    return LinkParameters(mass, centre, about_origin - shift, motor)
