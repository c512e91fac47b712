from itertools import combinations_with_replacement

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


class PolynomialTerms(eqx.Module):
    """All products of up to `degree` inputs, single inputs first (thesis 3.3.4).

    With degree 2 and two inputs, x1, x2, x1², x1 x2 and x2²: what lets a single hard limiter
    tell the exclusive or (Fig. 3.3-3).

    **Raises** `ValueError` for a degree below one.

    >>> import jax.numpy as jnp
    >>> from jaxcslc.adaptive import PolynomialTerms
    >>> PolynomialTerms(2)(jnp.asarray([2.0, 3.0])).tolist()
    [2.0, 3.0, 4.0, 6.0, 9.0]
    """

    degree: int = eqx.field(static=True)

    def __check_init__(self) -> None:
        if self.degree < 1:
            raise ValueError(f"polynomial terms: expected a degree of 1 or more, got {self.degree}")

    def __call__(self, x: Float[Array, "*batch inputs"]) -> Float[Array, "*batch terms"]:
        products: list[Array] = []
        for degree in range(1, self.degree + 1):
            for factors in combinations_with_replacement(range(x.shape[-1]), degree):
                product = x[..., factors[0]]
                for factor in factors[1:]:
                    product = product * x[..., factor]
                products.append(product)
        return jnp.stack(products, axis=-1)


class RadialBasis(eqx.Module):
    """Gaussian nodes: exp(-|x - centre|² / (2 width²)), one a centre (thesis 3.3.3).

    Their local sensitivity lies in the space of all inputs, not in a sum of them; centres and
    widths are given, and the layer that follows is what is trained.

    **Attributes**

    - `centres`: (nodes, inputs).
    - `widths`: (nodes,), positive.

    >>> import jax.numpy as jnp
    >>> from jaxcslc.adaptive import RadialBasis
    >>> nodes = RadialBasis(jnp.zeros((1, 2)), jnp.ones(1))
    >>> round(float(nodes(jnp.asarray([1.0, 1.0]))[0]), 4)  # exp(-1)
    0.3679
    """

    centres: Float[Array, "nodes inputs"]
    widths: Float[Array, " nodes"]

    def __check_init__(self) -> None:
        if self.centres.ndim != 2 or self.widths.shape != self.centres.shape[:1]:
            raise ValueError(
                "radial basis: expected centres (nodes, inputs) and widths (nodes,), got"
                f" {self.centres.shape} and {self.widths.shape}"
            )

    def __call__(self, x: Float[Array, "*batch inputs"]) -> Float[Array, "*batch nodes"]:
        # |x|² - 2 x c + |c|²: a product of matrices, where differences would be nodes times as
        # many numbers; rounding may leave it below zero, where a distance is none.
        squares = jnp.sum(x**2, axis=-1, keepdims=True) - 2.0 * (x @ self.centres.T)
        lead = (1,) * (x.ndim - 1)
        squares = squares + jnp.sum(self.centres**2, axis=-1).reshape(*lead, -1)
        return jnp.exp(-jnp.maximum(squares, 0.0) / (2.0 * self.widths.reshape(*lead, -1) ** 2))
