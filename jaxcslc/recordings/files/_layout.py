"""Layout of a recording file: its columns, their quantities, joints and units.

`_column_mapping` makes layouts of what a user states, `_known_layouts` of column names alone.
`_tables` reads the columns that a layout names.
"""

import dataclasses
import itertools
import math
import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
from jaxtyping import Float

from jaxcslc._text_table import first_of

from .._recording import RecordingError


Table = dict[str, Float[np.ndarray, " rows"]]

REQUIRED = ("position", "torque")
QUANTITIES = (*REQUIRED, "velocity", "acceleration")
COMMANDED = ("position", "command")
"""Quantities that a recording of position servos needs."""
COMMAND_QUANTITIES = (*COMMANDED, "velocity", "current")


@dataclasses.dataclass(frozen=True)
class Header:
    """Information that a file gives on its columns before they are read.

    - `names`: of the columns.
    - `joint_names`: of the joints in the columns' order, where the file has them apart.
    - `notes`: what its reader decided.
    - `hint`: why a quantity may be missing, for messages.
    """

    names: list[str]
    joint_names: tuple[str, ...] | None = None
    notes: tuple[str, ...] = ()
    hint: str = ""


@dataclasses.dataclass(frozen=True)
class LayoutColumn:
    """A column of a file, and what makes SI units of its values: (value - zero) times factor."""

    name: str
    factor: float = 1.0
    zero: float = 0.0


@dataclasses.dataclass(frozen=True)
class ColumnLayout:
    """Assignment of a file's columns to a recording's quantities, and their units.

    - `time_column`: of the samples' instants.
    - `quantities`: for `"position"`, `"torque"` and further ones, one column per joint.
    - `joint_names`: in the order of the columns; None where joints are numbered.
    - `relative`: whether time counts from the first sample, as where the file counts from 1970.
    - `notes`: sentences about what was decided in reading the file.
    - `hint`: why a quantity is missing, for messages.
    - `torque_measured`: as of `Recording`.
    """

    time_column: LayoutColumn
    quantities: Mapping[str, tuple[LayoutColumn, ...]]
    joint_names: tuple[str, ...] | None = None
    relative: bool = True
    notes: tuple[str, ...] = ()
    hint: str = ""
    torque_measured: bool = True

    @property
    def joints(self) -> int:
        """Number of joints that the columns belong to."""
        return max((len(columns) for columns in self.quantities.values()), default=0)

    @property
    def columns(self) -> list[LayoutColumn]:
        """The columns to read, time first."""
        return [self.time_column, *itertools.chain.from_iterable(self.quantities.values())]

    @property
    def names(self) -> list[str]:
        """Names of the columns to read, time first."""
        return [column.name for column in self.columns]

    def split(
        self,
        table: Mapping[str, Float[np.ndarray, " rows"]],
        quantities: Sequence[str] = QUANTITIES,
    ) -> dict[str, Float[np.ndarray, "rows joints"] | None]:
        """Return the columns of a table put together, an array per quantity; `None` if absent."""
        return {
            quantity: np.stack([table[column.name] for column in self.quantities[quantity]], 1)
            if quantity in self.quantities
            else None
            for quantity in quantities
        }

    def checked(self, file: str, required: Sequence[str]) -> "ColumnLayout":
        """Return the layout, if a recording can be made of it.

        **Raises** `RecordingError` for a quantity that is missing, numbers of columns that differ,
        or a column that is used twice.
        """
        for quantity in required:
            if not self.quantities.get(quantity):
                reason = self.hint or (
                    f"the file has no column of it; expected {quantity}_1 and on, or by joint as in"
                    f" {quantity}_elbow, or columns in [{quantity}] of a file of --columns"
                )
                mark = "," if reason.startswith("but ") else ":"
                raise RecordingError(f"{file}: no {quantity}{mark} {reason}")
        for quantity, columns in self.quantities.items():
            if len(columns) != self.joints:
                raise RecordingError(
                    f"{file}: {len(columns)} columns of {quantity}; expected {self.joints}, one for"
                    " each joint"
                )
        names = self.names
        if repeated := sorted({name for name in names if names.count(name) > 1}):
            raise RecordingError(f"{file}: column {repeated[0]!r} is used more than once")
        return self

    def for_joints(self, file: str, joints: int | Sequence[str] | None) -> "ColumnLayout":
        """Return the layout with the columns of a robot's joints, in their order.

        - `file`: as it is named in messages.
        - `joints`: of the robot: their names, or how many.

        **Raises** `RecordingError` where joints cannot be matched.
        """
        if joints is None:
            return self
        names = () if isinstance(joints, int) else tuple(joints)
        have, numbered = self.joint_names, bool(names) and is_numbered(names)
        if not names or numbered or have is None:
            count = joints if isinstance(joints, int) else len(names)
            if self.joints != count:
                lacking = () if numbered else names[self.joints :]
                had = "" if have is None else f" ({listed(have)})"
                raise RecordingError(
                    f"{file}: {self.joints} position columns{had}; expected {count}, one for each"
                    f" joint of the robot{to_fix(lacking, names)}"
                )
            if numbered and have is not None and not _count_up(have):
                raise RecordingError(
                    f"{file}: joints {listed(have)}, but the robot's joints have no names; name"
                    " them in the robot's file (name = ... of each [[joint]]), or list the"
                    " recording's in the robot's order: joints = [...] in a file of --columns"
                )
            named = have is None and bool(names) and not numbered
            return dataclasses.replace(self, joint_names=names) if named else self
        if missing := [name for name in names if name not in have]:
            raise RecordingError(
                f"{file}: no joint {listed(missing)}; the recording has {listed(have)}; expected"
                " the names of the robot's file, or joints = {robot's name = 'recording's name'}"
                f" in a file of --columns{to_fix(missing, names)}"
            )
        others = [name for name in have if name not in names]
        unread = (f"joints that are not read: {listed(others)}",) if others else ()
        order = [have.index(name) for name in names]
        return dataclasses.replace(
            self,
            quantities={
                quantity: tuple(columns[i] for i in order)
                for quantity, columns in self.quantities.items()
            },
            joint_names=names,
            notes=(*self.notes, *unread),
        )


