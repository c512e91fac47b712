"""Frozen records as plain data, and back: what JSON can hold of a dataclass by its annotations."""

import dataclasses
import math
import types
from collections.abc import Mapping
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
