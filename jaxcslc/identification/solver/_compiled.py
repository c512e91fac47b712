import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ...motion import Patterns
from ...network import AbstractLinearNetwork


# Tracing a network takes longer than computing this many patterns with it.
_FEWEST_ROWS = 4096


def filled_up(
    x: Float[Array | np.ndarray, "samples columns"],
) -> Float[Array, "rows columns"]:
    """Zero rows behind the end, to the next power of two.

    So that recordings of similar lengths share one compiled function. Zeros are patterns of
    weight zero, or are cut off again.
    """
    rows = max(_FEWEST_ROWS, 1 << (x.shape[0] - 1).bit_length())
    widths = ((0, rows - x.shape[0]), (0, 0))
    # NumPy's own arrays are filled up by NumPy: nothing to compile, as `jnp.asarray` would.
    return jax.device_put(np.pad(x, widths)) if isinstance(x, np.ndarray) else jnp.pad(x, widths)


def regressor_of(
    network: AbstractLinearNetwork, patterns: Patterns
) -> Float[Array | np.ndarray, "samples joints coefficients"]:
    """The regressor of patterns; compiled once for all recordings of similar lengths."""
    q, qd, qdd = (filled_up(x) for x in (patterns.q, patterns.qd, patterns.qdd))
    filled = _regressor(network, q, qd, qdd)
    # NumPy's slice shares the memory; JAX's is a program to compile for each number of samples.
    rows = filled if isinstance(filled, Tracer) else np.asarray(filled)
    return rows[: len(patterns.q)]


@eqx.filter_jit
def _regressor(network: AbstractLinearNetwork, q: Array, qd: Array, qdd: Array) -> Array:
    return network.regressor(q, qd, qdd)
