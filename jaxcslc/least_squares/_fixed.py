"""Coefficients that keep known values in a fit, with their uncertainty."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from ..network import AbstractLinearNetwork
from ._identification import Identification


Previous = Identification | Float[Array | np.ndarray, " coefficients"]


class Fixed(eqx.Module):
    """Coefficients that keep their values in a fit, and how well these are known.

    **Attributes**

    - `free`: indices of those that are fitted.
    - `k`: (p,) what the others are fixed at, and what the fitted ones are near where a fit has a
      choice.
    - `covariance`, `independent_covariance`: (p, p), `determined`: (p,), as in `Identification`;
      what they say of fitted coefficients is not used.
    - `degrees_of_freedom`: that belongs to the covariance.
    """

    free: tuple[int, ...] = eqx.field(static=True)
    k: Float[Array, " coefficients"]
    covariance: Float[Array, "coefficients coefficients"]
    independent_covariance: Float[Array, "coefficients coefficients"]
    determined: Bool[Array, " coefficients"]
    degrees_of_freedom: Float[Array, ""]

    @classmethod
    def except_for(
        cls, network: AbstractLinearNetwork, previous: Previous, groups: Sequence[str]
    ) -> "Fixed":
        """All but `groups` keep their values of `previous`, which may end before the last ones if
        those are all fitted.

        **Raises** `ValueError` for names that are none, and for another network's `previous`.
        """
        free = tuple(
            i for i in _indices(network, groups) if network.names[i] not in network.known_values
        )
        # Sizes are the robot's: padded by JAX, each would be compiled.
        traced = any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(previous))
        xp: Any = jnp if traced else np
        values = xp.asarray(previous.k if isinstance(previous, Identification) else previous)
        size, missing = len(values), network.size - len(values)
        if missing < 0 or not {*range(size, network.size)} <= set(free):
            raise ValueError(f"previous: expected {network.size} coefficients, got {size}")
        if isinstance(previous, Identification):
            if previous.names != network.names[:size]:
                raise ValueError(
                    f"previous: its coefficients are {previous.names[0]} to {previous.names[-1]}"
                    f" ({size});"
                    f" {network.name!r} has {network.names[0]} to {network.names[-1]}"
                    f" ({network.size})"
                )
            covariances = previous.covariance, previous.independent_covariance
            determined, degrees_of_freedom = previous.determined, previous.degrees_of_freedom
        else:
            covariances = (np.zeros((size, size)),) * 2
            determined, degrees_of_freedom = np.ones(size, bool), np.array(np.inf)
        padded = [xp.pad(xp.asarray(x), (0, missing)) for x in (values, *covariances)]
        known = xp.pad(xp.asarray(determined), (0, missing), constant_values=True)
        return cls(
            free,
            *(jnp.asarray(x, float) for x in padded),
            determined=jnp.asarray(known, bool),
            degrees_of_freedom=jnp.asarray(degrees_of_freedom, float),
        )

    @classmethod
    def of_known(cls, network: AbstractLinearNetwork) -> "Fixed | None":
        """The coefficients that are numbers (`network.known_values`), without errors; None if
        none is."""
        if not (known := network.known_values):
            return None
        free = tuple(i for i, name in enumerate(network.names) if name not in known)
        k = np.array([known.get(name, 0.0) for name in network.names])
        none = jnp.zeros((len(k), len(k)))
        return cls(free, jnp.asarray(k), none, none, jnp.ones(len(k), bool), jnp.asarray(jnp.inf))

    @property
    def remaining(self) -> Int[np.ndarray, " fixed"]:
        """Indices of those that are not fitted."""
        return np.setdiff1d(np.arange(len(self.k)), self.free)


def check_nothing_known(network: AbstractLinearNetwork, what: str) -> None:
    """**Raises** `ValueError` if coefficients are numbers, which `what` would fit."""
    if known := network.known_values:
        raise ValueError(
            f"{what}: {', '.join(known)} of {network.name!r} are numbers, by known masses, which"
            " LeastSquares.fit keeps; elsewhere say them as a prior"
        )


def _indices(network: AbstractLinearNetwork, groups: Sequence[str]) -> tuple[int, ...]:
    """Indices of the coefficients of groups or of names, ascending."""
    names = (groups,) if isinstance(groups, str) else tuple(groups)
    there = dict.fromkeys(coefficient.group for coefficient in network.coefficients)
    listed = f"{', '.join(there)}, and names, {network.names[0]} to {network.names[-1]}"
    if not names:
        raise ValueError(f"groups: none is given; expected some of {listed}")
    for name in names:
        if name not in there and name not in network.names:
            raise ValueError(f"groups: {name!r} is none; expected some of {listed}")
    return tuple(
        index
        for index, coefficient in enumerate(network.coefficients)
        if coefficient.group in names or coefficient.name in names
    )
