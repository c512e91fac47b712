from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Float


X = TypeVar("X")
# Intermediate values of so many samples fit in a processor's second cache: a Panda's regressor
# takes 4 microseconds a sample in blocks of 500 to 1,000 and 30 in one piece of 20,000.
_BLOCK = 512
# NumPy's calls take a microsecond each beside their work: fewer, larger blocks.
_HOST_BLOCK = 4096


def in_blocks(
    function: Callable[..., Array], arrays: tuple[Array, ...], *, samples_first: bool = False
) -> Array:
    """`function` of arrays (rows, samples), computed block by block of samples, results joined.

    The result of `function` has its samples last, or first with `samples_first`. A GPU computes
    all samples at once.
    """
    samples = arrays[0].shape[-1]
    if samples <= _BLOCK or jax.default_backend() != "cpu":
        return function(*arrays)
    blocks = -(-samples // _BLOCK)
    missing = blocks * _BLOCK - samples

    def cut(x: Array) -> Array:
        filled = jnp.pad(x, ((0, 0), (0, missing)))
        return jnp.swapaxes(filled.reshape(x.shape[0], blocks, _BLOCK), 0, 1)

    def of_block(block: tuple[Any, ...]) -> Array:
        return function(*block)

    results = lax.map(of_block, tuple(cut(x) for x in arrays))
    if samples_first:
        return results.reshape(blocks * _BLOCK, *results.shape[2:])[:samples]
    joined = jnp.moveaxis(results, 0, -2)
    return joined.reshape(*joined.shape[:-2], blocks * _BLOCK)[..., :samples]


def in_host_blocks(
    function: Callable[..., Sequence[np.ndarray]],
    arrays: tuple[Float[np.ndarray, "_ samples"], ...],
    rows: int,
) -> Float[np.ndarray, "results samples"]:
    """`function` of NumPy's arrays, computed block by block of samples.

    - `rows`: how many arrays, of the block's samples, `function` returns.
    """
    samples = arrays[0].shape[-1]
    results = np.empty((rows, samples), arrays[0].dtype)
    for start in range(0, samples, _HOST_BLOCK):
        block = slice(start, start + _HOST_BLOCK)
        for row, values in zip(results, function(*(x[:, block] for x in arrays)), strict=True):
            row[block] = values
    return results


def in_stage(function: Callable[[X], list[Any]], x: X) -> list[Any]:
    """`function(x)`, compiled apart from what follows, its results held in memory.

    XLA fuses cheap producers into every consumer, which here means recomputing a product of
    sines and cosines in each place where it is used. On the CPU `lax.optimization_barrier` is
    removed before fusion and changes nothing. A conditional is not fused across, so this is one
    whose condition always holds, in a form that the compiler does not see through. Measured on
    the PUMA 560's regressor, 2,048 patterns a block: 0.4 million patterns/s without, 1.1 with,
    on one core of a busy machine.

    Outside of `jit` nothing is fused, and a conditional would be compiled anew at every call.
    """
    first = jax.tree.leaves(x)[0]
    if first.size == 0 or not isinstance(first, Tracer):
        return function(x)
    shapes = jax.eval_shape(function, x)
    number = jnp.ravel(first)[0]
    return jax.lax.cond(
        ~((number > 0) & (number < 0)),
        function,
        lambda _: [jnp.zeros(shape.shape, shape.dtype) for shape in shapes],
        x,
    )
