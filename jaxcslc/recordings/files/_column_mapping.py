"""Mapping of a file's columns to joints and quantities, as a user states it in TOML.

The keys are in `docs/recordings.md`.
"""

import dataclasses
import math
import os
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from jaxcslc._plain_data import toml_document

from .._recording import RecordingError
from ._known_layouts import TORQUE_RECORDING, RecordingKind
from ._layout import (
    COMMAND_QUANTITIES,
    COMMANDED,
    QUANTITIES,
    ColumnLayout,
    Header,
    LayoutColumn,
    beginning,
    is_numbered,
    listed_units,
    si_factor,
)


@dataclasses.dataclass(frozen=True)
class MappedQuantity:
    """Mapping of a file's columns to one quantity.

    - `columns`: their names, one per joint; or one text in which `{joint}` stands for a joint's
      name, or its number where the file has no names, `{number}` for its number from 1 and
      `{index}` for that from 0; None: as the format has them.
    - `units`: one for all joints, or one per joint; none: as the format has it, or else SI.
    - `factors`: sign times torque constant [N m/A] times gear ratio, one per joint or one for all.
    - `zeros`: values of positions, in the file's unit, that stand for 0; as `factors`.
    - `has_constant`: whether the factors contain a torque constant.
    """

    columns: str | tuple[str, ...] | None = None
    units: tuple[str, ...] = ()
    factors: tuple[float, ...] = (1.0,)
    zeros: tuple[float, ...] = (0.0,)
    has_constant: bool = False

    @classmethod
    def of(cls, table: Any, quantity: str, where: str) -> "MappedQuantity":
        """Parse a table of the mapping; `where` names it in messages."""
        if not isinstance(table, Mapping):
            raise RecordingError(f"{where}: expected a table, got {table!r}")
        multipliers = {"time": (), "torque": ("sign", "constant", "gear")}.get(quantity, ("sign",))
        shifts = ("zero",) if quantity in COMMANDED else ()
        _check_keys(table, {"columns", "unit", *multipliers, *shifts}, where)
        columns = table.get("columns")
        if columns is not None and not isinstance(columns, str):
            columns = _texts(columns, f"{where}, columns")
            if quantity == "time" and len(columns) != 1:
                raise RecordingError(f"{where}, columns: expected one column, got {list(columns)}")
        units = _units(table.get("unit"), quantity, f"{where}, unit")
        factors = [1.0]
        for key in multipliers:
            if key not in table:
                continue
            numbers = _numbers(table[key], f"{where}, {key}")
            if len(factors) > 1 and len(numbers) not in (1, len(factors)):
                raise RecordingError(
                    f"{where}, {key}: expected {len(factors)} numbers, got {len(numbers)}"
                )
            count = max(len(factors), len(numbers))
            factors = [factors[i % len(factors)] * numbers[i % len(numbers)] for i in range(count)]
        zeros = [0.0]
        if "zero" in table:
            zeros = _numbers(table["zero"], f"{where}, zero", zero=True)
        return cls(columns, units, tuple(factors), tuple(zeros), "constant" in table)

    def named_columns(
        self,
        standard: tuple[LayoutColumn, ...] | None,
        count: int | None,
        names: tuple[str, ...] | None,
        where: str,
    ) -> tuple[LayoutColumn, ...]:
        """Return the columns of joints, before their units.

        `standard` are those of the file's format, `count` and `names` are of the joints.
        """
        if self.columns is None:
            if standard is None:
                raise RecordingError(f"{where}: expected columns = ...: the file's format has none")
            return standard
        if isinstance(self.columns, tuple):
            return tuple(map(LayoutColumn, self.columns))
        if count is None:
            raise RecordingError(
                f"{where}, columns: expected a list, or an entry joints = [...] as well"
            )
        return tuple(
            LayoutColumn(_filled(self.columns, str(i) if names is None else names[i - 1], i))
            for i in range(1, count + 1)
        )

    def with_units(
        self, columns: tuple[LayoutColumn, ...], quantity: str, where: str
    ) -> tuple[LayoutColumn, ...]:
        """Return the columns with SI units in one unit of each."""
        count = len(columns)
        for values, keys in (
            (self.factors, "numbers of sign, constant or gear"),
            (self.zeros, "numbers of zero"),
            (self.units, "units"),
        ):
            if len(values) not in (1, count) and values:
                raise RecordingError(
                    f"{where}: {len(values)} {keys}; expected {count}, one for each joint, or one"
                )
        units: list[float] = []
        for unit in self.units:
            current = si_factor(unit, "current") if quantity == "torque" else None
            if current is not None and not self.has_constant:
                raise RecordingError(
                    f"{where}: {unit} is a current; expected constant = ..., the torque"
                    " constant [N m/A] of each joint, and gear = ..., its gear ratio; constants"
                    " that are not known: jaxcslc torque-constants, from recordings with and"
                    " without a known payload"
                )
            units.append(current or si_factor(unit, quantity) or 1.0)
        units = units * count if len(units) == 1 else units
        factors = self.factors * count if len(self.factors) == 1 else self.factors
        zeros = self.zeros * count if len(self.zeros) == 1 else self.zeros
        return tuple(
            LayoutColumn(column.name, unit * factor, zero)
            for column, unit, factor, zero in zip(
                columns, units or [x.factor for x in columns], factors, zeros, strict=True
            )
        )


