import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..inertia import pseudo_inertia


# J(body) is linear in the ten numbers: the matrices that they multiply, and the way back.
_BASIS = np.stack([pseudo_inertia(unit) for unit in np.eye(10)])
_BACK = np.linalg.pinv(_BASIS.reshape(10, 16).T)
_DENSITY = 2700.0  # of aluminium [kg/m³]: how large a body to begin with is
# The complementarity that steps aim for, as a part of the present one, and its least value in
# squared standard errors: there steps settle, so far inside the boundary.
_CENTRING = 0.2
_LEAST = 1e-4
_FRACTION = 0.95


def possible_body(
    estimate: Float[Array, "10"], information: Float[Array, "10 10"], *, steps: int = 12
) -> Float[Array, "10"]:
    """The body that can exist nearest to an estimate of its ten numbers, in the estimate's metric.

    A body can exist if and only if its pseudo-inertia J is positive definite (Wensing, Kim and
    Slotine 2018). Minimised is ½ (x − x̂)' Λ (x − x̂) under that condition, by a primal-dual
    interior-point method on the one 4 by 4 matrix, from a ball of the estimate's mass and centre:
    what `jaxcslc.inertia.nearest_body` does with a general solver, here under `jit` and `vmap`,
    fast enough for a control loop. Every iterate can exist, so the result can, however few steps
    were taken; a dozen leave the squared distance within 0.01 of the least, but for bodies that
    hardly weigh anything, where they leave it within some units.

    Newton's method on a logarithmic barrier alone ends in a corner, and Levenberg-Marquardt over a
    Cholesky factor of J crawls where the factor loses rank, which is where measured bodies lie:
    after forty steps they were 0.2 to 10 and 0.1 to 10 squared standard errors from the least.

    **Arguments**

    - `estimate`: (10,) x̂ in the order of `BODY`.
    - `information`: (10, 10) Λ, positive definite: the inverse of its covariance.
    - `steps`: how many.

    >>> import jax.numpy as jnp, numpy as np
    >>> from jaxcslc.inertia import pseudo_inertia
    >>> from jaxcslc.payload import possible_body
    >>> estimate = jnp.array([-0.01, 0.02, 0.02, 0, 0, 0, 0.1, 0, 0, 2.0])  # Ixx below zero
    >>> found = possible_body(estimate, 1e6 * jnp.eye(10))
    >>> bool(np.all(np.linalg.eigvalsh(pseudo_inertia(np.asarray(found))) > 0))
    True
    """
    basis, back = jnp.asarray(_BASIS, estimate.dtype), jnp.asarray(_BACK, estimate.dtype)
    flat, unit = basis.reshape(10, 16), jnp.eye(4, dtype=estimate.dtype)
    # In units of the body to begin with its pseudo-inertia is 1, and everything else is too.
    half = jnp.linalg.cholesky(jnp.tensordot(_ball(estimate, information), basis, 1))
    units = back @ jnp.einsum("ab,ibc,dc->iad", half, basis, half).reshape(10, 16).T
    metric = units.T @ information @ units
    goal = jnp.linalg.solve(units, estimate)
    start = back @ unit.reshape(16)
    pull = jnp.max(jnp.abs(metric @ (start - goal)))

    def onwards(state: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], None]:
        x, dual = state
        primal = jnp.tensordot(x, basis, 1)
        lower = jnp.linalg.cholesky(primal)
        inverse = jax.scipy.linalg.cho_solve((lower, True), unit)
        aim = jnp.maximum(_CENTRING * jnp.sum(primal * dual) / 4.0, _LEAST)
        # Newton's step for Λ (x − x̂) = ⟨basis, Z⟩ and J Z = aim: Helmberg et al. (1996).
        bend = jnp.einsum("iab,jba->ij", basis, inverse @ basis @ dual)
        slope = metric @ (x - goal) - aim * flat @ inverse.reshape(16)
        step = jnp.linalg.solve(metric + 0.5 * (bend + bend.T), -slope)
        turn = jnp.tensordot(step, basis, 1)
        dual_step = aim * inverse - dual - inverse @ turn @ dual
        dual_step = 0.5 * (dual_step + dual_step.T)
        # One length for both: the dual's residual depends on the primal.
        room = jnp.minimum(_room(lower, turn), _room(jnp.linalg.cholesky(dual), dual_step))
        return (x + room * step, dual + room * dual_step), None

    first = (start, jnp.maximum(pull, 1e-3) * unit)
    (found, _), _ = jax.lax.scan(onwards, first, length=steps)
    return units @ found


def _room(lower: Float[Array, "4 4"], step: Float[Array, "4 4"]) -> Float[Array, ""]:
    """How much of a step stays inside the cone, and not all the way to its boundary."""
    white = jax.scipy.linalg.solve_triangular(lower, step, lower=True)
    white = jax.scipy.linalg.solve_triangular(lower, white.T, lower=True)
    least = jnp.min(jnp.linalg.eigvalsh(white))
    return jnp.where(least < -_FRACTION, _FRACTION / jnp.maximum(-least, _FRACTION), 1.0)


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
