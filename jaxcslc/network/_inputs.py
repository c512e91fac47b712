from collections.abc import Callable, Sequence

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..derivation import PositionRing


Samples = Float[Array, "*batch"]


def input_layer(
    ring: PositionRing, q: Sequence[Samples]
) -> Callable[[tuple[int, ...]], Samples]:
    """The preprocessing layer: joint positions to products of sines and cosines (thesis 5.1.1).

    **Returns** a function from monomials (exponents of the ring's variables) to their values at
    `q`, which is one array a joint. Every product is formed once, from the product without its
    last factor.
    """
    variables: list[Samples] = []
    for angle in ring.chain.angles:
        joint, sign = angle.terms[0]
        total = q[joint] if sign > 0 else -q[joint]
        for joint, sign in angle.terms[1:]:
            total = total + q[joint] if sign > 0 else total - q[joint]
        variables += [jnp.cos(total), jnp.sin(total)]
    variables += [q[joint] for joint, link in enumerate(ring.chain.links) if link.prismatic]
    known: dict[tuple[int, ...], Samples] = {(0,) * len(variables): jnp.ones_like(q[0])}

    def value(monomial: tuple[int, ...]) -> Samples:
        if monomial not in known:
            last = max(index for index, power in enumerate(monomial) if power)
            rest = list(monomial)
            rest[last] -= 1
            shorter = tuple(rest)
            known[monomial] = (
                variables[last] if not any(shorter) else value(shorter) * variables[last]
            )
        return known[monomial]

    return value
