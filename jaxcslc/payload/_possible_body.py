import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..inertia import pseudo_inertia


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
    """The physically possible body nearest to an estimate, in the metric of the estimate.

    A body is possible if and only if its pseudo-inertia J is positive definite (Wensing, Kim and
    Slotine 2018). This minimises ½ (x − x̂)' Λ (x − x̂) under that condition, by a primal-dual
    interior-point method on the 4 by 4 matrix, from a ball of the estimate's mass and centre. It
    is `jaxcslc.inertia.nearest_body` for `jit`, `vmap` and control loops. Every iterate is
    possible, and so is the result after any number of steps. A dozen steps leave the squared
    distance within 0.01 of the minimum; for bodies of nearly no mass, within a few units.

    Two other methods were slower: after forty steps Newton's method on a logarithmic barrier was
    0.2 to 10 squared standard errors from the minimum, and Levenberg-Marquardt over a Cholesky
    factor of J, which loses rank where measured bodies lie, 0.1 to 10.

    **Arguments**

    - `estimate`: x̂, (10,) in the order of `BODY`.
    - `information`: Λ, (10, 10), positive definite: the inverse of the covariance.
    - `steps`: number of iterations.

    **Returns**

    The ten parameters, (10,).

    >>> import jax.numpy as jnp, numpy as np
    >>> from jaxcslc.inertia import pseudo_inertia
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
    """The part of a step that stays inside the cone, at a distance from its boundary."""
    white = jax.scipy.linalg.solve_triangular(lower, step, lower=True)
    white = jax.scipy.linalg.solve_triangular(lower, white.T, lower=True)
    least = jnp.min(jnp.linalg.eigvalsh(white))
    return jnp.where(
        least < -_STEP_FRACTION, _STEP_FRACTION / jnp.maximum(-least, _STEP_FRACTION), 1.0
    )


def _ball(estimate: Float[Array, "10"], information: Float[Array, "10 10"]) -> Float[Array, "10"]:
    """An aluminium ball of about the estimate's mass around about its centre."""
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
