import dataclasses
import hashlib
import math
from collections.abc import Mapping, Sequence
from enum import Enum
from fractions import Fraction
from typing import Any

import numpy as np


def fingerprint(*values: Any) -> str:
    """A hash of the content of values: equal values have the same hash in every process.

    It names the file of a recording by its machine, trajectory and seed.

    **Arguments**

    - `values`: numbers, text, arrays, and sequences, mappings and dataclasses of them.

    **Returns**

    Forty hexadecimal digits.

    **Raises**

    - `TypeError`: a value of another type.

    >>> import sim
    >>> from sim.recording._fingerprint import fingerprint
    >>> fingerprint(sim.puma560(), 1) == fingerprint(sim.puma560(), 1)
    True
    >>> fingerprint(sim.puma560(), 1) == fingerprint(sim.puma560(), 2)
    False
    """
    digest = hashlib.sha256()
    for part in _parts(values):
        digest.update(len(part).to_bytes(8, "big"))
        digest.update(part)
    return digest.hexdigest()[:40]


def _parts(value: Any) -> list[bytes]:
    kind = type(value).__qualname__.encode()
    if value is None or isinstance(value, (bool, int, str, Fraction)):
        return [kind, str(value).encode()]
    if isinstance(value, float):
        return [b"float", (b"nan" if math.isnan(value) else value.hex().encode())]
    if isinstance(value, Enum):
        return [kind, value.name.encode()]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = [(field.name, getattr(value, field.name)) for field in dataclasses.fields(value)]
        return [kind, *_parts(fields)]
    if isinstance(value, Mapping):
        return [b"mapping", *_parts(sorted(value.items()))]
    if isinstance(value, Sequence):
        return [b"sequence", str(len(value)).encode(), *(p for item in value for p in _parts(item))]
    if hasattr(value, "__array__"):
        array = np.asarray(value)
        if array.dtype == object:
            raise TypeError(f"no name for an array of {type(array.flat[0]).__name__}")
        return [str((array.dtype.str, array.shape)).encode(), array.tobytes()]
    raise TypeError(f"no name for a {type(value).__name__}; expected numbers, text or dataclasses")