@dataclasses.dataclass(frozen=True)
class ColumnMapping:
    """Mapping of a recording file's columns to the joints' positions, torques and so on.

    What it leaves out is as in the file's format: only what differs has to be said. The command
    reads it from the TOML file of `--columns` (`ColumnMapping.load`).

    **Attributes**

    - `joints`: names of the joints, as in the robot's file, in the order of the columns.
    - `file_joints`: what the recording calls them, where it has other names.
    - `quantities`: `"time"`, `"position"`, `"torque"`, `"velocity"`, `"acceleration"`, and of
      position servos `"command"` and `"current"`.
    - `topic`: of a bag that has several with joint states.
    - `command_topic`: of a bag that has several with commanded positions.
    - `delimiter`: between the cells of a CSV file; by default what the header shows.
    - `source`: what the mapping was read from, for messages.

    >>> from jaxcslc.recordings import ColumnMapping
    >>> mapping = ColumnMapping.of(
    ...     {"position": {"columns": "q{number}", "unit": "deg"}, "joints": ["a", "b"]}
    ... )
    >>> mapping.quantities["position"].columns
    'q{number}'
    """

    joints: tuple[str, ...] | None = None
    file_joints: tuple[str, ...] | None = None
    quantities: Mapping[str, MappedQuantity] = dataclasses.field(
        default_factory=lambda: MappingProxyType({})
    )
    topic: str | None = None
    command_topic: str | None = None
    delimiter: str | None = None
    source: str = "columns"

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "ColumnMapping":
        """Read a mapping from a TOML file; its keys are in `docs/recordings.md`.

        Of a project file, `jaxcslc.toml`, its table `[columns]` is read.

        **Raises** `RecordingError`: one line that names the file and the entry.

        >>> import pathlib, tempfile
        >>> from jaxcslc.recordings import ColumnMapping
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder) / "mapping.toml"
        ...     _ = path.write_text('[time]' + chr(10) + 'columns = "t"' + chr(10) + 'unit = "ms"')
        ...     ColumnMapping.load(path).quantities["time"].units
        ('ms',)
        """
        document = toml_document(path, "file of column names", RecordingError)
        table = document.get("columns")
        return cls.of(table if isinstance(table, dict) else document, str(path))

    @classmethod
    def of(cls, document: Mapping[str, Any], source: str = "columns") -> "ColumnMapping":
        """Return the mapping that a TOML file holds.

        **Arguments**

        - `document`: tables and keys as in `docs/recordings.md`.
        - `source`: as it is named in messages.

        **Raises** `RecordingError` for unknown keys, units and types.
        """
        names = ("time", *dict.fromkeys((*QUANTITIES, *COMMAND_QUANTITIES)))
        _check_keys(document, {"joints", "topic", "command_topic", "delimiter", *names}, source)
        joints = document.get("joints")
        file_joints = None
        if isinstance(joints, Mapping):
            file_joints = _texts(list(joints.values()), f"{source}, joints")
            joints = list(joints)
        quantities = {
            name: MappedQuantity.of(document[name], name, f"{source}, [{name}]")
            for name in names
            if name in document
        }
        return cls(
            None if joints is None else _texts(joints, f"{source}, joints"),
            file_joints,
            MappingProxyType(quantities),
            _text(document.get("topic"), f"{source}, topic"),
            _text(document.get("command_topic"), f"{source}, command_topic"),
            _text(document.get("delimiter"), f"{source}, delimiter"),
            source,
        )

    def layout(
        self,
        file: str,
        header: Header,
        joints: int | Sequence[str] | None,
        kind: RecordingKind = TORQUE_RECORDING,
    ) -> ColumnLayout:
        """Return the layout of a file with this mapping.

        **Arguments**

        - `file`: as it is named in messages.
        - `header`: of the file.
        - `joints`: of the robot: names, which decide on the order, or how many.
        - `kind`: the quantities that the recording is to have.

        **Raises** `RecordingError` for columns that the file does not have, numbers of columns that
        differ, units of another quantity and currents without a torque constant.
        """
        base = self._base(file, header, joints, kind)
        names = self.joints or base.joint_names or self._named(header, joints)
        counts = [len(names)] if names is not None else self._counts(base, joints)
        quantities = dict(base.quantities)
        for quantity, mapped in self.quantities.items():
            if quantity not in kind.quantities:
                continue
            where = f"{self.source}, [{quantity}]"
            standard = base.quantities.get(quantity)
            columns = mapped.named_columns(standard, max(counts, default=None), names, where)
            quantities[quantity] = mapped.with_units(columns, quantity, where)
        layout = dataclasses.replace(
            base,
            time_column=self._time(base.time_column),
            quantities={q: quantities[q] for q in kind.quantities if q in quantities},
            joint_names=names,
            relative=True,
            torque_measured=True,
        )
        for name in layout.names:
            if name not in header.names:
                raise RecordingError(
                    f"{file}: no column {name!r} of {self.source}; the file has"
                    f" {beginning(header.names)}"
                )
        layout = layout.checked(file, kind.required)
        if self.joints is not None and not isinstance(joints, int | None) and is_numbered(joints):
            return layout.for_joints(file, len(joints))  # the mapping says their order
        return layout.for_joints(file, joints)

    def _base(
        self,
        file: str,
        header: Header,
        joints: int | Sequence[str] | None,
        kind: RecordingKind,
    ) -> ColumnLayout:
        """Return what the file's format says; no columns for a format of the user's own."""
        try:
            base = kind.layout_by_format(file, header)
        except RecordingError as error:  # the mapping has to say everything
            hint = str(error).removeprefix(f"{file}: ")
            return ColumnLayout(LayoutColumn("time"), {}, notes=header.notes, hint=hint)
        if "torque" in self.quantities:
            # A note about the format's torques is none about those of the mapping.
            base = dataclasses.replace(base, notes=header.notes)
        if base.joint_names is None:
            return base
        return base.for_joints(file, self.file_joints or self.joints or joints)

    def _named(self, header: Header, joints: int | Sequence[str] | None) -> tuple[str, ...] | None:
        """Return the robot's joints whose names `{joint}` stands for in the file's columns."""
        pattern = next((text for text in self.patterns if "{joint}" in text), None)
        if pattern is None or isinstance(joints, int | None):
            return None
        return _with_column(pattern, joints, header.names, joints) or None

    def joints_in(self, columns: Sequence[str], joints: Sequence[str]) -> tuple[str, ...] | None:
        """Return the joints of a robot that a file has columns of, by the mapping's patterns.

        **Arguments**

        - `columns`: of the file.
        - `joints`: of the robot, in order.

        **Returns** those whose name, or else whose number, stands in a column; None of a mapping
        that lists its columns.

        >>> from jaxcslc.recordings import ColumnMapping
        >>> mapping = ColumnMapping.of({"position": {"columns": "q_{joint}"}})
        >>> mapping.joints_in(["time", "q_elbow"], ["shoulder", "elbow"])
        ('elbow',)
        """
        if named := self._named(Header(list(columns)), joints):
            return named
        numbers = [str(i + 1) for i in range(len(joints))]
        return next((_with_column(text, numbers, columns, joints) for text in self.patterns), None)

    @property
    def patterns(self) -> list[str]:
        """Texts with `{joint}`, `{number}` or `{index}` that stand for a column per joint."""
        mapped = (self.quantities[name] for name in self.quantities if name != "time")
        return [quantity.columns for quantity in mapped if isinstance(quantity.columns, str)]

    def _counts(self, base: ColumnLayout, joints: int | Sequence[str] | None) -> list[int]:
        """Return the numbers of joints that something states."""
        counts = [len(m.columns) for m in self.quantities.values() if isinstance(m.columns, tuple)]
        if base.joints:
            counts.append(base.joints)
        if joints is not None:
            counts.append(joints if isinstance(joints, int) else len(joints))
        return counts

    def _time(self, standard: LayoutColumn) -> LayoutColumn:
        mapped = self.quantities.get("time", MappedQuantity())
        name = mapped.columns[0] if isinstance(mapped.columns, tuple) else mapped.columns
        if not mapped.units:
            return standard if name is None else LayoutColumn(name)
        return LayoutColumn(name or standard.name, si_factor(mapped.units[0], "time") or 1.0)


