"""Values of coefficients that are known beforehand."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float

from ..bodies import Known, Prior
from ..network import CSLC


def check_prior(prior: Prior | None, *, possible: bool) -> None:
    """Check that the search can make use of a prior.

    **Arguments**

    - `prior`: of `MaximumLikelihood`.
    - `possible`: whether bodies are to be possible.

    **Raises** `ValueError` for links without possible bodies, and for bounds.
    """
    entries: dict[str, Known] = {} if prior is None else dict(prior.coefficients)
    if prior is not None and prior.links and not possible:
        raise ValueError(
            "prior: maximum likelihood takes coefficients, got links, which possible bodies alone"
            " can follow"
        )
    for name, entry in entries.items():
        if entry.value is None or entry.low > -np.inf or entry.high < np.inf:
            raise ValueError(f"prior, {name}: maximum likelihood takes values, got bounds")


def prior_values(
    prior: Prior | None, network: CSLC
) -> tuple[
    Float[np.ndarray, " coefficients"],
    Float[np.ndarray, " coefficients"],
    Bool[np.ndarray, " coefficients"],
]:
    """Return values, (p,) inverse variances that are 0 where nothing is known, and what is
    fixed."""
    known: Mapping[int, Known] = {} if prior is None else prior.coefficient_values(network)
    size = network.size
    values, precision, fixed = np.zeros(size), np.zeros(size), np.zeros(size, bool)
    for index, entry in known.items():
        assert entry.value is not None
        values[index], fixed[index] = entry.value, entry.fixed
        precision[index] = 0.0 if entry.fixed else entry.error**-2.0
    return values, precision, fixed
