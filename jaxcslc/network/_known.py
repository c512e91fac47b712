from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ..derivation import Algebra, constant_values
from ..manipulator import LinkParameters
from .terms import FrictionTerm, coefficient_values


def known_coefficients(
    algebra: Algebra,
    terms: Sequence[FrictionTerm],
    links: Sequence[LinkParameters],
    given: Mapping[str, Any],
) -> Float[Array, " coefficients"]:
    """Inertial coefficients of known links, then those of terms: given by word, or zero.

    **Raises** `ValueError` as `CSLC.coefficients_from`.
    """
    robot = algebra.robot
    n = robot.joint_count
    if len(links) != n:
        raise ValueError(f"links: expected {n} entries, one a joint, got {len(links)}")
    constants = constant_values(robot) if algebra.lengths != "numeric" else {}
    parts = [coefficient_values(algebra.coefficients, links, constants)]
    names = (*robot.friction_terms, *(["coupled"] if robot.coupled else []))
    for word, value in given.items():
        if value is not None and word not in names:
            raise ValueError(
                f"{word}: the network has no such friction term; it has"
                f" {', '.join(names) or 'none'}"
            )
    for term in terms:
        word = "coupled" if term.pairs else term.word
        columns = 3 if term.pairs else 2 if term.part else 0
        rows = len(term.pairs) if term.pairs else n
        values = _values(word, given[word], rows, columns)
        if term.pairs:
            parts.append(values[:, ("inertia", "viscous", "dry").index(term.word[8:])])
            continue
        if not isinstance(values, Tracer):
            for j in sorted(set(range(n)) - set(term.joints)):
                if np.any(np.asarray(values[j]) != 0):
                    raise ValueError(f"{word}: joint {j + 1} has no such friction term")
        if columns:
            values = values[:, "+-".index(term.part)]
        parts.append(values[np.array(term.joints)])
    return jnp.concatenate([jnp.asarray(part, parts[0].dtype) for part in parts])


def _values(word: str, given: Any, rows: int, columns: int) -> Any:
    """Coefficients of a term as they were given, or zeros. **Raises** `ValueError` by shape."""
    shape = (rows, columns) if columns else (rows,)
    values = np.zeros(shape) if given is None else jnp.asarray(given)
    if values.shape != shape:
        if columns == 3:
            raise ValueError(
                f"{word}: expected {rows} by 3 values, inertia, viscous and dry of each pair,"
                f" got {values.shape}"
            )
        each = "two a joint, forwards and backwards" if columns else "one a joint"
        raise ValueError(
            f"{word}: expected {rows * max(columns, 1)} values, {each}, got {values.shape}"
        )
    return values
