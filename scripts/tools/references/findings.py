"""What differs between two outputs: numbers by their limits, all else exactly."""

import csv
import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from scripts.tools.references.commands import Limits


FLOOR = 1e-5
# Of files' formats and of their writer, not of results.
_IGNORED_KEYS = ("version",)
_IGNORED_TEXT = re.compile(
    r"\d{4}-\d\d-\d\d(?:[T ]\d\d:\d\d(?::\d\d(?:\.\d+)?)?)?"  # dates
    r"|jaxcslc,? (?:version )?\d+(?:\.\d+)+\S*"
)
_COEFFICIENTS = ("k", "free_k", "value")
_COVARIANCES = ("covariance", "independent_covariance")
_NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.]*\w)")
_BINARY = (".npz", ".npy", ".parquet", ".png", ".gz")


@dataclass
class Findings:
    """What differs between two outputs of a reference.

    **Attributes**

    - `limits`: of numbers.
    - `ignored`: patterns of entries that are not compared, as in `*.html*`.
    - `errors`: greatest difference of a coefficient, in standard errors.
    - `relative`: greatest relative difference of other numbers.
    - `different`: entries where something is over the limits, missing or not equal.
    - `new`: keys and files that only the new output has.
    """

    limits: Limits
    ignored: Sequence[str] = ()
    errors: float = 0.0
    relative: float = 0.0
    different: list[str] = field(default_factory=list[str])
    new: list[str] = field(default_factory=list[str])

    def folders(self, old: Path, new: Path) -> None:
        """Compares all files of two folders."""
        first, second = (
            {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
            for folder in (old, new)
        )
        for name in sorted(first | second):
            if self._ignores(name):
                continue
            if name not in second:
                self.different.append(f"{name}: missing")
            elif name not in first:
                self.new.append(name)
            else:
                self._files(old / name, new / name, name)

    def documents(self, old: Any, new: Any, entry: str, scale: Any = None) -> None:
        """Compares two values of JSON.

        - `scale`: standard errors of the coefficients, where they are known.
        """
        if self._ignores(entry):
            return
        if isinstance(old, dict) and isinstance(new, dict):
            self._objects(old, new, entry, scale)
            return
        first, second = _array(old), _array(new)
        if first is not None and second is not None:
            counted = isinstance(old, int) and isinstance(new, int)
            self._arrays(first, second, entry, scale, counted=counted)
        elif isinstance(old, list) and isinstance(new, list):
            if len(old) != len(new):
                self.different.append(f"{entry}: {len(new)} values in place of {len(old)}")
            for number, (one, other) in enumerate(zip(old, new, strict=False)):
                self.documents(one, other, f"{entry}[{number}]", scale)
        elif isinstance(old, str) and isinstance(new, str):
            self.texts(old, new, entry)
        elif old is not new and (type(old) is not type(new) or old != new):
            self.different.append(f"{entry}: {_short(new)} in place of {_short(old)}")

    def texts(self, old: str, new: str, entry: str) -> None:
        """Compares two texts: words, and numbers by as many digits as are printed."""
        lines, others = old.splitlines(), new.splitlines()
        if len(lines) != len(others):
            self.different.append(f"{entry}: {len(others)} lines in place of {len(lines)}")
        for number, (line, other) in enumerate(zip(lines, others, strict=False), start=1):
            if line == other:
                continue
            where = entry if len(lines) == 1 else f"{entry}:{number}"
            problem = self._lines(line, other)
            if problem:
                self.different.append(f"{where}: {problem}")
                if len(lines) != len(others):
                    return  # lines that follow are not those that belong together

    def tables(self, old: str, new: str, entry: str) -> None:
        """Compares two tables of CSV, column by column."""
        rows, others = (list(csv.reader(text.splitlines())) for text in (old, new))
        if not rows or not others or len(rows) != len(others):
            if len(rows) != len(others):
                self.different.append(f"{entry}: {len(others)} rows in place of {len(rows)}")
            return
        columns, new_columns = (
            dict(zip(table[0], zip(*table[1:], strict=True), strict=False))
            for table in (rows, others)
        )
        scale = _column(columns.get("standard_error", ()))
        self.new += [f"{entry}.{name}" for name in new_columns if name not in columns]
        for name, column in columns.items():
            where = f"{entry}.{name}"
            if self._ignores(where):
                continue
            if name not in new_columns:
                self.different.append(f"{where}: missing")
                continue
            first, second = _column(column), _column(new_columns[name])
            if first is not None and second is not None:
                self._arrays(first, second, where, scale)
                continue
            for number, (one, other) in enumerate(
                zip(column, new_columns[name], strict=True), start=2
            ):
                self.texts(one, other, f"{where}:{number}")

    def _ignores(self, entry: str) -> bool:
        return any(fnmatchcase(entry, pattern) for pattern in self.ignored)

    def _files(self, old: Path, new: Path, name: str) -> None:
        one, other = old.read_bytes(), new.read_bytes()
        if one == other:
            return
        if name.endswith(_BINARY):
            self.different.append(f"{name}: other bytes")
            return
        first, second = one.decode("utf-8"), other.decode("utf-8")
        if name.endswith(".json"):
            self.documents(json.loads(first), json.loads(second), name)
        elif name.endswith(".csv"):
            self.tables(first, second, name)
        else:
            self.texts(first, second, name)

    def _objects(self, old: Any, new: Any, entry: str, scale: Any) -> None:
        if "standard_error" in old:
            scale = _array(old["standard_error"])
        names = [name for name in new if name not in old]
        self.new += [f"{entry}.{name}" for name in names if name not in _IGNORED_KEYS]
        for name, value in old.items():
            if name in _IGNORED_KEYS:
                continue
            if name in new:
                self.documents(value, new[name], f"{entry}.{name}", scale)
            elif not self._ignores(f"{entry}.{name}"):
                self.different.append(f"{entry}.{name}: missing")

    def _arrays(
        self, old: np.ndarray, new: np.ndarray, entry: str, scale: Any, *, counted: bool = False
    ) -> None:
        if old.shape != new.shape:
            self.different.append(f"{entry}: shape {new.shape} in place of {old.shape}")
            return
        if not np.array_equal(np.isfinite(old), np.isfinite(new)):
            self.different.append(f"{entry}: not finite in other places")
            return
        if np.array_equal(old, new, equal_nan=True):
            return
        with np.errstate(invalid="ignore", divide="ignore"):
            change = np.abs(new - old)
            size = np.maximum(np.maximum(np.abs(old), np.abs(new)), FLOOR * _greatest(old))
            change = np.where(np.isfinite(old), change, np.where(old == new, 0.0, np.inf))
            change = np.where(np.isnan(old) & np.isnan(new), 0.0, change)
        key = entry.rpartition(".")[2]
        in_errors = np.zeros(old.shape, bool)
        if key in _COEFFICIENTS and scale is not None and scale.shape == old.shape:
            in_errors = np.isfinite(scale) & (scale > 0)
            size = np.where(in_errors, scale, size)
        elif key in _COVARIANCES and old.ndim == 2 and old.shape[0] == old.shape[1]:
            deviation = np.sqrt(np.abs(np.diag(old)))
            size = np.maximum(size, deviation[:, None] * deviation)
        with np.errstate(invalid="ignore", divide="ignore"):
            part = np.where(change == 0, 0.0, change / size)
        if in_errors.any():
            self.errors = max(self.errors, float(np.max(part[in_errors])))
        if not in_errors.all():
            self.relative = max(self.relative, float(np.max(part[~in_errors])))
        over = part > np.where(in_errors, self.limits.errors, self.limits.relative)
        if counted or over.any():
            worst = int(np.argmax(part))
            unit = "standard errors" if in_errors.flat[worst] else "relatively"
            which = f"[{worst}]" if old.size > 1 else ""
            self.different.append(
                f"{entry}{which}: {new.flat[worst]:.10g} in place of {old.flat[worst]:.10g},"
                f" {part.flat[worst]:.2g} {unit}"
            )

    def _lines(self, old: str, new: str) -> str | None:
        """What differs between two lines, if anything."""
        old, new = (_IGNORED_TEXT.sub("", line) for line in (old, new))
        words, other_words = (" ".join(_NUMBER.sub("#", line).split()) for line in (old, new))
        if words != other_words:
            return f"{_excerpt(words, other_words)}"
        pairs = [*zip(_NUMBER.findall(old), _NUMBER.findall(new), strict=True)]
        numbers = [(float(one), float(other)) for one, other in pairs]
        greatest = max((abs(one) for one, _ in numbers if math.isfinite(one)), default=0.0)
        for (one, other), (first, second) in zip(pairs, numbers, strict=True):
            if one == other or first == second:
                continue
            size = max(abs(first), abs(second), FLOOR * greatest)
            # A little more, for the difference of two printed numbers is rounded.
            beyond = max(abs(second - first) - (1 + 1e-6) * _last_digit(one, other), 0.0)
            self.relative = max(self.relative, beyond / size)
            if beyond > self.limits.relative * size:
                return f"{other} in place of {one}"
        return None


def _array(value: Any) -> Float[np.ndarray, "..."] | None:
    """A number, or numbers in lists of one shape, as an array; None for anything else."""
    if not _numeric(value):
        return None
    try:
        return np.asarray(value, dtype=np.float64)  # null becomes not a number
    except ValueError:
        return None


def _numeric(value: Any) -> bool:
    if isinstance(value, list):
        return bool(value) and all(v is None or _numeric(v) for v in value)
    return isinstance(value, int | float) and not isinstance(value, bool)


def _column(cells: Sequence[str]) -> Float[np.ndarray, " rows"] | None:
    """Cells of a table as numbers; None if one is text, or there are none."""
    try:
        return np.array([float(cell or "nan") for cell in cells]) if cells else None
    except ValueError:
        return None


def _greatest(values: np.ndarray) -> float:
    finite = np.abs(values[np.isfinite(values)])
    return float(finite.max()) if finite.size else 0.0


def _last_digit(one: str, other: str) -> float:
    """What one unit of the last digit is worth that either number was printed with.

    Trailing zeros may not have been printed. Of two small counts it is nothing.

    >>> [_last_digit(*pair) for pair in (("0.25", "0.26"), ("1e3", "999"), ("12", "11"))]
    [0.01, 1.0, 0.0]
    """
    if all(
        len(number.lstrip("+-")) < 3 and number.lstrip("+-").isdigit() for number in (one, other)
    ):
        return 0.0
    units: list[float] = []
    for number in (one, other):
        digits, _, exponent = number.lower().partition("e")
        units.append(10.0 ** (int(exponent or 0) - len(digits.partition(".")[2])))
    return min(units)


def _excerpt(old: str, new: str) -> str:
    start = next((i for i, (a, b) in enumerate(zip(old, new, strict=False)) if a != b), 0)
    first = max(0, start - 20)
    return f"{_short(new[first:])} in place of {_short(old[first:])}"


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:60]}…"
