import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._recursive_least_squares import PRIOR_DEVIATION, NormalEquations


_REGULARISATION = 1e-9
# The size of a payload that is expected, as a part of the prior's: some kilogram within 0.2 m.
_TYPICAL = 0.2


def payload_evidence(equations: NormalEquations) -> Float[Array, ""]:
    """The logarithm of how much better equations are explained by some payload than by none.

    Bayes factor of a payload of typical size, Gaussian around zero with covariance D², and of no
    payload: with information Λ and moment b, ½ (D b)' M⁻¹ (D b) − ½ log det M, M = 1 + D Λ D.
    The factor's expectation without payload is 1, whatever the motion, so that over a sequence of
    equations it ever exceeds exp(h) with a probability of at most exp(−h) (Ville 1939), if the
    noise is as assumed and nothing is forgotten.

    **Returns** a scalar; below zero where the equations speak for no payload.
    """
    size = jnp.asarray(_TYPICAL * PRIOR_DEVIATION)
    scaled = size[:, None] * equations.information * size[None, :] + jnp.eye(len(PRIOR_DEVIATION))
    lower = jnp.linalg.cholesky(scaled)
    white = jax.scipy.linalg.solve_triangular(lower, size * equations.moment, lower=True)
    return 0.5 * white @ white - jnp.sum(jnp.log(jnp.diagonal(lower)))


def likelihood_ratio(equations: NormalEquations, body: Float[Array, "10"]) -> Float[Array, ""]:
    """The logarithm of how much better equations are explained by `body` than by no payload."""
    return body @ equations.moment - 0.5 * body @ equations.information @ body


def absence_evidence(
    equations: NormalEquations,
    payload_rows: Float[Array, "joints 10"],
    residual: Float[Array, " joints"],
    weight: Float[Array, " joints"],
) -> Float[Array, ""]:
    """The logarithm of how much better a sample is predicted by no payload than by the present one.

    Of the present one, the predictive density of its equations: what they do not determine yet
    predicts nothing. With the most probable body instead, a payload that had just been picked up
    was lost again at the next motion of the wrist.

    **Arguments**

    - `equations`: of the payload so far.
    - `payload_rows`, `residual`, `weight`: of the sample, as of `NormalEquations.of_sample`.
    """
    rows, torque = jnp.sqrt(weight)[:, None] * payload_rows, jnp.sqrt(weight) * residual
    information = equations.posterior_information
    innovation = torque - rows @ jnp.linalg.solve(information, equations.moment)
    variance = jnp.eye(len(weight)) + rows @ jnp.linalg.solve(information, rows.T)
    lower = jnp.linalg.cholesky(0.5 * (variance + variance.T))
    white = jax.scipy.linalg.solve_triangular(lower, innovation, lower=True)
    return 0.5 * (white @ white - torque @ torque) + jnp.sum(jnp.log(jnp.diagonal(lower)))


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
