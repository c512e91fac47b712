from typing import Any, no_type_check

import jax
import numpy as np


Array = np.ndarray | jax.Array
"""An array of either library, a tracer included. Code for both uses the functions of
`xp = array.__array_namespace__()` (Python Array API), does not modify arrays, and has no branch
on an array's value or on the time."""


# Called many times a sample: tests check the annotations of the callers instead.
@no_type_check
def namespace(array: Array) -> Any:
    """The library of an array: `numpy` or `jax.numpy`."""
    return array.__array_namespace__()


@no_type_check
def spread(values: np.ndarray, like: Array) -> Array:
    """Constants for every row of another array (*batch, n): in its library, of its type, and with
    an axis of one for each of its batch axes. JAX then need not promote ranks, which
    a setting can forbid. NumPy needs nothing of that: its constants are returned as they are."""
    if isinstance(like, np.ndarray) and like.dtype == values.dtype:
        return values
    shape = (1,) * (like.ndim - 1) + values.shape
    return namespace(like).asarray(values.reshape(shape), dtype=like.dtype)
