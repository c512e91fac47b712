from typing import Any, no_type_check

import jax
import numpy as np


Array = np.ndarray | jax.Array
"""An array of either library, a tracer included. Code for both asks the array itself for the
functions to use, `xp = array.__array_namespace__()` (Python Array API), writes nothing in place
and decides nothing by an array's value or by the time."""


# Called many times a sample: tests check the annotations of those who call, not these.
@no_type_check
def namespace(array: Array) -> Any:
    """The library of an array: `numpy` or `jax.numpy`."""
    return array.__array_namespace__()


@no_type_check
def spread(values: np.ndarray, like: Array) -> Array:
    """Constants for every row of another array (*batch, n): in its library, of its type, and with
    an axis of one for each of its batch axes. JAX need not promote ranks then, which it can be
    told to refuse."""
    shape = (1,) * (like.ndim - 1) + values.shape
    return namespace(like).asarray(values.reshape(shape), dtype=like.dtype)
