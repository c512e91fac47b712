import dataclasses
import math

from ._nearest_bodies import WEAK, NearestBodies, Optimum


# A change of a body by a tenth of itself then counts one standard error: no file of a robot, which
# is drawn with screws and cables left out, is better.
_STRONGEST = 10.0
_STEPS_A_DECADE = 2
# How far the prior may move the bodies, in standard errors (root mean square). The truth is one
# away, but with all of it a wrong file (masses halved or doubled, centres elsewhere, spheres) made
# predictions of new motion up to 1.8 times worse; with half of it never more than 2 % worse.
_DISCREPANCY = 0.5


def by_discrepancy(problem: NearestBodies, least: float) -> tuple[NearestBodies, Optimum | None]:
    """The programme with the largest weight of the robot's bodies that the data do not contradict.

    The discrepancy principle (Morozov 1966): the errors of the data say how far from the fit the
    solution may be. The true coefficients are a standard error from it; of bodies that are half of
    that away the data say nothing against any, and those nearest to the robot's file are the best
    guess. Where even the nearest possible bodies are d standard errors from the fit, the weight is
    the largest whose bodies are not further than sqrt(d² + 0.5²). Weights are powers of √10 from
    `WEAK` to 10. Bodies that are no robot's, as balls are, keep the weight `WEAK`.

    **Arguments**

    - `problem`: its `weight` does not matter.
    - `least`: as of `NearestBodies.solve`.

    **Returns**

    - The programme with the weight, and its optimum; None if the solver fails.
    """
    weak = dataclasses.replace(problem, weight=WEAK)
    nearest = weak.solve(least)
    if nearest is None or not problem.informed:
        return weak, nearest
    limit = math.hypot(weak.distance(weak.coefficients(nearest)), _DISCREPANCY)
    best = weak, nearest
    # Distances grow with the weight: the first one tried is most often the answer.
    low, high, step = 0, round(_STEPS_A_DECADE * math.log10(_STRONGEST / WEAK)), None
    while low < high:
        step = high if step is None else (low + high + 1) // 2
        candidate = dataclasses.replace(problem, weight=WEAK * 10 ** (step / _STEPS_A_DECADE))
        optimum = candidate.solve(least)
        if optimum is not None and candidate.distance(candidate.coefficients(optimum)) <= limit:
            low, best = step, (candidate, optimum)
        else:
            high = step - 1
    return best