def _filled(pattern: str, joint: str, number: int) -> str:
    """Return the column of a joint, whose number counts from 1."""
    filled = pattern.replace("{joint}", joint).replace("{number}", str(number))
    return filled.replace("{index}", str(number - 1))


def _with_column(
    pattern: str, names: Sequence[str], columns: Sequence[str], joints: Sequence[str]
) -> tuple[str, ...]:
    """Return the joints that have a column if `{joint}` stands for one of `names`."""
    return tuple(
        joint
        for number, (name, joint) in enumerate(zip(names, joints, strict=True), 1)
        if _filled(pattern, name, number) in columns
    )


def _units(value: Any, quantity: str, where: str) -> tuple[str, ...]:
    """Return a unit or several; none of None."""
    if value is None:
        return ()
    kinds = (quantity, "current") if quantity == "torque" else (quantity,)
    several = isinstance(value, list) and bool(value) and quantity != "time"
    units: list[Any] = value if several else [value]
    for unit in units:
        text = _text(unit, where) or ""
        if all(si_factor(text, kind) is None for kind in kinds):
            expected = "; ".join(listed_units(kind) for kind in kinds)
            raise RecordingError(f"{where}: expected {expected}, got {unit!r}")
    return tuple(units)


def _numbers(value: Any, where: str, *, zero: bool = False) -> list[float]:
    """Return a number or several; `zero`: whether they may be 0."""
    values = value if isinstance(value, list) else [value]
    for number in values:
        real = isinstance(number, int | float) and not isinstance(number, bool)
        if not real or not math.isfinite(number) or (number == 0 and not zero):
            other = "" if zero else " other than 0"
            raise RecordingError(f"{where}: expected finite numbers{other}, got {value!r}")
    if not values:
        raise RecordingError(f"{where}: expected one number a joint, got none")
    return [float(number) for number in values]


def _texts(value: Any, where: str) -> tuple[str, ...]:
    if not isinstance(value, list) or not value or not all(isinstance(t, str) for t in value):
        raise RecordingError(f"{where}: expected a list of texts, got {value!r}")
    if len(set(value)) != len(value):
        raise RecordingError(f"{where}: expected texts that differ, got {value!r}")
    return tuple(value)


def _text(value: Any, where: str) -> str | None:
    if value is not None and (not isinstance(value, str) or not value):
        raise RecordingError(f"{where}: expected a text, got {value!r}")
    return value


def _check_keys(table: Mapping[str, Any], allowed: set[str], where: str) -> None:
    if unknown := sorted(set(table) - allowed):
        raise RecordingError(
            f"{where}: unknown key {unknown[0]!r}; expected {', '.join(sorted(allowed))}"
        )