def is_numbered(names: Sequence[str]) -> bool:
    """Return whether joints are called `joint 1`, `joint 2` and so on, as those without names are.

    >>> is_numbered(["joint 1", "joint 2"]), is_numbered(["shoulder", "elbow"])
    (True, False)
    """
    return list(names) == [f"joint {i}" for i in range(1, len(names) + 1)]


def to_fix(missing: Sequence[str], names: Sequence[str]) -> str:
    """Return advice about joints of the robot that a recording lacks, such as a gripper's fingers.

    >>> to_fix(["finger"], ["shoulder", "elbow", "finger"])
    '; joints that stood still need no columns: --fix finger'
    """
    if not missing or len(missing) == len(names):
        return ""
    return f"; joints that stood still need no columns: --fix {','.join(missing)}"


def _count_up(names: Sequence[str]) -> bool:
    """Return whether names differ in a number alone, which counts upwards as columns do."""
    parts = [part for name in names if (part := re.fullmatch(r"(.*?)([0-9]+)(\D*)", name))]
    numbers = [int(part[2]) for part in parts]
    return (
        len(parts) == len(names)
        and len({(part[1], part[3]) for part in parts}) == 1
        and all(after == before + 1 for before, after in itertools.pairwise(numbers))
    )


def listed(names: Sequence[str], most: int = 12) -> str:
    """Return names for a message, those with spaces in quotes.

    >>> listed(["elbow", "joint 2", "wrist"], most=2)
    "elbow, 'joint 2' and 1 more"
    """
    return first_of([name if name.isidentifier() else repr(name) for name in names], most)


# What messages show at most: names of columns, and characters.
_SHOWN, _LONGEST = 12, 300


def beginning(names: Sequence[str]) -> str:
    """Return the first columns of a file for a message, as it has them."""
    return ", ".join(names[:_SHOWN]) + (", ..." if len(names) > _SHOWN else "")


def one_line(error: Exception) -> str:
    """Return an error's message on one line, cut where it quotes a file's bytes at length."""
    text = " ".join(str(error).split())
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."


_TURN = 2.0 * math.pi
_DEGREE = math.pi / 180.0
_POSITION = {
    **{"rad": 1.0, "mrad": 1e-3, "deg": _DEGREE, "rev": _TURN, "m": 1.0, "mm": 1e-3},
    "tick": _TURN / 4096.0,  # of the 12-bit encoders of Dynamixel X and Feetech STS servos
}

UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "epoch": 1.0},
        "position": _POSITION,
        "command": _POSITION,
        "velocity": {
            **{"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": _DEGREE, "rpm": _TURN / 60.0},
            **{"m/s": 1.0, "mm/s": 1e-3},
        },
        "acceleration": {"rad/s^2": 1.0, "deg/s^2": _DEGREE, "m/s^2": 1.0, "mm/s^2": 1e-3},
        "torque": {"N m": 1.0, "mN m": 1e-3, "kN m": 1e3, "N": 1.0, "mN": 1e-3, "kN": 1e3},
        "current": {"A": 1.0, "mA": 1e-3},
    }
)
"""SI units in one of each unit, by quantity; those of revolute joints and of prismatic ones."""

_SPELLINGS = {
    **{"µ": "u", "μ": "u", "°": "deg", "degrees": "deg", "degree": "deg", "ticks": "tick"},
    **{"²": "^2", "s2": "s^2", "**": "^", "·": "", "*": ""},
}


def si_factor(unit: str, quantity: str) -> float | None:
    """Return the factor from a unit of a quantity to its SI unit.

    **Arguments**

    - `unit`: as a header or a mapping spells it: `"deg"`, `"N m"`, `"Nm"`, `"rad/s²"`.
    - `quantity`: a key of `UNITS`.

    **Returns** the factor, or None for a unit that is none of this quantity.

    >>> si_factor("mNm", "torque"), si_factor("µs", "time"), si_factor("deg", "torque")
    (0.001, 1e-06, None)
    """
    return {_plain(name): factor for name, factor in UNITS[quantity].items()}.get(_plain(unit))


def listed_units(quantity: str) -> str:
    """Return the units of a quantity, for a message.

    >>> listed_units("current")
    'A or mA'
    """
    *first, last = UNITS[quantity]
    return f"{', '.join(first)} or {last}"


def _plain(unit: str) -> str:
    for spelling, plain in _SPELLINGS.items():
        unit = unit.replace(spelling, plain)
    return "".join(unit.split()).replace("N.m", "Nm")
