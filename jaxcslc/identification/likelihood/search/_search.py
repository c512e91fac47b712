import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from .._levels import Levels
from .._levenberg import AT_KINK, PROMISE, SMALL_DAMPING, levenberg_step
from .._linear import Linear
from .._objective import Objective
from .._point import Point
from .._problem import Problem
from ..band import Factored
from ._common_shafts import with_common_shafts
from ._noise import LITTLE_DAMPING, NEAR, with_intervals, with_levels, with_refined_intervals
from ._state import MARGINS, Mask, State, with_signs
from ._weighting import objective_of, outlier_weights, with_sticking


_MOST_STEPS = 60
# It has converged when a step moves no coefficient by more than this part of a standard error, and
# linear equations promise less than `PROMISE` of the sum of squares, in units of variances; or less
# than this where coefficients move by a tenth of that part. Then positions alone are left, which
# take some steps more in intervals, and nothing follows these.
_SETTLED, _PROMISE_OF_POSITIONS = 1e-2, 1.0
# Or at a kink of friction, where little of what linear equations promise ever comes: less than
# half, and less than this. In standard errors, no coefficient is then further from the minimum of
# the linear equations than the square root of the promise, a third.
_LEVEL = 1e-2
# At the end, what friction may be where its sign is uncertain is fixed, once a step is less than so
# many standard errors. Else weights follow static friction that hardly any motion shows, and it
# follows these, to and fro.
_FIXED = 1.0
# Before that, and what equations leave out, too, after so many steps before which the sum of
# squares had risen by so much: what follows the motion goes to and fro with it. (Of a Stäubli TX40,
# whose static friction is four standard deviations of its prior below zero, by six standard errors
# a step for as long as there were steps.)
_MOST_RISES, _RISE = 3, 0.1
# Beside intervals, edges and the level of torque noise follow steps of less than so many of these:
# while the level is far too large, steps are short.
_NEARER = 3.0


@dataclasses.dataclass(frozen=True)
class Minimum:
    """Where a search ended.

    **Attributes**

    - `point`: all unknowns; `objective`: the sum of squares there; `linear`: its equations.
    - `factored`: the equations, whose information is in units of the border's scale.
    - `torque_noise`, `position_noise`: (recordings, n) standard deviations.
    - `counted`: (equations, n), which equations have the full weight.
    - `steps`: Gauss-Newton steps; `converged`: whether the last one changed nothing.
    - `state`: of the search: signs, weights and levels, for one that goes on from here.
    """

    point: Point
    objective: Objective
    linear: Linear
    factored: Factored
    torque_noise: Levels
    position_noise: Levels
    counted: Mask
    steps: int
    converged: bool
    state: State


def search(
    problem: Problem,
    point: Point,
    torque_noise: Levels,
    position_noise: Levels,
    progress: Callable[[str], None],
    *,
    fixed_levels: bool = False,
    edge: Levels | None = None,
    tolerance: float = 0.0,
    most_steps: int = _MOST_STEPS,
    moments: Float[np.ndarray, "samples _"] | None = None,
) -> Minimum:
    """Minimises step by step: signs, weights and noise levels are fixed within each step.

    At first counts are normally distributed and noise levels follow the residuals; then the levels
    are fixed, and counts become intervals where that says more, with the torque noise that these
    leave.

    **Arguments**

    - `fixed_levels`: whether noise levels are those of the start.
    - `edge`: (recordings, n) widths of intervals' edges in steps, 0 where counts are none. The
      start is then near the minimum. None with fixed levels: no count is an interval.
    - `tolerance`: the search ends also when the sum of squares falls by less than this part of it.
    - `most_steps`: after so many it ends wherever it is.
    - `moments`: (samples, n) of reversals to start from, as `LikelihoodFit.reversal_moments`.
    """
    state = State.start(
        problem,
        point,
        torque_noise,
        position_noise,
        fixed_levels,
        edge,
        moments,
    )
    first = 0 if edge is None else len(MARGINS)
    return _ended(
        problem,
        state,
        first,
        progress,
        weighted=edge is None,
        tolerance=tolerance,
        most_steps=most_steps,
    )


