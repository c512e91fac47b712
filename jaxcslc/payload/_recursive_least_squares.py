import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float


# Standard deviations of the Gaussian prior around no payload [kg m², kg m, kg]; weak beside the
# information in a second of motion.
PRIOR_DEVIATION = np.array([0.2] * 6 + [1.0] * 3 + [5.0])
_REGULARISATION = 1e-9


class NormalEquations(eqx.Module):
    """Recursive least squares in information form, for payload_rows · x = residual.

    Nothing is inverted until a solution is needed, and forgetting is a factor.

    **Attributes**

    - `information`: Σ w payload_rows' payload_rows, with weights that decay with age.
    - `moment`: Σ w payload_rows' residual.
    - `cross`: Σ w payload_rows' arm_rows, through which errors of the arm's fixed coefficients
      enter the moment.
    """

    information: Float[Array, "x x"]
    moment: Float[Array, " x"]
    cross: Float[Array, "x arm"]

    @classmethod
    def empty(cls, size: int, arm: int, dtype: DTypeLike) -> "NormalEquations":
        """Without equations, for `size` unknowns and `arm` fixed coefficients."""
        return cls(
            jnp.zeros((size, size), dtype), jnp.zeros(size, dtype), jnp.zeros((size, arm), dtype)
        )

    def updated(
        self,
        payload_rows: Float[Array, "joints x"],
        arm_rows: Float[Array, "joints arm"],
        residual: Float[Array, " joints"],
        weight: Float[Array, " joints"],
        forgetting: float | Float[Array, ""],
    ) -> "NormalEquations":
        """With the equations of another sample.

        **Arguments**

        - `payload_rows`, `arm_rows`: the regressor's columns of the payload and of the arm.
        - `residual`: torque that the arm's coefficients do not explain [N m or N].
        - `weight`: of each joint's equation.
        - `forgetting`: the forgetting factor for earlier equations.
        """
        weighted = payload_rows.T * weight[None, :]
        return NormalEquations(
            forgetting * self.information + weighted @ payload_rows,
            forgetting * self.moment + weighted @ residual,
            forgetting * self.cross + weighted @ arm_rows,
        )

    def reset(self, when: Bool[Array, ""]) -> "NormalEquations":
        """Without equations, if `when`."""

        def cleared(array: Array) -> Array:
            return jnp.where(when, jnp.zeros_like(array), array)

        return NormalEquations(cleared(self.information), cleared(self.moment), cleared(self.cross))

    @property
    def posterior_information(self) -> Float[Array, "x x"]:
        """The information of equations and prior together."""
        return self.information + jnp.diag(jnp.asarray(1.0 / PRIOR_DEVIATION**2))


def disagreement(long_term: NormalEquations, short_term: NormalEquations) -> Float[Array, ""]:
    """χ² of the short-term equations at the long-term estimate: a test for a changed payload.

    **Returns**

    A scalar, with as many degrees of freedom as there are unknowns.
    """
    information = long_term.posterior_information
    mean = jnp.linalg.solve(information, long_term.moment)
    score = short_term.moment - short_term.information @ mean
    # Var(score) = Λ_s + Λ_s P Λ_s. Where it is singular, χ² is that of its range.
    variance = short_term.information + short_term.information @ jnp.linalg.solve(
        information, short_term.information
    )
    scale = 1.0 / jnp.sqrt(jnp.diagonal(variance) + _REGULARISATION)
    size = len(PRIOR_DEVIATION)
    scaled = variance * scale[:, None] * scale[None, :] + _REGULARISATION * jnp.eye(size)
    return (scale * score) @ jnp.linalg.solve(scaled, scale * score)
