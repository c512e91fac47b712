"""The most likely physically consistent bodies."""

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
from .._problem import Problem
from ..search import Minimum, State, search, search_on
from ._profile import Profile


# Bodies follow positions, and positions bodies, until no coefficient moves by more than this part
# of its standard error; three or four times are usual.
_SETTLED, _MOST_ROUNDS = 0.02, 20


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
    """Return the most likely possible bodies, with positions, slopes and noise that belong to them.

    With positions eliminated, a Gauss-Newton step makes the objective a square of coefficients:
    its minimum and its information. The possible bodies nearest to that in its metric are what
    `physical_parameters` computes. For their coefficients the search estimates everything else,
    and the next step begins there: sequential quadratic programming with a constraint that is
    convex. It goes on with the signs and weights of the search before, so that the objective is
    one function; where friction bends that more than a square, a part of the step is taken. Noise
    levels are estimated anew for the first bodies: where a recording says little, coefficients that
    nothing confines follow noise, and their levels are too small.

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

    of_others = problem.fixing("k")
    step: Callable[[str], None] = lambda _: progress("maximum likelihood: possible bodies")

    def search_with(k: Float[np.ndarray, " coefficients"], state: State) -> Minimum:
        return search_on(of_others, state, k, step)

    bodies = bodies_nearest_to(free.fit, None)
    if levels is None:
        minimum = search_with(bodies.k, minimum.state)
    else:
        minimum = search(of_others, minimum.point.with_values(k=bodies.k), *levels, step)
    steps, weight, part, rounds = free.steps + minimum.steps, bodies.prior_weight, 1.0, 1
    while True:
        profile = Profile.of(minimum, problem.scale)
        fit = likelihood_fit(network, profile.minimum, "independent")
        bodies = bodies_nearest_to(_with_coefficients(fit.fit, profile.target), weight)
        change = bodies.k - profile.k
        error = np.where(np.asarray(fit.fit.determined), np.asarray(fit.fit.standard_error), np.inf)
        settled = bool(np.all(np.abs(change) <= _SETTLED * error))
        if settled or rounds == _MOST_ROUNDS:
            break
        minimum, part, of_trials = profile.towards(change, part, search_with)
        steps, rounds = steps + of_trials, rounds + 1
    if not settled:
        bodies = bodies_nearest_to(_with_coefficients(fit.fit, profile.k), weight)
    if errors != "independent":
        fit = likelihood_fit(network, profile.minimum, errors)
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
