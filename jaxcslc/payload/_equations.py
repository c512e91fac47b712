"""Mathematics of a payload that is estimated on-line: noise, equations, evidence, bodies.

`PayloadEstimator` in `_estimator` uses them, sample by sample.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float

from ..bodies import pseudo_inertia
from ..network import CSLC
from ..recordings import Patterns


def torque_noise(
    network: CSLC,
    k: Float[Array | np.ndarray, " coefficients"],
    patterns: Patterns,
    *,
    block: float = 0.25,
) -> Float[np.ndarray, " joints"]:
    """Estimate the spectral density of the torque's slow errors at each joint [N² m² s].

    The difference between an unloaded arm's torque and its model is not white: most of it is model
    error, which lasts as long as a pose or a direction of motion. A payload is identified by
    averaging over time, and the mean over T seconds has the variance density / T; it is measured
    over blocks of `block` seconds. White noise of standard deviation σ at a sampling interval h has
    the density σ² h.

    **Arguments**

    - `network`, `k`: (p,) the unloaded arm.
    - `patterns`: of another recording than that which `k` was identified from. Masked samples are
      left out, and blocks of which more than half is masked.
    - `block`: longer than the errors are correlated, shorter than a tenth of the recording [s].

    **Returns** (n,) [N² m² s].

    **Raises** `ValueError`: a joint has fewer than four such blocks; names it.

    >>> import jax.numpy as jnp, numpy as np, jaxcslc as jc
    >>> from jaxcslc.payload import torque_noise
    >>> network = jc.derive(jc.examples.turntable(), lengths="numeric")
    >>> t = 0.002 * np.arange(5000)[:, None]
    >>> every, noise = np.ones(t.shape, bool), np.random.default_rng(0).normal(size=t.shape)
    >>> patterns = jc.Patterns(t[:, 0], t, 0 * t, 0 * t, 0.1 * noise, every, every)
    >>> bool(abs(torque_noise(network, jnp.zeros(3), patterns)[0] / (0.1**2 * 0.002) - 1) < 0.5)
    True
    """
    residual = np.asarray(patterns.torque) - np.asarray(
        network.torque(jnp.asarray(k), patterns.q, patterns.qd, patterns.qdd)
    )
    time = np.asarray(patterns.time)
    mask = np.asarray(patterns.mask)
    number = np.floor((time - time[0]) / block).astype(int)
    size = np.bincount(number)
    density = np.empty(residual.shape[1])
    for joint in range(len(density)):
        counted = mask[:, joint]
        samples = np.bincount(number, weights=counted)
        total = np.bincount(number[counted], weights=residual[counted, joint], minlength=len(size))
        enough = samples >= 0.5 * np.max(size)
        if np.count_nonzero(enough) < 4:
            raise ValueError(
                f"joint {joint + 1}: {np.count_nonzero(enough)} blocks of {block:g} s in which it"
                " moves; expected four or more: record for longer"
            )
        # The mean is over the unmasked part of a block, which is that much shorter.
        length = block * samples[enough] / np.max(size)
        density[joint] = np.mean(length * (total[enough] / samples[enough]) ** 2)
    return density


# Standard deviations of the Gaussian prior around no payload [kg m², kg m, kg]; weak beside the
# information in a second of motion.
PRIOR_DEVIATION = np.array([0.2] * 6 + [1.0] * 3 + [5.0])


class RecursiveEquations(eqx.Module):
    """Recursive least squares in information form, for payload_rows · x = residual.

    Weights w decay with age. `information` is Σ w payload_rows' payload_rows, `moment`
    Σ w payload_rows' residual. Errors of the arm's fixed coefficients enter the moment through
    `cross`, Σ w payload_rows' arm_rows.
    """

    information: Float[Array, "x x"]
    moment: Float[Array, " x"]
    cross: Float[Array, "x arm"]

    @classmethod
    def empty(cls, size: int, arm: int, dtype: DTypeLike) -> "RecursiveEquations":
        """Return no equations, for `size` unknowns and `arm` fixed coefficients."""
        return cls(*(jnp.zeros(shape, dtype) for shape in ((size, size), size, (size, arm))))

    @classmethod
    def of_sample(
        cls,
        payload_rows: Float[Array, "joints x"],
        arm_rows: Float[Array, "joints arm"],
        residual: Float[Array, " joints"],
        weight: Float[Array, " joints"],
    ) -> "RecursiveEquations":
        """Make the equations of a sample from the regressor's columns of payload and arm."""
        weighted = payload_rows.T * weight[None, :]
        return cls(weighted @ payload_rows, weighted @ residual, weighted @ arm_rows)

    def with_sample(
        self, sample: "RecursiveEquations", forgetting: float | Float[Array, ""]
    ) -> "RecursiveEquations":
        """Return the equations with another sample; earlier ones weigh less by `forgetting`."""
        return jax.tree.map(lambda old, new: forgetting * old + new, self, sample)

    def reset(self, when: Bool[Array, ""]) -> "RecursiveEquations":
        """Return no equations if `when`, and otherwise these."""
        return self.replaced(jax.tree.map(jnp.zeros_like, self), when)

    def replaced(self, other: "RecursiveEquations", when: Bool[Array, ""]) -> "RecursiveEquations":
        """Return the equations of `other` if `when`, and otherwise these."""
        return jax.tree.map(lambda old, new: jnp.where(when, new, old), self, other)

    @property
    def posterior_information(self) -> Float[Array, "x x"]:
        """The information of equations and prior together."""
        return self.information + jnp.diag(jnp.asarray(1.0 / PRIOR_DEVIATION**2))


