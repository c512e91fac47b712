import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from ._solution import RESULTS


_VERSION = 1
_RESULTS = ("successful", "rank_deficient", "no_equations", "nonfinite")
# Entries and their shapes, in coefficients (p) and joints (n).
_ARRAYS = {
    "k": "p",
    "standard_error": "p",
    "covariance": "pp",
    "independent_covariance": "pp",
    "torque_error": "n",
    "equations": "n",
    "effective_equations": "n",
    "degrees_of_freedom": "",
    "rank": "",
    "condition": "",
    "undetermined": "pp",
    "determined": "p",
}
_INTEGERS = ("rank",)
_TRUTHS = ("determined",)
# What may be infinite, and is written as null.
_OPEN = ("standard_error",)


def document_of(fit: Any) -> dict[str, Any]:
    """An `Identification` as plain data."""
    result = next(name for name in _RESULTS if bool(fit.result == getattr(RESULTS, name)))
    return {
        "version": _VERSION,
        "names": list(fit.names),
        "errors": fit.errors,
        "result": result,
        **{name: _plain(np.asarray(getattr(fit, name)).tolist()) for name in _ARRAYS},
    }


def _plain(value: Any) -> Any:
    if isinstance(value, list):
        return [_plain(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_document(path: Path, document: Mapping[str, Any]) -> None:
    """As JSON."""
    path.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def read_document(path: Path) -> dict[str, Any]:
    """**Raises** `ValueError` in one line unless a file holds a JSON object."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(f"{path}: not valid JSON: {error}") from None
    if not isinstance(document, dict):
        raise ValueError(f"{path}: expected an identification as a JSON object")
    return document


def arrays_from(document: Mapping[str, Any], where: str) -> dict[str, Any]:
    """The fields of an `Identification` from what `document_of` made.

    **Raises** `ValueError` naming the entry that is missing or wrong.
    """
    if "freedom" in document:  # its name in files of earlier versions
        document = {**document, "degrees_of_freedom": document["freedom"]}
    for name in ("version", "names", "errors", "result", *_ARRAYS):
        if name not in document:
            raise ValueError(f"{where}: no entry {name!r}; expected a saved identification")
    if document["version"] != _VERSION:
        raise ValueError(f"{where}: version is {document['version']!r}; expected {_VERSION}")
    names = document["names"]
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ValueError(f"{where}: names: expected a list of names")
    if document["errors"] not in ("independent", "correlated"):
        raise ValueError(f"{where}: errors: expected 'independent' or 'correlated'")
    if document["result"] not in _RESULTS:
        raise ValueError(f"{where}: result: expected one of {', '.join(_RESULTS)}")
    equations = document["equations"]
    sizes = {"p": len(names), "n": len(equations) if isinstance(equations, list) else 0}
    fields = {
        name: _array(document[name], name, tuple(sizes[axis] for axis in axes), where)
        for name, axes in _ARRAYS.items()
    }
    return {
        **fields,
        "result": getattr(RESULTS, document["result"]),
        "names": tuple(names),
        "errors": document["errors"],
    }


def _array(value: Any, name: str, shape: tuple[int, ...], where: str) -> Any:
    expected = f"{where}: {name}: expected numbers of shape {shape}"
    try:
        array = np.asarray(value, dtype=float)  # None becomes NaN
    except (TypeError, ValueError):
        raise ValueError(expected) from None
    if array.shape != shape:
        raise ValueError(f"{expected}, got {array.shape}")
    if name in _OPEN:
        array = np.where(np.isnan(array), np.inf, array)
    dtype = int if name in _INTEGERS else bool if name in _TRUTHS else float
    return jnp.asarray(array.astype(dtype))
