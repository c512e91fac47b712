from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...network import CSLC
from ._identification import Identification


Known = Identification | Float[Array | np.ndarray, " coefficients"]


class Held(eqx.Module):
    """Coefficients that a fit leaves as they are, and what is known of them.

    **Attributes**

    - `free`: places of those that are fitted.
    - `k`: (p,) what the others are held at, and what the fitted ones are near where a fit has a
      choice.
    - `covariance`, `independent_covariance`: (p, p), `determined`: (p,), as in `Identification`;
      what they say of fitted coefficients is not used.
    - `freedom`: that belongs to the covariance.
    """

    free: tuple[int, ...] = eqx.field(static=True)
    k: Float[Array, " coefficients"]
    covariance: Float[Array, "coefficients coefficients"]
    independent_covariance: Float[Array, "coefficients coefficients"]
    determined: Bool[Array, " coefficients"]
    freedom: Float[Array, ""]

    @classmethod
    def of(cls, network: CSLC, known: Known, groups: Sequence[str]) -> "Held":
        """Everything but `groups`, held at `known`, which may end before the last ones if those
        are all fitted.

        **Raises** `ValueError` for words that name nothing, and for another network's `known`.
        """
        free = _places(network, groups)
        values = jnp.asarray(known.k if isinstance(known, Identification) else known)
        size, missing = len(values), network.size - len(values)
        if missing < 0 or not {*range(size, network.size)} <= set(free):
            raise ValueError(f"known: expected {network.size} coefficients, got {size}")
        if isinstance(known, Identification):
            if known.names != network.names[:size]:
                raise ValueError(
                    f"known: its coefficients are {known.names[0]} to {known.names[-1]} ({size});"
                    f" {network.robot.name!r} has {network.names[0]} to {network.names[-1]}"
                    f" ({network.size})"
                )
            covariances = known.covariance, known.independent_covariance
            determined, freedom = known.determined, known.freedom
        else:
            covariances = (jnp.zeros((size, size)),) * 2
            determined, freedom = jnp.ones(size, bool), jnp.asarray(jnp.inf)
        return cls(
            free,
            jnp.pad(values.astype(float), (0, missing)),
            *(jnp.pad(jnp.asarray(c, float), (0, missing)) for c in covariances),
            determined=jnp.pad(jnp.asarray(determined), (0, missing), constant_values=True),
            freedom=jnp.asarray(freedom, float),
        )

    @property
    def rest(self) -> Int[np.ndarray, " held"]:
        """Places of those that are not fitted."""
        return np.setdiff1d(np.arange(len(self.k)), self.free)


def _places(network: CSLC, groups: Sequence[str]) -> tuple[int, ...]:
    """Where the coefficients are that groups' or their own names stand for, in ascending order."""
    words = (groups,) if isinstance(groups, str) else tuple(groups)
    there = dict.fromkeys(coefficient.group for coefficient in network.coefficients)
    listed = f"{', '.join(there)}, and names, {network.names[0]} to {network.names[-1]}"
    if not words:
        raise ValueError(f"groups: none is given; expected some of {listed}")
    for word in words:
        if word not in there and word not in network.names:
            raise ValueError(f"groups: {word!r} is none; expected some of {listed}")
    return tuple(
        place
        for place, coefficient in enumerate(network.coefficients)
        if coefficient.group in words or coefficient.name in words
    )
