"""Recursive equations of a payload, and statistical tests of its presence and change.

`PayloadEstimator` in `_estimator` uses them.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, Int


# Standard deviations of the Gaussian prior around no payload [kg m², kg m, kg]; weak beside the
# information in a second of motion.
PRIOR_DEVIATION = np.array([0.2] * 6 + [1.0] * 3 + [5.0])


class RecursiveEquations(eqx.Module):
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
    def empty(cls, size: int, arm: int, dtype: DTypeLike) -> "RecursiveEquations":
        """Return no equations, for `size` unknowns and `arm` fixed coefficients."""
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
    ) -> "RecursiveEquations":
        """The equations of one sample.

        **Arguments**

        - `payload_rows`, `arm_rows`: the regressor's columns of the payload and of the arm.
        - `residual`: torque that the arm's coefficients do not explain [N m or N].
        - `weight`: of each joint's equation.
        """
        weighted = payload_rows.T * weight[None, :]
        return cls(weighted @ payload_rows, weighted @ residual, weighted @ arm_rows)

    def with_sample(
        self, sample: "RecursiveEquations", forgetting: float | Float[Array, ""]
    ) -> "RecursiveEquations":
        """Return the equations with another sample; earlier ones weigh less by `forgetting`."""
        return jax.tree_util.tree_map(lambda old, new: forgetting * old + new, self, sample)

    def reset(self, when: Bool[Array, ""]) -> "RecursiveEquations":
        """Return no equations if `when`, and otherwise these."""
        return self.replaced(jax.tree_util.tree_map(jnp.zeros_like, self), when)

    def replaced(self, other: "RecursiveEquations", when: Bool[Array, ""]) -> "RecursiveEquations":
        """The equations of `other`, if `when`."""
        return jax.tree_util.tree_map(lambda old, new: jnp.where(when, new, old), self, other)

    @property
    def posterior_information(self) -> Float[Array, "x x"]:
        """The information of equations and prior together."""
        return self.information + jnp.diag(jnp.asarray(1.0 / PRIOR_DEVIATION**2))


_REGULARISATION = 1e-9
# The size of a payload that is expected, as a part of the prior's: some kilogram within 0.2 m.
_TYPICAL = 0.2


def payload_evidence(equations: RecursiveEquations) -> Float[Array, ""]:
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


def likelihood_ratio(equations: RecursiveEquations, body: Float[Array, "10"]) -> Float[Array, ""]:
    """The logarithm of how much better equations are explained by `body` than by no payload."""
    return body @ equations.moment - 0.5 * body @ equations.information @ body


def absence_evidence(
    equations: RecursiveEquations,
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


def disagreement(long_term: RecursiveEquations, short_term: RecursiveEquations) -> Float[Array, ""]:
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


class PayloadEstimate(NamedTuple):
    """The estimate of a payload at one instant, in the frame of the link that carries it.

    **Attributes**

    - `body`: its ten inertial parameters in the order of `BODY`, physically possible.
    - `covariance`: of the unconstrained estimate, (10, 10).
    - `mass`, `mass_error`: and its standard error [kg].
    - `centre`, `centre_error`: centre of gravity and its standard error, (3,) [m]; the error is
      infinite while the mass may be zero.
    - `carrying`: whether there is a payload, as decided last; see `PayloadEstimator`.
    - `picked_up`, `put_down`: when that was detected last [s since `begin`]; −1 for never.
    - `change`: disagreement of the latest motion with the estimate: χ² of ten degrees of freedom.
    - `evidence`: for the next change, the natural logarithm of its likelihood ratio: for a payload
      while there is none, for none while there is one.
    """

    body: Float[Array, "10"]
    covariance: Float[Array, "10 10"]
    mass: Float[Array, ""]
    mass_error: Float[Array, ""]
    centre: Float[Array, "3"]
    centre_error: Float[Array, "3"]
    carrying: Bool[Array, ""]
    picked_up: Float[Array, ""]
    put_down: Float[Array, ""]
    change: Float[Array, ""]
    evidence: Float[Array, ""]


class PayloadState(NamedTuple):
    """The memory of a `PayloadEstimator`.

    **Attributes**

    - `position`: the latest reading, (n,) [rad or m].
    - `torque`: the torque command for it, (n,) [N m or N].
    - `motion`, `effort`: states of the filters on readings and on torques, (lags, n).
    - `samples`, `time`: since `begin` [1], [s].
    - `since_update`: time since the latest update [s].
    - `motion_time`: time in motion since the last reset [s].
    - `rest_time`: time for which all joints have been at rest [s].
    - `disagreement_time`, `evidence_time`: time in motion for which the disagreement, or the
      evidence, has exceeded its threshold [s].
    - `long_term`, `short_term`: equations of the present payload, and of the latest motion.
    - `candidate`, `candidate_time`: equations since the last standstill before which nothing spoke
      for a change, and time in motion since then [s].
    - `absence`: cumulative sum of the evidence against the payload that is carried.
    - `undecided`: whether there is a payload is unknown, after a change.
    - `estimate`: the present `PayloadEstimate`.
    """

    position: Float[Array, " joints"]
    torque: Float[Array, " joints"]
    motion: Float[Array, "lags joints"]
    effort: Float[Array, "lags joints"]
    samples: Int[Array, ""]
    time: Float[Array, ""]
    since_update: Float[Array, ""]
    motion_time: Float[Array, ""]
    rest_time: Float[Array, ""]
    disagreement_time: Float[Array, ""]
    evidence_time: Float[Array, ""]
    long_term: RecursiveEquations
    short_term: RecursiveEquations
    candidate: RecursiveEquations
    candidate_time: Float[Array, ""]
    absence: Float[Array, ""]
    undecided: Bool[Array, ""]
    estimate: PayloadEstimate
