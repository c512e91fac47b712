"""Robot as a chain or tree of rigid links, with its friction model and its file.

A `Manipulator` is immutable. Its `with_...` methods return changed copies. Its `Source` says where
it comes from: file, joint limits, joints that follow others. Read with `_joint`, `_link_parameters`
and `_friction`, of whose objects it is made.
"""

import dataclasses
import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from jaxtyping import Array, Float

from .._display import html_table
from .._environment import require
from .._text_table import counted, text_table
from ._friction import (
    FRICTION_TERMS,
    Coupling,
    check_friction,
    check_slopes,
    couplings,
)
from ._joint import (
    Joint,
    Length,
    Numbering,
    RobotError,
    Subnumbering,
    gravity_vector,
    modified_dh_joints,
)
from ._link_parameters import InertiaForm, LinkInertia, LinkParameters
from ._placement import joint_lines


RobotFormat = Literal["toml", "urdf", "mjcf"]
Mimics = Literal["fix", "couple"]
"""Treatment of joints that follow others."""


@dataclass(frozen=True)
class JointLimits:
    """Limits of a joint according to the robot's file; infinite where the file states none.

    **Attributes**

    - `low`, `high`: of its position [rad or m].
    - `speed`: [rad/s or m/s].
    - `torque`: [N m or N].

    >>> from jaxcslc.manipulator import JointLimits
    >>> JointLimits(speed=2.2).torque
    inf
    """

    low: float = -math.inf
    high: float = math.inf
    speed: float = math.inf
    torque: float = math.inf


@dataclass(frozen=True)
class Mimic:
    """A joint that follows another: its position is `multiplier` times the other's plus `offset`.

    **Attributes**

    - `follower`, `leader`: names of the joints; the leader follows none.
    - `multiplier`: [rad/rad, or m/rad of a finger that slides].
    - `offset`: [rad or m].

    >>> from jaxcslc.manipulator import Mimic
    >>> Mimic("right finger", "left finger", -1.0).offset
    0.0
    """

    follower: str
    leader: str
    multiplier: float
    offset: float = 0.0


@dataclass(frozen=True, eq=False)
class Source:
    """The file that a robot was read from, and how its links correspond to the file's bodies.

    **Attributes**

    - `path`, `format`: of the file.
    - `base`, `tips`: the part of the file's tree that was asked for, as bodies' names.
    - `fix`: joints and bodies that were to be fixed.
    - `mimic`: what was to become of joints that mimic others.
    - `fixed_joints`: joints that move in the file and are none of the robot's, taken as at zero.
    - `joints`, `links`: for each joint of the robot, the file's joint and the body that it moves.
    - `placements`: (4, 4) for each link, the pose of the file's body frame in the link's frame,
      lengths in m.
    - `carried`: for each link, all else that is fixed to the body, as one body in the link's
      frame; or None.
    - `limits`: of the joints; empty where the file has none.
    - `mimics`: joints of the robot that follow others; empty unless they were asked for.
    - `notes`: what of the file was not taken as it stands, a sentence each.
    """

    path: str
    format: RobotFormat
    joints: tuple[str, ...]
    links: tuple[str, ...]
    placements: tuple[Float[np.ndarray, "4 4"], ...]
    carried: tuple[LinkParameters | None, ...]
    base: str | None = None
    tips: tuple[str, ...] = ()
    fix: tuple[str, ...] = ()
    fixed_joints: tuple[str, ...] = ()
    limits: tuple[JointLimits, ...] = ()
    mimics: tuple[Mimic, ...] = ()
    mimic: Mimics | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, repr=False)
