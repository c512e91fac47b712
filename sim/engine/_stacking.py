import dataclasses
from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np


Parts = TypeVar("Parts")


def stacked(parts: Sequence[Parts], shared: tuple[str, ...] = ()) -> Parts:
    """One dataclass of arrays from several: their arrays, stacked along a new first axis.

    **Arguments**

    - `parts`: instances of one dataclass whose every field is an array.
    - `shared`: fields that are the same in all and keep their shape.
    """
    first: Any = parts[0]
    return dataclasses.replace(
        first,
        **{
            field.name: np.stack([getattr(part, field.name) for part in parts])
            for field in dataclasses.fields(first)
            if field.name not in shared
        },
    )
