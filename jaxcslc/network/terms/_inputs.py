from collections.abc import Callable, Sequence

import jax.numpy as jnp
from jaxtyping import Array, Float

from ...derivation import PositionRing
from ._stages import in_stage


Samples = Float[Array, "*batch"]
Monomial = tuple[int, ...]


def position_variables(ring: PositionRing, q: Sequence[Samples]) -> list[Samples]:
    """Values of the ring's variables: cosine and sine of every angle, prismatic positions.

    `q` is one array a joint.
    """
    variables: list[Samples] = []
    for angle in ring.chain.angles:
        joint, sign = angle.terms[0]
        total = q[joint] if sign > 0 else -q[joint]
        for joint, sign in angle.terms[1:]:
            total = total + q[joint] if sign > 0 else total - q[joint]
        variables += [jnp.cos(total), jnp.sin(total)]
    return variables + [q[i] for i, link in enumerate(ring.chain.links) if link.prismatic]


def products(monomials: Sequence[Monomial], variables: Sequence[Samples]) -> list[Samples]:
    """Values of monomials, each formed once, from the product without its last factor."""
    known: dict[Monomial, Samples] = {(0,) * len(variables): jnp.ones_like(variables[0])}

    def value(monomial: Monomial) -> Samples:
        if monomial not in known:
            last = max(index for index, power in enumerate(monomial) if power)
            rest = list(monomial)
            rest[last] -= 1
            shorter = tuple(rest)
            known[monomial] = (
                variables[last] if not any(shorter) else value(shorter) * variables[last]
            )
        return known[monomial]

    return [value(monomial) for monomial in monomials]


def input_layer(
    ring: PositionRing, monomials: Sequence[Monomial], q: Sequence[Samples]
) -> Callable[[Monomial], Samples]:
    """The preprocessing layer: joint positions to products of sines and cosines (thesis 5.1.1).

    Sines and cosines are a stage of their own: fused, the compiler takes them anew for every
    torque (1.1 instead of 2.3 million PUMA 560 patterns/s on two busy cores).
    """
    variables = in_stage(lambda q: position_variables(ring, q), list(q))
    values = products(monomials, variables)
    return dict(zip(monomials, values, strict=True)).__getitem__