class Manipulator:
    """A chain or tree of rigid links: all that the derivation needs to know of a robot.

    **Attributes**

    - `joints`: one `Joint` (a row of modified Denavit-Hartenberg parameters) a link.
    - `inertia`: one `LinkInertia` a link: which inertial terms exist.
    - `gravity`: gravity vector in the base frame [m/s²].
    - `friction`: the friction terms of every joint's model: kinds of `docs/friction.md`, such as
      `"viscous"`, `"dry"` (Eqn. 2.5-3) and `"offset"`, a constant torque.
    - `links`: the physical parameters of each link, where they are known.
    - `viscous`, `dry`: friction coefficients of each joint, where known [N m s/rad], [N m].
    - `numbering`: a published numbering to follow.
    - `joint_friction`: for each joint its terms where they differ from `friction`, else None;
      None if all joints have `friction`.
    - `coupled`: pairs of joints that share a motor's inertia and friction.
    - `static_slopes`: of each joint's static friction, where known or guessed [s/rad or s/m].
    - `drive`: known parameters of position servos by name, one value or one per joint; None if
      nothing is known about them (`jaxcslc.servo`).
    - `source`: the file that it was read from, if it was.

    Build one with `Manipulator.from_modified_dh`, `load_robot` or `puma560`.

    >>> Manipulator.from_modified_dh([(0, 0, 0, 0), (0, 0.5, 0, 0)]).joint_count
    2
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
    joint_friction: tuple[tuple[str, ...] | None, ...] | None = None
    coupled: tuple[Coupling, ...] = ()
    static_slopes: tuple[float, ...] | None = dataclasses.field(default=None, compare=False)
    drive: Mapping[str, float | Sequence[float]] | None = dataclasses.field(
        default=None, compare=False, repr=False
    )
    source: Source | None = dataclasses.field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        n = len(self.joints)
        if n == 0:
            raise RobotError(f"robot {self.name!r} has no joints")
        for field in ("inertia", "links", "viscous", "dry", "joint_friction", "static_slopes"):
            value = getattr(self, field)
            if value is not None and len(value) != n:
                raise RobotError(
                    f"robot {self.name!r}: expected {n} entries of {field}, one a joint,"
                    f" got {len(value)}"
                )
        where = f"robot {self.name!r}"
        check_friction(self.friction, where)
        for i, terms in enumerate(self.joint_friction or (), start=1):
            if terms is not None:
                check_friction(terms, f"{where}, joint {i}")
        check_slopes(self.static_slopes or (), where)
        object.__setattr__(self, "coupled", couplings(self.coupled, self.kinds, where))
        named = {
            length.symbol
            for joint in self.joints
            for _, _, length in joint.lengths
            if length.symbol
        }
        for i, joint in enumerate(self.joints, start=1):
            if joint.parent is not None and not 0 <= joint.parent < i:
                raise RobotError(
                    f"robot {self.name!r}, joint {i}, parent: expected a joint before it, or 0 for"
                    f" the base, got {joint.parent}"
                )
            for letter, shift, length in joint.lengths:
                name = f"{letter}{i + shift}"
                if length.symbol is None and not length.is_zero and name in named:
                    raise RobotError(
                        f"robot {self.name!r}, joint {i}, {letter}: the number {length.value} is"
                        f" called {name!r} by its row, and another length has that name; name it"
                    )

    @property
    def joint_count(self) -> int:
        """n, joints that follow others included."""
        return len(self.joints)

    @cached_property
    def independent_joints(self) -> tuple[int, ...]:
        """Indices of the joints that follow no other, from 0: all, unless mimics are coupled."""
        mimics = () if self.source is None else self.source.mimics
        following = {mimic.follower for mimic in mimics}
        return tuple(i for i, name in enumerate(self.joint_names) if name not in following)

    @property
    def parents(self) -> tuple[int, ...]:
        """Index, from 0, of the joint whose link carries each joint; -1 for the base."""
        return tuple(
            i - 1 if joint.parent is None else joint.parent - 1
            for i, joint in enumerate(self.joints)
        )

    @property
    def kinds(self) -> str:
        """Joint kinds in order, as in `"RRPRRR"`."""
        return "".join(joint.kind for joint in self.joints)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The joints' names in the robot's file, or `"joint 1"` to `"joint n"`.

        >>> Manipulator.from_modified_dh([(0, 0, 0, 0), (0, 0.5, 0, 0)]).joint_names
        ('joint 1', 'joint 2')
        """
        names = (None,) * self.joint_count if self.source is None else self.source.joints
        return tuple(name or f"joint {i}" for i, name in enumerate(names, start=1))

    @property
    def joint_limits(self) -> tuple[JointLimits, ...]:
        """Limits of each joint according to the robot's file; infinite where it states none.

        >>> Manipulator.from_modified_dh([(0, 0, 0, 0)]).joint_limits[0].speed
        inf
        """
        limits = () if self.source is None else self.source.limits
        return limits or (JointLimits(),) * self.joint_count

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on all that was not taken from the robot's file as it stands, one sentence each.

        >>> Manipulator.from_modified_dh([(0, 0, 0, 0)]).notes
        ()
        """
        return () if self.source is None else self.source.notes

    @property
    def has_joint_names(self) -> bool:
        """True if the robot's file names a joint."""
        return self.joint_names != tuple(f"joint {i}" for i in range(1, self.joint_count + 1))

    @property
    def has_all_lengths(self) -> bool:
        """True if every length has a value, as numeric lengths need."""
        lengths = (length for joint in self.joints for _, _, length in joint.lengths)
        return all(length.value is not None for length in lengths)

    @property
    def torque_units(self) -> tuple[str, ...]:
        """`"N m"` for each revolute joint, `"N"` for each prismatic one."""
        return tuple("N m" if kind == "R" else "N" for kind in self.kinds)

    @classmethod
    def from_modified_dh(
        cls,
        rows: Sequence[Sequence[float | int | str]],
        *,
        parents: Sequence[int] | None = None,
        kinds: str | None = None,
        gravity: Sequence[float | int] = (0.0, 0.0, -9.81),
        inertia: InertiaForm | LinkInertia | Sequence[InertiaForm | LinkInertia] = "full",
        motor_inertia: bool = True,
        friction: Sequence[str] = ("viscous", "dry"),
        lengths: Mapping[str, float | int] | None = None,
        name: str = "robot",
    ) -> "Manipulator":
        """Return a robot from modified Denavit-Hartenberg rows, as in Craig.

        **Arguments**

        - `rows`: one `(alpha, a, d, theta)` a joint: twist and length of the link before,
          offset and angle of this one. Angles in rad or as `"-pi/2"`; lengths in m or as the
          name of a length, such as `"a2"`. `theta` of a revolute joint and `d` of a prismatic
          one are what is added to the joint variable. Where a tree branches, two more:
          `(alpha, a, d, theta, gamma, b)`, see `Joint`.
        - `parents`: for each joint the one whose link carries it, counted from 1, 0 for the base;
          the joint before if omitted.
        - `kinds`: `"R"` or `"P"` for each joint; all revolute if omitted.
        - `gravity`: gravity vector in the base frame [m/s²].
        - `inertia`: `"full"`, `"principal"` or a `LinkInertia`, for all links or one a link.
        - `motor_inertia`: whether links of a form given by name have a motor inertia.
        - `friction`: terms of the friction model, see `Manipulator`.
        - `lengths`: values of named lengths [m].

        **Raises** `RobotError`, naming the joint and the entry that is wrong.

        >>> planar = Manipulator.from_modified_dh(
        ...     [(0, 0, 0, 0), (0, "a1", 0, 0)], gravity=(0, -9.81, 0), lengths={"a1": 0.5}
        ... )
        >>> planar.kinds, planar.joints[1].a
        ('RR', Length(value=0.5, symbol='a1'))
        """
        joints = modified_dh_joints(rows, parents, kinds, lengths or {}, f"robot {name!r}")
        inertias: list[InertiaForm | LinkInertia] = (
            [inertia] * len(rows) if isinstance(inertia, str | LinkInertia) else list(inertia)
        )
        return cls(
            name=name,
            joints=joints,
            inertia=tuple(
                entry if isinstance(entry, LinkInertia) else LinkInertia(entry, motor=motor_inertia)
                for entry in inertias
            ),
            gravity=gravity_vector(gravity, name),
            friction=tuple(friction),
        )

    def with_gravity(self, gravity: Sequence[float | int]) -> "Manipulator":
        """Return the robot with another gravity vector in its base frame [m/s²].

        A published numbering of gravity coefficients holds along the axis that it was made for;
        for gravity along others it is dropped.
        """
        vector = gravity_vector(gravity, self.name)
        numbering = self.numbering
        if numbering and [g != 0 for g in vector] != [g != 0 for g in self.gravity]:
            numbering = dataclasses.replace(numbering, gravity=Subnumbering(()))
        return dataclasses.replace(self, gravity=vector, numbering=numbering)

    @property
    def friction_per_joint(self) -> tuple[tuple[str, ...], ...]:
        """The friction terms of each joint: `joint_friction`, or else `friction`.

        Joints that follow others have none: that of their motion is part of the others'.
        """
        per_joint = self.joint_friction or (None,) * self.joint_count
        independent = set(self.independent_joints)
        return tuple(
            () if i not in independent else self.friction if terms is None else terms
            for i, terms in enumerate(per_joint)
        )

    @property
    def friction_terms(self) -> tuple[str, ...]:
        """Every friction term that some joint has: those of `friction` first, in its order."""
        used = {term for terms in self.friction_per_joint for term in terms}
        order = dict.fromkeys((*self.friction, *FRICTION_TERMS))
        return tuple(term for term in order if term in used)

    def with_friction(self, *terms: str, joint: int | None = None) -> "Manipulator":
        """Return the robot with other friction terms, as in `with_friction("viscous", "dry")`.

        For all joints, or for one of them, counted from 1. Terms are listed in
        `docs/friction.md`; **raises** `RobotError` for those that are unknown or say the same.

        >>> robot = Manipulator.from_modified_dh([(0, 0, 0, 0), (0, 0.5, 0, 0)])
        >>> robot.with_friction("viscous", joint=2).friction_per_joint
        (('viscous', 'dry'), ('viscous',))
        """
        if joint is None:
            return dataclasses.replace(self, friction=terms, joint_friction=None)
        if not 1 <= joint <= self.joint_count:
            raise RobotError(
                f"robot {self.name!r}: there is no joint {joint}; expected 1 to {self.joint_count}"
            )
        if terms and joint - 1 not in self.independent_joints:
            raise RobotError(
                f"robot {self.name!r}: joint {joint} ({self.joint_names[joint - 1]}) follows"
                " another and has no friction terms; expected a joint that follows none"
            )
        per_joint = list(self.joint_friction or (None,) * self.joint_count)
        per_joint[joint - 1] = terms
        return dataclasses.replace(self, joint_friction=tuple(per_joint))

    def with_coupling(self, *pairs: Sequence[int | float]) -> "Manipulator":
        """Return the robot with pairs of joints coupled: `with_coupling((5, 6))`, counted from 1.

        A pair shares the inertia and friction of a shaft that turns by q5 + q6, or by
        q5 + ratio q6 where the pair has a third number. No pairs take couplings away.

        >>> robot = Manipulator.from_modified_dh([(0, 0, 0, 0), ("pi/2", 0, 0, 0)])
        >>> robot.with_coupling((1, 2, -1.0)).coupled
        (Coupling(first=1, second=2, ratio=-1.0),)
        """
        where = f"robot {self.name!r}"
        return dataclasses.replace(self, coupled=couplings(pairs, self.kinds, where))

    def with_static_slopes(self, slopes: Sequence[float]) -> "Manipulator":
        """Return the robot with slopes of static friction, one per joint [s/rad or s/m]."""
        return dataclasses.replace(self, static_slopes=tuple(float(slope) for slope in slopes))

    def with_inertia(self, form: InertiaForm, *, motor_inertia: bool = True) -> "Manipulator":
        """Return the robot with `form` for every link and nothing assumed zero or equal."""
        return dataclasses.replace(
            self,
            inertia=tuple(LinkInertia(form, motor=motor_inertia) for _ in self.joints),
            numbering=None,
        )

    def with_known(
        self,
        link: int,
        *,
        mass: float | None = None,
        centre_of_gravity: Sequence[float] | Float[Array | np.ndarray, " axes"] | None = None,
    ) -> "Manipulator":
        """Return the robot with numbers in the algebra for a link's mass or centre of gravity.

        What is accurately known replaces symbols (thesis C.1.2). Coefficients of known masses alone
        are numbers (`CSLC.known_values`). A known centre of gravity makes first moments multiples
        of the mass: there are fewer coefficients. A published numbering is dropped.

        **Arguments**

        - `link`: counted from 1.
        - `mass`: [kg]; unknown if None.
        - `centre_of_gravity`: three coordinates in the link's frame [m]; unknown if None.

        **Raises** `RobotError` for a link that does not exist, and for values that no link has.

        >>> import jaxcslc as jc
        >>> rows = [(0, 0, 0, 0), (0, 0.5, 0, 0)]
        >>> arm = jc.Manipulator.from_modified_dh(rows, gravity=(0, -9.81, 0))
        >>> known = arm.with_known(2, centre_of_gravity=(0.2, 0.0, 0.0))
        >>> [c.expression for c in jc.derive(known, lengths="numeric").coefficients[3:5]]
        ['Izz2', 'm2']
        """
        if not 1 <= link <= self.joint_count:
            raise RobotError(
                f"robot {self.name!r}: there is no link {link}; expected 1 to {self.joint_count}"
            )
        inertia = list(self.inertia)
        centre = None if centre_of_gravity is None else tuple(map(float, centre_of_gravity))
        try:
            inertia[link - 1] = dataclasses.replace(
                inertia[link - 1], mass=None if mass is None else float(mass), centre=centre
            )
        except RobotError as error:
            raise RobotError(f"robot {self.name!r}, link {link}: {error}") from None
        return dataclasses.replace(self, inertia=tuple(inertia), numbering=None)

    def to_pandas(self) -> Any:
        """Return a pandas table, one row per joint: parent, modified Denavit-Hartenberg row,
        parameters.

        Lengths are in m, angles in rad, masses in kg, inertias at the centre of gravity in kg m².

        >>> import jaxcslc as jc
        >>> jc.puma560().to_pandas()[["alpha", "a", "mass"]].loc[3].tolist()
        [0.0, 0.4318, 4.8]
        """
        pandas = require("pandas", "tables")
        rows: list[dict[str, Any]] = []
        for i, joint in enumerate(self.joints):
            row: dict[str, Any] = {"kind": joint.kind, "parent": self.parents[i] + 1}
            row |= {name: getattr(joint, name) for name in ("alpha", "theta", "gamma")}
            row |= {letter: length.value for letter, _, length in joint.lengths}
            if self.source is not None:
                row |= {"joint of file": self.source.joints[i], "body": self.source.links[i]}
            if self.links is not None:
                link = self.links[i]
                row |= {"mass": float(link.mass), "motor inertia": float(link.motor_inertia)}
                row |= {
                    f"r{axis}": float(link.centre_of_gravity[a]) for a, axis in enumerate("xyz")
                }
                row |= {
                    f"I{'xyz'[a]}{'xyz'[b]}": float(link.inertia[a, b])
                    for a in range(3)
                    for b in range(a, 3)
                }
            for term, values in (("viscous", self.viscous), ("dry", self.dry)):
                row |= {} if values is None else {term: values[i]}
            rows.append(row)
        return pandas.DataFrame(rows, index=range(1, self.joint_count + 1)).rename_axis("joint")

    def _table(self) -> tuple[list[str], list[list[str]]]:
        """Return a table of joints: its header and rows of texts."""
        of_joint = ["joint", "kind", "lowest", "highest", "speed", "torque"]
        of_link = ["body", "mass [kg]", "centre of gravity [m]"]
        rows: list[list[str]] = []
        for i, (name, limit) in enumerate(zip(self.joint_names, self.joint_limits, strict=True)):
            numbers = (limit.low, limit.high, limit.speed, limit.torque)
            texts = [f"{x:.4g}" if math.isfinite(x) else "–" for x in numbers]
            body = f"link {i + 1}" if self.source is None else self.source.links[i]
            of_body = ["–", "–"]
            if self.links is not None:
                centre = ", ".join(f"{float(r):.3g}" for r in self.links[i].centre_of_gravity)
                of_body = [f"{float(self.links[i].mass):.4g}", centre]
            kind = "revolute" if self.kinds[i] == "R" else "prismatic"
            rows.append([name, kind, *texts, body, *of_body])
        return of_joint + of_link, rows

    def __str__(self) -> str:
        header, rows = self._table()
        table = text_table(header, rows, left=("kind", "body", header[-1]))
        return "\n".join([repr(self), table, *(f"note: {note}" for note in self.notes)])

    def _repr_html_(self) -> str:
        """Return joints, limits and bodies as a table, for notebooks."""
        header, rows = self._table()
        columns = dict(zip(header, zip(*rows, strict=True), strict=True))
        notes = "".join(f"<p>{html.escape(note)}</p>" for note in self.notes)
        units = "Positions in rad or m, speeds and torques per joint in SI units."
        return f"{html_table(repr(self), columns)}<p>{units}</p>{notes}"

    def plot(self, q: Float[np.ndarray, " joints"] | None = None) -> Any:
        """Draw lines from joint to joint, as a plotly figure that can be turned.

        **Arguments**

        - `q`: (n,) positions [rad or m]; zeros if None.

        **Raises**

        - `RobotError`: a length without value.
        - `MissingExtraError`: without plotly.

        >>> import jaxcslc as jc
        >>> figure = jc.puma560().plot()
        >>> len(figure.data[0].text)  # each of six lines has two ends, and a gap
        18
        """
        graphs: Any = require("plotly.graph_objects", "report")
        lines = joint_lines(self, np.zeros(self.joint_count) if q is None else np.asarray(q, float))
        gaps = np.pad(lines, ((0, 0), (0, 1), (0, 0)), constant_values=np.nan).reshape(-1, 3)
        names = [text for name in self.joint_names for text in ("", name, "")]
        axes = {f"{letter}axis_title": f"{letter} [m]" for letter in "xyz"}
        x, y, z = gaps.T
        trace = graphs.Scatter3d(x=x, y=y, z=z, text=names, mode="lines+markers", line_width=6)
        layout: Any = {"title": self.name, "scene": {"aspectmode": "data", **axes}}
        return graphs.Figure([trace], layout)

    def __repr__(self) -> str:
        links = "known links" if self.links is not None else "unknown links"
        carried = "" if self.parents == tuple(range(-1, self.joint_count - 1)) else ", a tree"
        return (
            f"Manipulator({self.name!r}: {counted(self.joint_count, 'joint')} {self.kinds}"
            f"{carried}, {links}, friction {' '.join(self.friction) or 'none'})"
        )

    def length_values(self) -> dict[str, float]:
        """Value of every named length [m].

        Lengths given as plain numbers are named by the thesis's convention: a of row i is
        a(i-1), d of row i is d(i).

        **Raises** `RobotError` if a named length has no value.
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
        """Return every length that is not zero, by the name that symbolic expressions use."""
        return {
            length.symbol or f"{letter}{i + shift}": length
            for i, joint in enumerate(self.joints, start=1)
            for letter, shift, length in joint.lengths
            if not length.is_zero
        }
