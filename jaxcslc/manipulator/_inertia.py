import math
from dataclasses import dataclass
from typing import Literal

from ._errors import RobotError


InertiaForm = Literal["full", "principal"]

_ENTRIES: dict[str, tuple[str, ...]] = {
    "full": ("m", "rx", "ry", "rz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz"),
    "principal": ("m", "rx", "ry", "rz", "Ixx", "Iyy", "Izz"),
}
_EQUAL = ("Ixx", "Iyy", "Izz")


@dataclass(frozen=True)
class LinkInertia:
    """Which inertial terms a link has in the algebra.

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
        """Whether the mass or the centre of gravity is a number in the algebra."""
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
