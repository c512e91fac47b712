from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap


def batched_by(
    function: Callable[..., Any], many: Callable[..., Any], mapped_count: int
) -> Callable[..., Any]:
    """A function of one training, with another one in place of its `vmap`, and of that's again.

    - `many`: of many trainings at once, with an axis of them on its first arguments and on its
      result.
    - `mapped_count`: how many first arguments trainings have of their own. What follows they
      share; where it is mapped over, `function` is.
    """
    single: Any = custom_vmap(function)
    several: Any = custom_vmap(many)

    def mapped(f: Callable[..., Any], batched: list[Any]) -> Callable[..., Any]:
        axes = [jax.tree.map(lambda x: 0 if x else None, part) for part in batched]
        return jax.vmap(f, axes)

    def alike(size: int, arguments: tuple[Any, ...], batched: list[Any]) -> list[Any]:
        """The trainings' own arguments, each with the axis."""
        pairs = zip(arguments[:mapped_count], batched[:mapped_count], strict=True)
        return [x if with_axis else jnp.broadcast_to(x, (size, *x.shape)) for x, with_axis in pairs]

    @single.def_vmap
    def _(size: int, batched: list[Any], *arguments: Any) -> tuple[Any, bool]:
        if any(jax.tree.leaves(batched[mapped_count:])):
            return mapped(function, batched)(*arguments), True
        return several(*alike(size, arguments, batched), *arguments[mapped_count:]), True

    @several.def_vmap
    def _(size: int, batched: list[Any], *arguments: Any) -> tuple[Any, bool]:
        shared = arguments[mapped_count:]
        if any(jax.tree.leaves(batched[mapped_count:])):
            over_trainings = jax.vmap(function, (*(0,) * mapped_count, *(None for _ in shared)))
            return mapped(over_trainings, batched)(*arguments), True
        both = [x.reshape(-1, *x.shape[2:]) for x in alike(size, arguments, batched)]
        flat = several(*both, *shared)
        return flat.reshape(size, -1, *flat.shape[1:]), True

    return single
