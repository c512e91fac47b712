from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, Float

from ...derivation import Coefficient, InertialTerm
from ...manipulator import LinkParameters


_AXES = {"x": 0, "y": 1, "z": 2}


def term_value(term: InertialTerm, links: Sequence[LinkParameters]) -> Float[Array, ""]:
    """Value of one product of link parameters, from the parameters of all links."""
    link = links[term.link]
    value = jnp.asarray(1.0)
    for factor in term.factors:
        if factor == "motor":
            value = value * link.motor_inertia
        elif factor == "m":
            value = value * link.mass
        elif factor[0] == "r":
            value = value * link.centre_of_gravity[_AXES[factor[1]]]
        else:
            tensor = link.inertia if term.central else link.inertia_at_frame
            value = value * tensor[_AXES[factor[1]], _AXES[factor[2]]]
    return value


def coefficient_values(
    coefficients: Sequence[Coefficient],
    links: Sequence[LinkParameters],
    constants: dict[str, float],
) -> Float[Array, " coefficients"]:
    """Evaluate the expressions of inertial coefficients for given links and constants."""
    known: dict[InertialTerm, Array] = {}
    values: list[Array] = []
    for coefficient in coefficients:
        total = jnp.asarray(0.0)
        for addend in coefficient.addends:
            if addend.term not in known:
                known[addend.term] = term_value(addend.term, links)
            factor = float(addend.factor)
            for name, power in addend.constants:
                factor *= constants[name] ** power
            total = total + factor * known[addend.term]
        values.append(total)
    return jnp.stack(values)
