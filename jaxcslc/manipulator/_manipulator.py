import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ._errors import RobotError
from ._inertia import InertiaForm, LinkInertia
from ._joint import (
    Joint,
    Length,
    length_table,
    parse_angle,
    parse_length,
    unused_lengths,
)
from ._link_parameters import LinkParameters
from ._numbering import Numbering, Subnumbering


FRICTION_TERMS = ("viscous", "dry", "offset")


@dataclass(frozen=True)
class Manipulator:
    """A serial chain of rigid links: all that the derivation needs to know of a robot.

    **Attributes**

    - `joints`: one `Joint` (a row of modified Denavit-Hartenberg parameters) a link.
    - `inertia`: one `LinkInertia` a link: which inertial terms exist.
    - `gravity`: gravity vector in the base frame [m/s²].
    - `friction`: the friction terms of every joint's model, out of `"viscous"`, `"dry"`
      (Eqn. 2.5-3) and `"offset"`, a constant torque.
    - `links`: the physical parameters of each link, where they are known.
    - `viscous`, `dry`: friction coefficients of each joint, where known [N m s/rad], [N m].
    - `numbering`: a published numbering to follow.

    Build one with `Manipulator.from_modified_dh`, `load_robot` or `puma560`.
    """

    name: str
    joints: tuple[Joint, ...]
    inertia: tuple[LinkInertia, ...]
    gravity: tuple[float, float, float]
    friction: tuple[str, ...] = ("viscous", "dry")
    links: tuple[LinkParameters, ...] | None = dataclasses.field(default=None, compare=False)
    viscous: tuple[float, ...] | None = dataclasses.field(default=None, compare=False)
    dry: tuple[float, ...] | None = dataclasses.field(default=None, compare=False)
    numbering: Numbering | None = None

    def __post_init__(self) -> None:
        n = len(self.joints)
        if n == 0:
            raise RobotError(f"robot {self.name!r} has no joints")
        for field in ("inertia", "links", "viscous", "dry"):
            value = getattr(self, field)
            if value is not None and len(value) != n:
                raise RobotError(
                    f"robot {self.name!r}: expected {n} entries of {field}, one a joint,"
                    f" got {len(value)}"
                )
        if unknown := [term for term in self.friction if term not in FRICTION_TERMS]:
            raise RobotError(
                f"robot {self.name!r}: unknown friction term {unknown[0]!r};"
                f" expected some of {', '.join(FRICTION_TERMS)}"
            )
        if len(set(self.friction)) != len(self.friction):
            raise RobotError(f"robot {self.name!r}: a friction term is listed twice")
        given = {
            length.symbol for joint in self.joints for length in (joint.a, joint.d) if length.symbol
        }
        for i, joint in enumerate(self.joints, start=1):
            for name, length in ((f"a{i - 1}", joint.a), (f"d{i}", joint.d)):
                if length.symbol is None and not length.is_zero and name in given:
                    raise RobotError(
                        f"robot {self.name!r}, joint {i}, {name[0]}: the number {length.value} is"
                        f" called {name!r} by its place, and another length has that name; name it"
                    )

    @property
    def joint_count(self) -> int:
        return len(self.joints)

    @property
    def kinds(self) -> str:
        """Joint kinds in order, as in `"RRPRRR"`."""
        return "".join(joint.kind for joint in self.joints)

    @classmethod
    def from_modified_dh(
        cls,
        rows: Sequence[Sequence[float | int | str]],
        *,
        kinds: str | None = None,
        gravity: Sequence[float | int] = (0.0, 0.0, -9.81),
        inertia: InertiaForm | LinkInertia | Sequence[InertiaForm | LinkInertia] = "full",
        motor_inertia: bool = True,
        friction: Sequence[str] = ("viscous", "dry"),
        lengths: Mapping[str, float | int] | None = None,
        name: str = "robot",
    ) -> "Manipulator":
        """A robot from modified Denavit-Hartenberg rows, as in Craig.

        **Arguments**

        - `rows`: one `(alpha, a, d, theta)` a joint: twist and length of the link before,
          offset and angle of this one. Angles in rad or as `"-pi/2"`; lengths in m or as the
          name of a length, such as `"a2"`. `theta` of a revolute joint and `d` of a prismatic
          one are what is added to the joint variable.
        - `kinds`: `"R"` or `"P"` for each joint; all revolute if omitted.
        - `gravity`: gravity vector in the base frame [m/s²].
        - `inertia`: `"full"`, `"principal"` or a `LinkInertia`, for all links or one a link.
        - `motor_inertia`: whether links given as a word have a motor inertia.
        - `friction`: terms of the friction model, see `Manipulator`.
        - `lengths`: values of named lengths [m].

        **Raises**

        - `RobotError`: naming the joint and the entry that is wrong.

        >>> planar = Manipulator.from_modified_dh(
        ...     [(0, 0, 0, 0), (0, "a1", 0, 0)], gravity=(0, -9.81, 0), lengths={"a1": 0.5}
        ... )
        >>> planar.kinds, planar.joints[1].a
        ('RR', Length(value=0.5, symbol='a1'))
        """
        kinds = "R" * len(rows) if kinds is None else kinds
        if len(kinds) != len(rows) or set(kinds) - {"R", "P"}:
            raise RobotError(
                f"robot {name!r}: kinds must be one R or P for each of {len(rows)} rows,"
                f" got {kinds!r}"
            )
        values = length_table(lengths or {}, f"robot {name!r}, lengths")
        joints: list[Joint] = []
        for i, (row, kind) in enumerate(zip(rows, kinds, strict=True), start=1):
            if len(row) != 4:
                raise RobotError(
                    f"robot {name!r}, joint {i}: expected (alpha, a, d, theta), got {row!r}"
                )
            at = f"robot {name!r}, joint {i}"
            joints.append(
                Joint(
                    "P" if kind == "P" else "R",
                    parse_angle(row[0], f"{at}, alpha"),
                    parse_length(row[1], values, f"{at}, a"),
                    parse_length(row[2], values, f"{at}, d"),
                    parse_angle(row[3], f"{at}, theta"),
                )
            )
        unused_lengths(values, joints, f"robot {name!r}, lengths")
        each: list[InertiaForm | LinkInertia] = (
            [inertia] * len(rows) if isinstance(inertia, str | LinkInertia) else list(inertia)
        )
        return cls(
            name=name,
            joints=tuple(joints),
            inertia=tuple(
                entry if isinstance(entry, LinkInertia) else LinkInertia(entry, motor=motor_inertia)
                for entry in each
            ),
            gravity=_gravity(gravity, name),
            friction=tuple(friction),
        )

    def with_gravity(self, gravity: Sequence[float | int]) -> "Manipulator":
        """The same robot under another gravity vector in its base frame [m/s²].

        A published numbering of gravity coefficients holds along the axis that it was made for;
        for gravity along others it is dropped.
        """
        vector = _gravity(gravity, self.name)
        numbering = self.numbering
        if numbering and [g != 0 for g in vector] != [g != 0 for g in self.gravity]:
            numbering = dataclasses.replace(numbering, gravity=Subnumbering(()))
        return dataclasses.replace(self, gravity=vector, numbering=numbering)

    def with_friction(self, *terms: str) -> "Manipulator":
        """The same robot with another friction model, as in `with_friction("viscous", "dry")`."""
        return dataclasses.replace(self, friction=terms)

    def with_inertia(self, form: InertiaForm, *, motor_inertia: bool = True) -> "Manipulator":
        """The same robot with `form` for every link, nothing assumed zero or equal."""
        return dataclasses.replace(
            self,
            inertia=tuple(LinkInertia(form, motor=motor_inertia) for _ in self.joints),
            numbering=None,
        )

    def length_values(self) -> dict[str, float]:
        """Value of every named length [m].

        Lengths given as plain numbers are named by the thesis's convention: a of row i is
        a(i-1), d of row i is d(i).

        **Raises**

        - `RobotError`: if a named length has no value.
        """
        values: dict[str, float] = {}
        for symbol, length in self.named_lengths().items():
            if length.value is None:
                raise RobotError(
                    f"robot {self.name!r}: length {symbol!r} has no value; give one, or keep"
                    " lengths symbolic"
                )
            values[symbol] = length.value
        return values

    def named_lengths(self) -> dict[str, Length]:
        """Every length that is not zero, by the name that symbolic expressions use."""
        named: dict[str, Length] = {}
        for i, joint in enumerate(self.joints, start=1):
            for letter, index, length in (("a", i - 1, joint.a), ("d", i, joint.d)):
                if not length.is_zero:
                    named[length.symbol or f"{letter}{index}"] = length
        return named


def _gravity(gravity: Sequence[float | int], name: str) -> tuple[float, float, float]:
    numbers = [isinstance(g, int | float) and not isinstance(g, bool) for g in gravity]
    if numbers != [True] * 3:
        raise RobotError(f"robot {name!r}: gravity must be three numbers in m/s², got {gravity!r}")
    x, y, z = (float(g) for g in gravity)
    if not abs(x) + abs(y) + abs(z) < float("inf"):
        raise RobotError(f"robot {name!r}: gravity must be finite, got {gravity!r}")
    return x, y, z
