import equinox as eqx
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float


class Memory(eqx.Module):
    """What recursive least squares remembers of the equations felt · x = residual.

    Information form: nothing is inverted until somebody asks, and forgetting is a factor.
    """

    information: Float[Array, "x x"]
    """Σ felt' w felt, weights falling with age."""
    moment: Float[Array, " x"]
    """Σ felt' w residual."""
    mixed: Float[Array, "x own"]
    """Σ felt' w own: how errors of the coefficients that are held enter the moment."""

    @classmethod
    def empty(cls, size: int, own: int, dtype: DTypeLike) -> "Memory":
        """Of nothing."""
        return cls(
            jnp.zeros((size, size), dtype), jnp.zeros(size, dtype), jnp.zeros((size, own), dtype)
        )

    def with_rows(
        self,
        felt: Float[Array, "joints x"],
        own: Float[Array, "joints own"],
        residual: Float[Array, " joints"],
        weight: Float[Array, " joints"],
        kept: float | Float[Array, ""],
    ) -> "Memory":
        """With another sample's equations, what was there before times `kept`."""
        weighted = felt.T * weight[None, :]
        return Memory(
            kept * self.information + weighted @ felt,
            kept * self.moment + weighted @ residual,
            kept * self.mixed + weighted @ own,
        )

    def emptied(self, when: Bool[Array, ""]) -> "Memory":
        """Of nothing, if `when`."""

        def kept(array: Array) -> Array:
            return jnp.where(when, jnp.zeros_like(array), array)

        return Memory(kept(self.information), kept(self.moment), kept(self.mixed))
