from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array


X = TypeVar("X")


def in_stage(function: Callable[[X], list[Array]], x: X) -> list[Array]:
    """`function(x)`, compiled apart from what follows, its results held in memory.

    XLA fuses cheap producers into every consumer, which here means recomputing a product of
    sines and cosines in each place where it is used. On the CPU `lax.optimization_barrier` is
    removed before fusion and changes nothing. A conditional is not fused across, so this is one
    whose condition always holds, in a form that the compiler does not see through. Measured on
    the PUMA 560's regressor, 2,048 patterns a block: 0.4 million patterns/s without, 1.1 with,
    on one core of a busy machine.
    """
    first = jax.tree.leaves(x)[0]
    if first.size == 0:
        return function(x)
    shapes = jax.eval_shape(function, x)
    number = jnp.ravel(first)[0]
    return jax.lax.cond(
        ~((number > 0) & (number < 0)),
        function,
        lambda _: [jnp.zeros(shape.shape, shape.dtype) for shape in shapes],
        x,
    )
