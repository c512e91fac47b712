"""The sum of squares as a function of coefficients, all else at its minimum."""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from ..bodies import PhysicalParameters, Prior, fixed_bodies, physical_parameters
from ..least_squares import Errors, Identification, settled
from ..network import CSLC
from ._likelihood_fit import SPACED, LikelihoodFit, likelihood_fit
from ._objective import Linear
from ._problem import LikelihoodProblem
from ._search import Minimum, search, search_on
from ._search_state import Levels, SearchState


# The sum of squares may bend more than its parabola by this part of it: then it falls in a step to
# the parabola's minimum among a convex set, by a quarter of the square of the step at least.
_MOST_BEND = 0.75
# Else a part of the step is tried: what would be right for a parabola that bends as much, no less
# than this, and so often. Where the square of a step says less than searches leave, the next is
# half of one: no more bend than twice the parabola's was seen.
_LEAST_PART, _MOST_PARTS, _SMALL = 0.1, 4, 0.1

Coefficients = Float[np.ndarray, " coefficients"]


@dataclasses.dataclass(frozen=True)
class Profile:
    """The sum of squares as a function of coefficients, all else at its minimum for these.

    **Attributes**

    - `minimum`: of all else, with equations in which coefficients are unknown, too.
    - `step`: (p,) to the minimum of the parabola about the present coefficients; `information`:
      (p, p); of coefficients that are known, 0.
    """

    minimum: Minimum
    step: Coefficients
    information: Float[np.ndarray, "coefficients coefficients"]

    @classmethod
    def of(cls, minimum: Minimum, scale: Float[np.ndarray, " border"]) -> "Profile":
        """Expand about the end of a search with fixed coefficients; `scale` of the problem
        without."""
        objective = dataclasses.replace(minimum.objective, scale=scale)
        linear = Linear.of(objective, minimum.point)
        factored = linear.factored(0.0)
        unconfined = dataclasses.replace(
            minimum, objective=objective, linear=linear, factored=factored
        )
        p, whole = len(minimum.point.k), factored.information
        step = linear.step(factored, linear.residuals).border[:p] * scale[:p]
        others = p + np.flatnonzero(scale[p:])  # slopes and offsets, which are eliminated
        mixed = whole[np.ix_(others, np.arange(p))]
        left = np.linalg.lstsq(whole[np.ix_(others, others)], mixed, rcond=None)[0]
        per_unit = np.divide(1.0, scale[:p], where=scale[:p] > 0.0, out=np.zeros(p))
        information = (whole[:p, :p] - mixed.T @ left) * np.outer(per_unit, per_unit)
        return cls(unconfined, step, information)

    @property
    def k(self) -> Coefficients:
        """(p,) present coefficients."""
        return self.minimum.point.k

    @property
    def target(self) -> Coefficients:
        """(p,) coefficients at the minimum of the parabola."""
        return self.k + self.step

    def towards(
        self,
        change: Coefficients,
        part: float,
        search: Callable[[Coefficients, SearchState], Minimum],
    ) -> tuple[Minimum, float, int]:
        """Return the minimum of all else for coefficients that are changed, or for a part of the
        change.

        **Arguments**

        - `change`: (p,) to the minimum of the parabola among a convex set; `part`: of it that is
          tried first.
        - `search`: of the minimum for coefficients, with the signs and weights of a state.

        **Returns** the minimum, the part that would be right where the sum of squares bends as much
        as on the way there, and how many steps its search has taken.
        """
        state, steps = self.minimum.state, 0
        for number in range(1, _MOST_PARTS + 1):
            trial = search(self.k + part * change, state)
            steps += trial.steps
            comparable = trial.state.same_motion(state)
            if not comparable:
                return trial, part, steps
            if self._size(part * change) <= _SMALL:
                return trial, min(part, 0.5), steps
            bend = self._bend(trial)
            part = float(np.clip(1.0 / (1.0 + bend), _LEAST_PART, 1.0)) if bend > 0.0 else 1.0
            if bend <= _MOST_BEND or number == _MOST_PARTS:
                return trial, part, steps
        raise AssertionError

    def _size(self, change: Coefficients) -> float:
        """Return the square of a change, in the metric of the information."""
        return float(change @ self.information @ change)

    def _bend(self, trial: Minimum) -> float:
        """Return the excess curvature of the sum of squares up to a trial, relative to its
        parabola's."""
        change = trial.point.k - self.k
        square = self._size(change)
        promise = 2.0 * float(change @ self.information @ self.step) - square
        fall = self.minimum.linear.present_value - trial.linear.present_value
        return (promise - fall) / square


# Bodies follow positions, and positions bodies, until no coefficient moves by more than this part
# of its standard error; three or four times are usual.
_SETTLED, _MOST_ROUNDS = 0.02, 20


def possible_bodies(
    network: CSLC,
    problem: LikelihoodProblem,
    minimum: Minimum,
    free: LikelihoodFit,
    levels: tuple[Levels, Levels] | None,
    *,
    prior: Prior | None,
    errors: Errors,
    progress: Callable[[str], None],
) -> LikelihoodFit:
    """Return the most likely bodies, with positions, slopes and noise that belong to them.

    With positions eliminated, a Gauss-Newton step makes the objective a square of coefficients:
    its minimum and its information. The consistent bodies nearest to that in its metric are what
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
    step: Callable[[str], None] = lambda _: progress(
        "maximum likelihood: physically consistent parameters"
    )

    def search_with(k: Float[np.ndarray, " coefficients"], state: SearchState) -> Minimum:
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
        bodies = bodies_nearest_to(fit.fit.with_k(profile.target), weight)
        converged = settled(fit.fit.with_k(bodies.k), profile.k, _SETTLED)
        if converged or rounds == _MOST_ROUNDS:
            break
        minimum, part, of_trials = profile.towards(bodies.k - profile.k, part, search_with)
        steps, rounds = steps + of_trials, rounds + 1
    if not converged:
        bodies = bodies_nearest_to(fit.fit.with_k(profile.k), weight)
    if errors != "independent":
        fit = likelihood_fit(network, profile.minimum, errors)
    return dataclasses.replace(
        fit,
        fit=fit.fit.with_k(bodies.k),
        steps=steps,
        converged=converged and minimum.converged,
        bodies=bodies,
        free=free.fit,
        **{name: getattr(free, name) for name in SPACED},
    )