def search_on(
    problem: Problem,
    state: State,
    k: Float[np.ndarray, " coefficients"],
    progress: Callable[[str], None],
) -> Minimum:
    """Goes on from where a search has ended, with other coefficients.

    Signs of the motion, weights and noise levels are those of its end, unless reversals come or go.
    So the sum of squares is the same function of all unknowns, and its minima for several
    coefficients are comparable.

    **Arguments**

    - `problem`: of that search; other unknowns may be fixed.
    - `state`: `Minimum.state`; `k`: (p,) coefficients to start from.
    """
    state = dataclasses.replace(
        state,
        point=state.point.with_values(k=k),
        damping=SMALL_DAMPING,
        of_friction=state.of_friction or state.point,
    )
    return _ended(problem, state, len(MARGINS) + 1, progress)


def _ended(
    problem: Problem,
    state: State,
    first: int,
    progress: Callable[[str], None],
    *,
    weighted: bool = True,
    tolerance: float = 0.0,
    most_steps: int = _MOST_STEPS,
) -> Minimum:
    """Where a search from a state ends.

    **Arguments** as of `search`, and

    - `first`: number of its first step: the first few leave much of the motion uncertain.
    - `weighted`: whether weights of outliers are those of the state; else of the first step.
    """
    number, rises, end = first - 1, 0, np.inf
    while True:
        number += 1
        state, same = with_signs(problem, state, number)
        state, same_shafts = with_common_shafts(problem, state, number)
        same &= same_shafts
        objective, counted = objective_of(problem, state)
        if number >= len(MARGINS):
            objective = with_sticking(problem, state, objective)
        linear = Linear.of(objective, state.point)
        step = levenberg_step(problem, linear, state.point, state.damping)
        # Nothing has changed, and nothing will.
        stalled = step.point is state.point and step.damping == state.damping and same
        rises += same and linear.present_value > end + _RISE
        state = stepped = dataclasses.replace(state, point=step.point, damping=step.damping)
        progress(f"maximum likelihood: step {number + 1 - first}")
        quiet = same and number >= len(MARGINS) and step.damping <= SMALL_DAMPING
        # Damping makes any step small.
        quiet &= step.minimum.damping <= LITTLE_DAMPING
        settled = step.change <= _SETTLED and step.promise <= PROMISE
        settled |= step.change <= 0.1 * _SETTLED and step.promise <= _PROMISE_OF_POSITIONS
        fall = step.fall * linear.present_value
        at_kink = step.promise <= AT_KINK and fall <= min(_LEVEL, 0.5 * step.promise)
        settled |= at_kink
        converged = quiet and settled and state.final and (weighted or number > first)
        # Rounding lets the sum grow: without a tolerance, that is no end.
        small = tolerance > 0.0 and state.final and number >= len(MARGINS)
        small = small and step.fall < tolerance
        stalled &= state.final and state.of_friction is not None and (weighted or number > first)
        if converged or small or stalled or number == most_steps - 1:
            linear = Linear.of(objective, state.point)
            return Minimum(
                state.point,
                objective,
                linear,
                linear.factored(0.0),
                state.torque_noise,
                state.position_noise,
                counted,
                number + 1 - first,
                converged,
                state,
            )
        if not weighted and number == first:
            weight = outlier_weights(problem, state, step, counted)
            state = dataclasses.replace(state, outlier_weight=weight)
        elif not state.levels_fixed:
            state = with_levels(problem, state, step, counted, number)
        elif state.intervals is not None and not state.final and step.change <= _NEARER:
            state = with_refined_intervals(problem, state, step, counted)
        end = linear.present_value - fall if state is stepped else np.inf
        if (state.final and step.change <= _FIXED) or rises >= _MOST_RISES:
            state = dataclasses.replace(state, of_friction=state.of_friction or state.point)
        if rises >= _MOST_RISES and state.truncation is None:
            state = dataclasses.replace(state, truncation=objective.motion.truncation)
        waiting = state.levels_fixed and state.intervals is None and not state.final
        if waiting and quiet and (at_kink or step.change <= NEAR):
            state = with_intervals(problem, state, step.minimum)