# Added to variances that are scaled to one, so that a factor exists.
_REGULARISATION = 1e-9
# The size of a payload that is expected, as a part of the prior's: some kilogram within 0.2 m.
_TYPICAL = 0.2


def payload_evidence(equations: RecursiveEquations) -> Float[Array, ""]:
    """Return the logarithm of how much better some payload explains equations than none.

    This is the Bayes factor of a payload of typical size, Gaussian around zero with covariance D²,
    and of no payload: with information Λ and moment b, ½ (D b)' M⁻¹ (D b) − ½ log det M,
    M = 1 + D Λ D.
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
    """Return the logarithm of how much better `body` explains equations than no payload."""
    return body @ equations.moment - 0.5 * body @ equations.information @ body


def absence_evidence(
    equations: RecursiveEquations,
    payload_rows: Float[Array, "joints 10"],
    residual: Float[Array, " joints"],
    weight: Float[Array, " joints"],
) -> Float[Array, ""]:
    """Return the logarithm of how much better no payload predicts a sample than the present one.

    The present one has the predictive density of its equations: what they do not determine yet
    predicts nothing. With the most probable body instead, a payload that had just been picked up
    was lost again at the next motion of the wrist.
    """
    rows, torque = jnp.sqrt(weight)[:, None] * payload_rows, jnp.sqrt(weight) * residual
    information = equations.posterior_information
    innovation = torque - rows @ jnp.linalg.solve(information, equations.moment)
    variance = jnp.eye(len(weight)) + rows @ jnp.linalg.solve(information, rows.T)
    lower = jnp.linalg.cholesky(0.5 * (variance + variance.T))
    white = jax.scipy.linalg.solve_triangular(lower, innovation, lower=True)
    return 0.5 * (white @ white - torque @ torque) + jnp.sum(jnp.log(jnp.diagonal(lower)))


def disagreement(long_term: RecursiveEquations, short_term: RecursiveEquations) -> Float[Array, ""]:
    """Return χ² of the short-term equations at the long-term estimate: a test for another payload.

    It has as many degrees of freedom as there are unknowns.
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


# J(body) is linear in the ten parameters: the matrices that they multiply, and the inverse map.
_BASIS = np.stack([pseudo_inertia(unit) for unit in np.eye(10)])
_BACK = np.linalg.pinv(_BASIS.reshape(10, 16).T)
_DENSITY = 2700.0  # of aluminium [kg/m³]: the size of the initial body
# The target for the complementarity, as a fraction of the present one, and its smallest value in
# squared standard errors: iterations converge at this distance from the boundary.
_CENTRING = 0.2
_SMALLEST_TARGET = 1e-4
_STEP_FRACTION = 0.95


