"""Systems read from TOML files."""

import keyword
import os
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from .._toml_document import toml_document
from ._system import System
from .description import RESERVED, Constant, DescriptionError, Variable, parse_equation


_KEYS = {"name", "about", "variables", "constants", "equations", "units"}
_VARIABLE_KEYS = {"unit", "column", "rate", "second_rate", "kind"}
_CONSTANT_KEYS = {"unit", "value", "sign", "bounds"}
_TEXTS = {"unit", "column", "rate", "second_rate", "kind", "sign"}


def load_system(path: str | os.PathLike[str]) -> System:
    """Reads a system from a TOML file.

        name = "cart"
        [variables]
        x = { unit = "m" }
        force = { unit = "N" }
        [constants]
        mass = { unit = "kg", sign = "positive" }
        damping = { unit = "N s/m" }
        [equations]
        rail = "force = mass*ddot(x) + damping*dot(x)"

    Entries are those of `Variable` and `Constant`; `[units]` has units of equations. What equations
    may contain is in `docs/systems.md`.

    **Arguments**

    - `path`: of the file.

    **Returns** the system.

    **Raises** `DescriptionError`, one line: the file, where in it, and what was expected.

    >>> import pathlib, tempfile
    >>> from jaxcslc.systems import load_system
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "tank.toml"
    ...     _ = path.write_text('''
    ...         name = "tank"
    ...         variables = { level = { unit = "m" }, inflow = { unit = "m³/s" } }
    ...         constants = { area = { unit = "m²" } }
    ...         equations = { volume = "inflow = area*dot(level)" }
    ...     ''', encoding="utf-8")
    ...     load_system(path).network
    SystemNetwork(tank: 1 equation, 2 variables, 1 coefficient)
    """
    path = Path(path)
    document = toml_document(path, "system file", DescriptionError)
    try:
        return system_from(document, default_name=path.stem)
    except DescriptionError as error:
        raise DescriptionError(f"{path}: {error}") from None


def system_from(document: Mapping[str, Any], *, default_name: str = "system") -> System:
    """A system from a document as `load_system` reads it.

    **Raises** `DescriptionError`.
    """
    from sympy import Symbol
    from sympy.physics.mechanics import dynamicsymbols

    _check_keys(document, _KEYS, "the file")
    tables = {name: _table(document, name) for name in ("variables", "constants", "equations")}
    for name in ("variables", "equations"):
        if not tables[name]:
            raise DescriptionError(f"no [{name}]; expected one or more")
    variables = tuple(
        Variable(dynamicsymbols(_identifier(name)), **_entry(name, entry, _VARIABLE_KEYS))
        for name, entry in tables["variables"].items()
    )
    constants = tuple(
        Constant(Symbol(_identifier(name)), **_entry(name, entry, _CONSTANT_KEYS))
        for name, entry in tables["constants"].items()
    )
    equations: dict[str, Any] = {}
    for name, text in tables["equations"].items():
        if not isinstance(text, str):
            raise DescriptionError(
                f"equation {name!r}: got {text!r}; expected a text, left = right"
            )
        try:
            equations[name] = parse_equation(text, tables["variables"], tables["constants"])
        except DescriptionError as error:
            raise DescriptionError(f"equation {name!r}: {error}") from None
    return System(
        str(document.get("name", default_name)),
        equations,
        variables,
        constants,
        _table(document, "units"),
    )


def _entry(name: str, entry: Any, keys: Collection[str]) -> dict[str, Any]:
    if not isinstance(entry, Mapping):
        raise DescriptionError(f'{name!r} is {entry!r}; expected a table, as in {{ unit = "m" }}')
    _check_keys(entry, keys, repr(name))
    values: dict[str, Any] = {}
    for key, value in entry.items():
        if key in _TEXTS:
            right = isinstance(value, str)
        elif key == "bounds":
            right = isinstance(value, list) and len(value) == 2 and all(map(_is_number, value))
        else:
            right = _is_number(value)
        if not right:
            expected = (
                "a text" if key in _TEXTS else "[LOW, HIGH]" if key == "bounds" else "a number"
            )
            raise DescriptionError(f"{name!r}: {key} is {value!r}; expected {expected}")
        values[key] = tuple(map(float, value)) if key == "bounds" else value
    return values


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _identifier(name: str) -> str:
    if not name.isidentifier() or keyword.iskeyword(name) or name in RESERVED:
        raise DescriptionError(
            f"name {name!r}: expected letters, digits and _, and neither a word of Python nor one"
            f" of {', '.join(RESERVED)}"
        )
    return name


def _table(document: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    table = document.get(name, {})
    if not isinstance(table, Mapping):
        raise DescriptionError(f"[{name}] is {table!r}; expected a table")
    return table


def _check_keys(table: Mapping[str, Any], keys: Collection[str], where: str) -> None:
    if unknown := [key for key in table if key not in keys]:
        raise DescriptionError(
            f"{where}: unknown entry {unknown[0]!r}; expected some of {', '.join(sorted(keys))}"
        )
