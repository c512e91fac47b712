import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ....network import CSLC
from ...possible import PhysicalParameters, fixed_bodies, physical_parameters
from ...prior import Prior
from ...solver import Errors, Identification
from .._levels import Levels
from .._likelihood_fit import LikelihoodFit, likelihood_fit
from .._linear import Linear
from .._problem import Problem
from ..search import Minimum, search


# Bodies follow positions, and positions bodies, until no coefficient moves by more than this part
# of its standard error; three or four times are usual.
_SETTLED, _MOST_ROUNDS = 0.02, 10


def possible_bodies(
    network: CSLC,
    problem: Problem,
    minimum: Minimum,
    free: LikelihoodFit,
    levels: tuple[Levels, Levels] | None,
    *,
    prior: Prior | None,
    errors: Errors,
    progress: Callable[[str], None],
) -> LikelihoodFit:
    """The most likely possible bodies, with positions, slopes and noise that belong to them.

    With positions eliminated, a Gauss-Newton step makes the objective a square of coefficients:
    its minimum and its information. The possible bodies nearest to that in its metric are what
    `physical_parameters` computes. For their coefficients the search estimates everything else,
    and the next step begins there: sequential quadratic programming with a constraint that is
    convex. Noise levels are estimated anew for the first bodies: where a recording says little,
    coefficients that nothing confines follow noise, and their levels are too small.

    **Arguments**

    - `problem`, `minimum`: of the search without bodies; `free`: its result.
    - `levels`: of torque and positions that estimation starts from; None to keep those of `free`.
    - `prior`: what is known of links; its coefficients are the problem's.
    - `errors`: as of `MaximumLikelihood`.
    - `progress`: is called with a few words at each step.

    **Returns** the bodies, their coefficients, and what else follows from these. Standard errors
    are those that coefficients without bodies would have at these noise levels, an upper bound:
    bodies that are possible are a convex set that has the truth in it.

    **Raises** as `physical_parameters`.
    """

    def bodies_nearest_to(fit: Identification, weight: float | None) -> PhysicalParameters:
        return physical_parameters(
            network,
            fit,
            fixed=fixed_bodies(network.robot),
            knowledge=() if prior is None else prior.link_values(network.robot),
            prior_weight=weight,
        )

    coefficients = np.arange(len(problem.scale)) < network.size
    with_fixed_coefficients = dataclasses.replace(
        problem, scale=np.where(coefficients, 0.0, problem.scale)
    )
    nearest, weight = bodies_nearest_to(free.fit, None), None
    bodies, fit, unconfined = nearest, free, minimum
    steps, settled = free.steps, False
    for number in range(1, _MOST_ROUNDS + 1):
        bodies = nearest
        torque_noise, position_noise = fit.torque_noise, fit.position_noise
        anew = False
        if number == 1 and levels is not None:
            (torque_noise, position_noise), anew = levels, True
        minimum = search(
            with_fixed_coefficients,
            dataclasses.replace(minimum.point, k=bodies.k),
            torque_noise,
            position_noise,
            lambda _, number=number: progress(f"maximum likelihood: possible bodies, {number}"),
            fixed_levels=not anew,
            edge=None if anew else fit.edge,
            noise_coefficients=fit.noise_coefficients,
        )
        objective = dataclasses.replace(minimum.objective, scale=problem.scale)
        linear = Linear.of(objective, minimum.point)
        factored = linear.factored(0.0)
        unconfined = dataclasses.replace(
            minimum, objective=objective, linear=linear, factored=factored
        )
        fit = likelihood_fit(network, unconfined, "independent")
        steps += minimum.steps
        step = linear.step(factored, linear.residuals)
        target = objective.moved(minimum.point, step).k
        nearest = bodies_nearest_to(_with_coefficients(fit.fit, target), weight)
        weight = nearest.prior_weight
        error = np.where(np.asarray(fit.fit.determined), np.asarray(fit.fit.standard_error), np.inf)
        settled = bool(np.all(np.abs(nearest.k - bodies.k) <= _SETTLED * error))
        if settled:
            break
    if errors != "independent":
        fit = likelihood_fit(network, unconfined, errors)
    return dataclasses.replace(
        fit,
        fit=_with_coefficients(fit.fit, bodies.k),
        steps=steps,
        converged=settled and minimum.converged,
        bodies=bodies,
        free=free.fit,
    )


def _with_coefficients(
    fit: Identification, k: Float[np.ndarray, " coefficients"]
) -> Identification:
    return eqx.tree_at(lambda fit: fit.k, fit, jnp.asarray(k))
