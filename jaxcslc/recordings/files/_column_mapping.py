"""Mapping of a file's columns to joints and quantities, as a user states it in TOML.

The keys are in `docs/recordings.md`.
"""

import dataclasses
import math
import os
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from jaxcslc._toml_document import toml_document

from .._recording import RecordingError
from ._layout import QUANTITIES, ColumnLayout, Header, LayoutColumn, listed_units, si_factor


_TOP_KEYS = {"joints", "topic", "delimiter", "time", *QUANTITIES}
_TABLE_KEYS = {"columns", "unit", "sign", "constant", "gear"}


@dataclasses.dataclass(frozen=True)
class MappedQuantity:
    """Mapping of a file's columns to one quantity.

    **Attributes**

    - `columns`: their names, one a joint; or one text in which `{joint}` stands for a joint's name,
      `{number}` for its number from 1 and `{index}` for that from 0; None: as the format has them.
    - `unit`: None: as the format has it, or else SI.
    - `factors`: sign times torque constant [N m/A] times gear ratio, one a joint or one for all.
    - `has_constant`: whether the factors contain a torque constant.
    """

    columns: str | tuple[str, ...] | None = None
    unit: str | None = None
    factors: tuple[float, ...] = (1.0,)
    has_constant: bool = False


@dataclasses.dataclass(frozen=True)
class ColumnMapping:
    """Mapping of a recording file's columns to the joints' positions, torques and so on.

    What it leaves out is as in the file's format: only what differs has to be said. The command
    reads it from the TOML file of `--columns` (`ColumnMapping.load`).

    **Attributes**

    - `joints`: names of the joints, as in the robot's file, in the order of the columns.
    - `file_joints`: what the recording calls them, where it has other names.
    - `quantities`: `"time"`, `"position"`, `"torque"`, `"velocity"`, `"acceleration"`.
    - `topic`: of a bag that has several with joint states.
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
    delimiter: str | None = None
    source: str = "columns"

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "ColumnMapping":
        """Read a mapping from a TOML file; its keys are in `docs/recordings.md`.

        **Raises** `RecordingError`: one line that names the file and the entry.

        >>> import pathlib, tempfile
        >>> from jaxcslc.recordings import ColumnMapping
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder) / "mapping.toml"
        ...     _ = path.write_text('[time]' + chr(10) + 'columns = "t"' + chr(10) + 'unit = "ms"')
        ...     ColumnMapping.load(path).quantities["time"].unit
        'ms'
        """
        document = toml_document(path, "file of column names", RecordingError)
        return cls.of(document, str(path))

    @classmethod
    def of(cls, document: Mapping[str, Any], source: str = "columns") -> "ColumnMapping":
        """A mapping from what its TOML file holds.

        **Arguments**

        - `document`: tables and keys as in `docs/recordings.md`.
        - `source`: as it is named in messages.

        **Raises** `RecordingError` for unknown keys, units and types.
        """
        _check_keys(document, _TOP_KEYS, source)
        joints = document.get("joints")
        quantities = {
            name: _mapped(document[name], name, f"{source}, [{name}]")
            for name in ("time", *QUANTITIES)
            if name in document
        }
        file_joints = None
        if isinstance(joints, Mapping):
            file_joints = _texts(list(joints.values()), f"{source}, joints")
            joints = list(joints)
        return cls(
            None if joints is None else _texts(joints, f"{source}, joints"),
            file_joints,
            MappingProxyType(quantities),
            _text(document.get("topic"), f"{source}, topic"),
            _text(document.get("delimiter"), f"{source}, delimiter"),
            source,
        )

    def layout(
        self,
        file: str,
        header: Header,
        base: ColumnLayout | None,
        joints: int | Sequence[str] | None,
    ) -> ColumnLayout:
        """The layout of a file with this mapping.

        **Arguments**

        - `file`: as it is named in messages.
        - `header`: of the file.
        - `base`: what its format says; None for a format of the user's own.
        - `joints`: of the robot: names or number.

        **Raises** `RecordingError` for columns that the file does not have, numbers of columns that
        differ, units of another quantity and currents without a torque constant.
        """
        notes = header.notes
        if base is not None:
            ordered = base
            if base.joint_names is not None:
                ordered = base.of_joints(file, self.file_joints or self.joints or joints)
            # A note about the format's torques is none about those of the mapping.
            about_file = header.notes if "torque" in self.quantities else base.notes
            notes = (*about_file, *ordered.notes[len(base.notes) :])
            base = ordered
        base_quantities = {} if base is None else dict(base.quantities)
        names = self.joints or (None if base is None else base.joint_names)
        count = self._count(base, names, joints)
        quantities: dict[str, tuple[LayoutColumn, ...]] = {}
        for quantity in QUANTITIES:
            mapped = self.quantities.get(quantity)
            if mapped is None:
                if quantity in base_quantities:
                    quantities[quantity] = base_quantities[quantity]
                continue
            where = f"{self.source}, [{quantity}]"
            columns = self._columns(mapped, base_quantities.get(quantity), count, names, where)
            factors = _factors(mapped, quantity, columns, where)
            quantities[quantity] = tuple(
                LayoutColumn(column.name, factor)
                for column, factor in zip(columns, factors, strict=True)
            )
        time = self._time(base)
        for column in (time, *(column for some in quantities.values() for column in some)):
            if column.name not in header.names:
                listed = ", ".join(header.names[:12]) + (", ..." if header.names[12:] else "")
                raise RecordingError(
                    f"{file}: no column {column.name!r} of {self.source}; the file has {listed}"
                )
        return ColumnLayout(
            time,
            quantities,
            names,
            notes=notes,
            hint=header.hint if base is None else base.hint,
        )

    def _time(self, base: ColumnLayout | None) -> LayoutColumn:
        mapped = self.quantities.get("time", MappedQuantity())
        named = mapped.columns if isinstance(mapped.columns, str) else None
        if isinstance(mapped.columns, tuple):
            (named,) = mapped.columns
        standard = LayoutColumn("time") if base is None else base.time_column
        if mapped.unit is None:
            return standard if named is None else LayoutColumn(named)
        return LayoutColumn(named or standard.name, si_factor(mapped.unit, "time") or 1.0)

    def _count(
        self,
        base: ColumnLayout | None,
        names: tuple[str, ...] | None,
        joints: int | Sequence[str] | None,
    ) -> int | None:
        """Return the number of joints that have columns, or None where nothing states it."""
        if names is not None:
            return len(names)
        listed = [len(m.columns) for m in self.quantities.values() if isinstance(m.columns, tuple)]
        if base is not None and base.joints:
            listed.append(base.joints)
        if joints is not None:
            listed.append(joints if isinstance(joints, int) else len(joints))
        return max(listed, default=None)

    def _columns(
        self,
        mapped: MappedQuantity,
        standard: tuple[LayoutColumn, ...] | None,
        count: int | None,
        names: tuple[str, ...] | None,
        where: str,
    ) -> tuple[LayoutColumn, ...]:
        if mapped.columns is None:
            if standard is None:
                raise RecordingError(f"{where}: expected columns = ...: the file's format has none")
            return standard
        if isinstance(mapped.columns, tuple):
            return tuple(LayoutColumn(name) for name in mapped.columns)
        if count is None:
            raise RecordingError(f"{where}, columns: expected a list, or joints = [...] beside it")
        if "{joint}" in mapped.columns and names is None:
            raise RecordingError(f"{where}, columns: {{joint}} needs joints = [...] beside it")
        return tuple(
            LayoutColumn(
                mapped.columns.replace("{joint}", "" if names is None else names[i])
                .replace("{number}", str(i + 1))
                .replace("{index}", str(i))
            )
            for i in range(count)
        )


def _factors(
    mapped: MappedQuantity, quantity: str, columns: tuple[LayoutColumn, ...], where: str
) -> list[float]:
    """SI units in one unit of each column."""
    count = len(columns)
    if len(mapped.factors) not in (1, count):
        raise RecordingError(
            f"{where}: {len(mapped.factors)} numbers of sign, constant or gear; expected {count},"
            " one for each joint, or one"
        )
    if mapped.unit is None:
        units = [column.factor for column in columns]
    else:
        current = si_factor(mapped.unit, "current") if quantity == "torque" else None
        if current is not None and not mapped.has_constant:
            raise RecordingError(
                f"{where}: {mapped.unit} is a current; expected constant = ..., the torque constant"
                " [N m/A] of each joint, and gear = ..., its gear ratio; constants that are not"
                " known: jaxcslc constants, from recordings with and without a known payload"
            )
        factor = current or si_factor(mapped.unit, quantity) or 1.0
        units = [factor] * count
    factors = mapped.factors * count if len(mapped.factors) == 1 else mapped.factors
    return [unit * factor for unit, factor in zip(units, factors, strict=True)]


def _mapped(table: Any, quantity: str, where: str) -> MappedQuantity:
    if not isinstance(table, Mapping):
        raise RecordingError(f"{where}: expected a table, got {table!r}")
    allowed = _TABLE_KEYS if quantity == "torque" else _TABLE_KEYS - {"constant", "gear"}
    allowed = {"columns", "unit"} if quantity == "time" else allowed
    _check_keys(table, allowed, where)
    columns = table.get("columns")
    if columns is not None and not isinstance(columns, str):
        columns = _texts(columns, f"{where}, columns")
    if quantity == "time" and isinstance(columns, tuple) and len(columns) != 1:
        raise RecordingError(f"{where}, columns: expected one column, got {list(columns)}")
    unit = _text(table.get("unit"), f"{where}, unit")
    kinds = (quantity, "current") if quantity == "torque" else (quantity,)
    if unit is not None and all(si_factor(unit, kind) is None for kind in kinds):
        listed = "; ".join(listed_units(kind) for kind in kinds)
        raise RecordingError(f"{where}, unit: expected {listed}, got {unit!r}")
    factors = [1.0]
    for key in ("sign", "constant", "gear"):
        if key in table:
            numbers = _numbers(table[key], f"{where}, {key}")
            if len(factors) > 1 and len(numbers) not in (1, len(factors)):
                raise RecordingError(
                    f"{where}, {key}: expected {len(factors)} numbers, got {len(numbers)}"
                )
            count = max(len(factors), len(numbers))
            factors, numbers = (v * count if len(v) == 1 else v for v in (factors, numbers))
            factors = [a * b for a, b in zip(factors, numbers, strict=True)]
    return MappedQuantity(columns, unit, tuple(factors), "constant" in table)


def _numbers(value: Any, where: str) -> list[float]:
    values = value if isinstance(value, list) else [value]
    for number in values:
        real = isinstance(number, int | float) and not isinstance(number, bool)
        if not real or not math.isfinite(number) or number == 0:
            raise RecordingError(f"{where}: expected finite numbers other than 0, got {value!r}")
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
