import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float


# Standard deviations of the Gaussian prior around no payload [kg m², kg m, kg]; weak beside the
# information in a second of motion.
PRIOR_DEVIATION = np.array([0.2] * 6 + [1.0] * 3 + [5.0])


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

    @classmethod
    def of_sample(
        cls,
        payload_rows: Float[Array, "joints x"],
        arm_rows: Float[Array, "joints arm"],
        residual: Float[Array, " joints"],
        weight: Float[Array, " joints"],
    ) -> "NormalEquations":
        """The equations of one sample.

        **Arguments**

        - `payload_rows`, `arm_rows`: the regressor's columns of the payload and of the arm.
        - `residual`: torque that the arm's coefficients do not explain [N m or N].
        - `weight`: of each joint's equation.
        """
        weighted = payload_rows.T * weight[None, :]
        return cls(weighted @ payload_rows, weighted @ residual, weighted @ arm_rows)

    def with_sample(
        self, sample: "NormalEquations", forgetting: float | Float[Array, ""]
    ) -> "NormalEquations":
        """With the equations of another sample; those before weigh less by `forgetting`."""
        return jax.tree_util.tree_map(lambda old, new: forgetting * old + new, self, sample)

    def reset(self, when: Bool[Array, ""]) -> "NormalEquations":
        """Without equations, if `when`."""
        return self.replaced(jax.tree_util.tree_map(jnp.zeros_like, self), when)

    def replaced(self, other: "NormalEquations", when: Bool[Array, ""]) -> "NormalEquations":
        """The equations of `other`, if `when`."""
        return jax.tree_util.tree_map(lambda old, new: jnp.where(when, new, old), self, other)

    @property
    def posterior_information(self) -> Float[Array, "x x"]:
        """The information of equations and prior together."""
        return self.information + jnp.diag(jnp.asarray(1.0 / PRIOR_DEVIATION**2))