def possible_body(
    estimate: Float[Array, "10"], information: Float[Array, "10 10"], *, steps: int = 12
) -> Float[Array, "10"]:
    """Return the physically consistent body nearest to an estimate, in the metric of the estimate.

    A body is possible if and only if its pseudo-inertia J is positive definite (Wensing, Kim and
    Slotine 2018). This minimises ½ (x − x̂)' Λ (x − x̂) under that condition, by a primal-dual
    interior-point method on the 4 by 4 matrix, from a ball of the estimate's mass and centre. It
    is `jaxcslc.bodies.nearest_body` for `jit`, `vmap` and control loops. Every iterate is
    possible, and so is the result after any number of steps. A dozen steps leave the squared
    distance within 0.01 of the minimum; for bodies of nearly no mass, within a few units.

    Two other methods were slower: after forty steps Newton's method on a logarithmic barrier was
    0.2 to 10 squared standard errors from the minimum, and Levenberg-Marquardt over a Cholesky
    factor of J, which loses rank where measured bodies lie, 0.1 to 10.

    **Arguments**

    - `estimate`: x̂, (10,) in the order of `BODY`.
    - `information`: Λ, (10, 10), positive definite: the inverse of the covariance.
    - `steps`: number of iterations.

    **Returns** the ten parameters, (10,).

    >>> import jax.numpy as jnp, numpy as np
    >>> from jaxcslc.bodies import pseudo_inertia
    >>> from jaxcslc.payload import possible_body
    >>> estimate = jnp.array([-0.01, 0.02, 0.02, 0, 0, 0, 0.1, 0, 0, 2.0])  # Ixx below zero
    >>> body = possible_body(estimate, 1e6 * jnp.eye(10))
    >>> bool(np.all(np.linalg.eigvalsh(pseudo_inertia(np.asarray(body))) > 0))
    True
    """
    basis, back = jnp.asarray(_BASIS, estimate.dtype), jnp.asarray(_BACK, estimate.dtype)
    flat, unit = basis.reshape(10, 16), jnp.eye(4, dtype=estimate.dtype)
    # In units of the initial body, its pseudo-inertia is the identity.
    half = jnp.linalg.cholesky(jnp.tensordot(_ball(estimate, information), basis, 1))
    units = back @ jnp.einsum("ab,ibc,dc->iad", half, basis, half).reshape(10, 16).T
    metric = units.T @ information @ units
    goal = jnp.linalg.solve(units, estimate)
    start = back @ unit.reshape(16)
    dual_scale = jnp.max(jnp.abs(metric @ (start - goal)))

    def iterate(state: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], None]:
        x, dual = state
        primal = jnp.tensordot(x, basis, 1)
        lower = jnp.linalg.cholesky(primal)
        inverse = jax.scipy.linalg.cho_solve((lower, True), unit)
        target = jnp.maximum(_CENTRING * jnp.sum(primal * dual) / 4.0, _SMALLEST_TARGET)
        # Newton's step for Λ (x − x̂) = ⟨basis, Z⟩ and J Z = target: Helmberg et al. (1996).
        curvature = jnp.einsum("iab,jba->ij", basis, inverse @ basis @ dual)
        gradient = metric @ (x - goal) - target * flat @ inverse.reshape(16)
        step = jnp.linalg.solve(metric + 0.5 * (curvature + curvature.T), -gradient)
        primal_step = jnp.tensordot(step, basis, 1)
        dual_step = target * inverse - dual - inverse @ primal_step @ dual
        dual_step = 0.5 * (dual_step + dual_step.T)
        # One length for both: the dual's residual depends on the primal.
        length = jnp.minimum(
            _step_length(lower, primal_step), _step_length(jnp.linalg.cholesky(dual), dual_step)
        )
        return (x + length * step, dual + length * dual_step), None

    initial = (start, jnp.maximum(dual_scale, 1e-3) * unit)
    (solution, _), _ = jax.lax.scan(iterate, initial, length=steps)
    return units @ solution


def _step_length(lower: Float[Array, "4 4"], step: Float[Array, "4 4"]) -> Float[Array, ""]:
    """Return the part of a step that stays inside the cone, at a distance from its boundary."""
    white = jax.scipy.linalg.solve_triangular(lower, step, lower=True)
    white = jax.scipy.linalg.solve_triangular(lower, white.T, lower=True)
    least = jnp.min(jnp.linalg.eigvalsh(white))
    return jnp.where(
        least < -_STEP_FRACTION, _STEP_FRACTION / jnp.maximum(-least, _STEP_FRACTION), 1.0
    )


def _ball(estimate: Float[Array, "10"], information: Float[Array, "10 10"]) -> Float[Array, "10"]:
    """Return an aluminium ball of about the estimate's mass around about its centre."""
    mass = jnp.maximum(estimate[9], 1.0 / jnp.sqrt(information[9, 9]))
    centre = estimate[6:9] / mass
    # ∫ x² dm of a ball is a fifth of m r².
    spread = 0.2 * mass * jnp.maximum((mass / (4.0 / 3.0 * np.pi * _DENSITY)) ** (2 / 3), 1e-3)
    about = jnp.sum(centre**2) * jnp.ones(3) - centre**2
    x, y, z = centre
    return jnp.concatenate(
        [
            2.0 * spread + mass * about,
            -mass * jnp.stack([x * y, x * z, y * z]),
            mass * centre,
            mass[None],
        ]
    )
