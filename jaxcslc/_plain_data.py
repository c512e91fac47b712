"""Frozen records as plain data, and back: what JSON can hold of a dataclass by its annotations.

`toml_document` reads TOML files, and `check_field_types` checks entries of settings.
"""

import dataclasses
import math
import os
import tomllib
import types
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
from jaxtyping import Array


_OPEN = {math.inf: "inf", -math.inf: "-inf"}


def plain(value: Any) -> Any:
    """Return data as JSON holds them: lists, dictionaries, texts and numbers; None for no number.

    >>> import numpy as np
    >>> plain({"rms": np.array([1.0, np.nan]), "joints": ("shoulder", "elbow")})
    {'rms': [1.0, None], 'joints': ['shoulder', 'elbow']}
    """
    if isinstance(value, np.ndarray | np.generic | Array):
        value = np.asarray(value).tolist()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(name): plain(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        if set(map(type, value)) == {float} and all(map(math.isfinite, value)):
            return list(value)  # ten times as quick for the many numbers of a chart
        return [plain(entry) for entry in value]
    return value


def record_document(record: Any) -> Any:
    """Return a dataclass, with all dataclasses in it, as plain data that `record_from` reads.

    Infinite numbers are written as texts, so that they are read as they were.

    >>> from jaxcslc.manipulator import JointLimits
    >>> record_document(JointLimits(-1.0, 1.0))
    {'low': -1.0, 'high': 1.0, 'speed': 'inf', 'torque': 'inf'}
    """
    if dataclasses.is_dataclass(record):
        return {
            field.name: record_document(getattr(record, field.name))
            for field in dataclasses.fields(record)
        }
    if isinstance(record, Mapping):
        return {name: record_document(value) for name, value in record.items()}
    if isinstance(record, np.ndarray | np.generic | Array):
        return record_document(np.asarray(record).tolist())
    if isinstance(record, tuple | list):
        return [record_document(value) for value in record]
    return _OPEN.get(record, record) if isinstance(record, float) else record


def record_from(kind: Any, document: Any) -> Any:
    """Return what `record_document` was made of.

    **Arguments**

    - `kind`: a dataclass, or an annotation of its fields: numbers, texts, tuples, named or not,
      mappings, arrays, and unions of these.
    - `document`: plain data.

    **Raises**

    - `TypeError`, `ValueError`: the document is of another kind.

    >>> from jaxcslc.manipulator import JointLimits
    >>> record_from(JointLimits, {"low": -1.0, "high": 1.0, "speed": "inf", "torque": 2.0}).speed
    inf
    """
    origin, parts = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return None if document is None else record_from(_alternative(parts, document), document)
    if dataclasses.is_dataclass(kind):
        hints = get_type_hints(kind)
        if not isinstance(document, Mapping):
            raise TypeError(f"expected entries, got {document!r}")
        return kind(**{name: record_from(hints[name], value) for name, value in document.items()})  # type: ignore[operator]
    if fields := getattr(kind, "_fields", None):  # a named tuple
        hints = get_type_hints(kind)
        pairs = zip(fields, document, strict=True)
        return kind(*(record_from(hints[name], value) for name, value in pairs))
    if origin is tuple:
        kinds = parts[:1] * len(document) if parts[1:] == (...,) else parts
        return tuple(record_from(*pair) for pair in zip(kinds, document, strict=True))
    if origin is not None and isinstance(document, Mapping):
        return {name: record_from(parts[1], value) for name, value in document.items()}
    if kind is float:
        return float(document)
    if origin is Literal or kind in (str, int, bool):
        if not (document in parts if origin is Literal else type(document) is kind):
            raise TypeError(f"expected {parts or kind.__name__}, got {document!r}")
        return document
    return np.array(document, float) if isinstance(document, list) else float(document)


def _alternative(parts: tuple[Any, ...], document: Any) -> Any:
    """Return the part of a union that a document is of: the first that has its form."""
    size = len(document) if isinstance(document, list) else None

    def fits(part: Any) -> bool:
        arguments = get_args(part)
        if get_origin(part) is tuple:
            return size is not None and (arguments[1:] == (...,) or len(arguments) == size)
        record = dataclasses.is_dataclass(part) or get_origin(part) is not None
        return record == isinstance(document, Mapping) and (size is None or part is not float)

    kinds = [part for part in parts if part is not type(None)]
    return next((part for part in kinds if fits(part)), kinds[0])


# How a person says what a field expects.
_NAMES = {float: "a number", int: "a whole number", bool: "true or false", str: "a text"}


def check_field_types(kind: type, values: Mapping[str, Any], prefix: str) -> None:
    """Check entries of a file against the annotations of the class that they will make.

    Only what a file can hold is checked: numbers, texts, lists and what is absent. Names that the
    class does not have, and what its constructor checks itself, are left to it.

    **Arguments**

    - `kind`: a dataclass or `equinox.Module`.
    - `values`: its fields by name, lists as tuples.
    - `prefix`: of the message, such as `"settings"`.

    **Raises**

    - `ValueError`: naming the entry, what was expected and what it is.

    >>> from jaxcslc.recordings import Preparation
    >>> check_field_types(Preparation, {"trim": "x"}, "settings")
    Traceback (most recent call last):
    ValueError: settings, trim: expected a whole number or nothing, got 'x'
    """
    hints = get_type_hints(kind)
    for name, value in values.items():
        if name in hints and not _fits(value, hints[name]):
            raise ValueError(
                f"{prefix}, {name}: expected {_described(hints[name])}, got {_shown(value)}"
            )


def _alternatives(hint: Any) -> tuple[Any, ...]:
    if get_origin(hint) in (Union, types.UnionType):
        return tuple(one for part in get_args(hint) for one in _alternatives(part))
    return (hint,)


def _fits(value: Any, hint: Any) -> bool:
    return any(_fits_one(value, one) for one in _alternatives(hint))


def _fits_one(value: Any, hint: Any) -> bool:
    if get_origin(hint) is Literal:
        # A wrong text is the constructor's to refuse: it says which there are.
        return isinstance(value, str)
    if get_origin(hint) is tuple:
        entry = get_args(hint)[0]
        return isinstance(value, tuple) and all(_fits(part, entry) for part in value)
    if hint is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    if hint is int:
        return isinstance(value, int) and not isinstance(value, bool)
    if hint in (str, bool, type(None)):
        return isinstance(value, hint)
    return True


def _described(hint: Any) -> str:
    words: list[str] = []
    for one in _alternatives(hint):
        if get_origin(one) is tuple:
            words.append("a list of numbers")
        elif get_origin(one) is Literal:
            words.append(" or ".join(map(repr, get_args(one))))
        else:
            words.append("nothing" if one is type(None) else _NAMES.get(one, "an entry"))
    return " or ".join(dict.fromkeys(words))


def _shown(value: Any) -> str:
    return repr(list(value) if isinstance(value, tuple) else value)


def toml_document(
    path: str | os.PathLike[str], what: str, error: type[ValueError]
) -> dict[str, Any]:
    """Return the content of a TOML file, or one table of it.

    **Arguments**

    - `path`: of the file, in UTF-8. If it ends in `#` and a name, the table of that name is read.
    - `what`: the file is, for the message if it is missing, as in `"robot file"`.
    - `error`: the class of what is raised.

    **Raises**

    - `error`: the file is missing, cannot be read, or is not valid TOML; one line that names it.
      Also if it has no such table.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "arm.toml"
    ...     _ = file.write_text("a = 0.5", encoding="utf-8")
    ...     toml_document(file, "robot file", ValueError)
    ...     _ = file.write_text("[columns]\\nunit = 'deg'", encoding="utf-8")
    ...     toml_document(f"{file}#columns", "file of columns", ValueError)
    {'a': 0.5}
    {'unit': 'deg'}
    """
    whole, _, name = str(path).rpartition("#")
    if whole.endswith(".toml"):
        table = toml_document(whole, what, error).get(name)
        if not isinstance(table, dict):
            raise error(f"{whole}: has no table {name!r}")
        return table
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise error(f"{path}: no such {what}") from None
    except (OSError, UnicodeDecodeError) as reason:
        raise error(f"{path}: cannot be read: {reason}") from None
    except (tomllib.TOMLDecodeError, RecursionError) as reason:
        raise error(f"{path}: not valid TOML: {reason}") from None
