"""The search: a step, a test, and what follows the motion in each stage."""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from ._banded_solver import Factored
from ._levenberg import AT_KINK, PROMISE, SMALL_DAMPING, LevenbergStep, levenberg_step
from ._objective import Linear, Objective
from ._point import Point
from ._problem import LikelihoodProblem
from ._search_state import (
    LITTLE_DAMPING,
    MARGINS,
    NEAR,
    Levels,
    Mask,
    SearchState,
    Stage,
    objective_of,
    outlier_weights,
    with_common_shafts,
    with_intervals,
    with_levels,
    with_refined_intervals,
    with_signs,
)


# Steps of a search. Most need 24, and 44 at real arms (docs/likelihood_evidence.md).
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
# many standard errors. Else weights follow static friction that almost no motion shows, and it
# follows these, back and forth.
_FIXED = 1.0
# Before that, and what equations leave out, too, after so many steps before which the sum of
# squares had risen by so much: what follows the motion alternates with it. (Of a Stäubli TX40,
# whose static friction is four standard deviations of its prior below zero, by six standard errors
# a step for as long as there were steps.)
_MOST_RISES, _RISE = 3, 0.1
# Beside intervals, edges and the level of torque noise follow steps of less than so many of these:
# while the level is far too large, steps are short.
_NEARER = 3.0


@dataclasses.dataclass(frozen=True)
class Minimum:
    """Result of a search.

    **Attributes**

    - `state`: all unknowns, signs, weights and levels, for a search that goes on from here.
    - `objective`: the sum of squares there; `linear`: its equations.
    - `factored`: the equations, whose information is in units of the border's scale.
    - `counted`: (equations, n), which equations have the full weight.
    - `steps`: Gauss-Newton steps; `converged`: whether the last one changed nothing.
    """

    state: SearchState
    objective: Objective
    linear: Linear
    factored: Factored
    counted: Mask
    steps: int
    converged: bool

    @property
    def point(self) -> Point:
        """Values of all unknowns."""
        return self.state.point

    @property
    def torque_noise(self) -> Levels:
        """(recordings, n) standard deviations [N m or N]."""
        return self.state.torque_noise

    @property
    def position_noise(self) -> Levels:
        """(recordings, n) standard deviations [rad or m]."""
        return self.state.position_noise


def search(
    problem: LikelihoodProblem,
    point: Point,
    torque_noise: Levels,
    position_noise: Levels,
    progress: Callable[[str], None],
    *,
    fixed_levels: bool = False,
    edge: Levels | None = None,
    tolerance: float = 0.0,
    moments: Float[np.ndarray, "samples _"] | None = None,
) -> Minimum:
    """Minimise step by step: signs, weights and noise levels are fixed within each step.

    What else follows the motion between steps is said by stages (`Stage`).

    - `fixed_levels`: whether noise levels are those of the start.
    - `edge`: (recordings, n) widths of intervals' edges in steps, 0 where counts are none. The
      start is then near the minimum. None with fixed levels: no count is an interval.
    - `tolerance`: the search ends also when the sum of squares falls by less than this part of it.
    - `moments`: (samples, n) of reversals to start from, as `LikelihoodFit.reversal_moments`.
    """
    levels = torque_noise, position_noise
    state = SearchState.start(problem, point, *levels, fixed_levels, edge, moments)
    first = 0 if edge is None else len(MARGINS)
    return _ended(problem, state, first, progress, tolerance=tolerance)


def search_on(
    problem: LikelihoodProblem,
    state: SearchState,
    k: Float[np.ndarray, " coefficients"],
    progress: Callable[[str], None],
) -> Minimum:
    """Go on from where a search has ended, with other coefficients.

    Signs of the motion, weights and noise levels are those of its end, unless reversals come or go.
    So the sum of squares is the same function of all unknowns, and its minima for several
    coefficients are comparable.

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
    problem: LikelihoodProblem,
    state: SearchState,
    first: int,
    progress: Callable[[str], None],
    *,
    tolerance: float = 0.0,
) -> Minimum:
    """Search from a state to an end.

    **Arguments** as of `search`, and

    - `first`: number of its first step: the first few leave much of the motion uncertain.
    """
    number, rises, end = first, 0, np.inf
    while True:
        state, same = with_signs(problem, state, number)
        state, same_shafts = with_common_shafts(problem, state, number)
        objective, counted = objective_of(problem, state, number)
        linear = Linear.of(objective, state.point)
        step = levenberg_step(problem, linear, state.point, state.damping)
        value, test = linear.present_value, _Test.of(state, step, same and same_shafts, number)
        rises += test.same and value > end + _RISE
        state = dataclasses.replace(state, point=step.point, damping=step.damping)
        progress(f"maximum likelihood: step {number + 1 - first}")
        # Rounding lets the sum grow: without a tolerance, that is no end.
        small = tolerance > 0.0 and test.final and step.fall < tolerance and number >= len(MARGINS)
        if test.converged or test.stalled or small or number == _MOST_STEPS - 1:
            linear = Linear.of(objective, state.point)
            factored, steps = linear.factored(0.0), number + 1 - first
            return Minimum(state, objective, linear, factored, counted, steps, test.converged)
        followed = _followed(problem, state, step, counted, number)
        end = value - step.fall * value if followed is state else np.inf
        state = _settled(followed, step, objective, rises)
        if state.stage is Stage.COUNTS and test.quiet and (test.at_kink or step.change <= NEAR):
            state = with_intervals(problem, state, step.minimum)
        number += 1


@dataclasses.dataclass(frozen=True)
class _Test:
    """Test of whether a search has ended.

    - `same`: whether signs were those of before; `final`: whether only unknowns move.
    - `quiet`: whether neither signs nor damping make the step what it is.
    - `at_kink`: whether what linear equations promise does not come.
    - `converged`: whether the step changed nothing; `stalled`: whether none ever will.
    """

    same: bool
    final: bool
    quiet: bool
    at_kink: bool
    converged: bool
    stalled: bool

    @classmethod
    def of(cls, state: SearchState, step: LevenbergStep, same: bool, number: int) -> "_Test":
        """Test a step from a state; `same`: whether its signs are those of the step before."""
        quiet = same and number >= len(MARGINS) and step.damping <= SMALL_DAMPING
        # Damping makes any step small.
        quiet &= step.minimum.damping <= LITTLE_DAMPING
        settled = step.change <= _SETTLED and step.promise <= PROMISE
        settled |= step.change <= 0.1 * _SETTLED and step.promise <= _PROMISE_OF_POSITIONS
        fall = step.fall * step.minimum.linear.present_value
        at_kink = step.promise <= AT_KINK and fall <= min(_LEVEL, 0.5 * step.promise)
        final = state.stage is Stage.FINAL
        unchanged = step.point is state.point and step.damping == state.damping and same
        return cls(
            same,
            final,
            quiet,
            at_kink,
            quiet and (settled or at_kink) and final,
            unchanged and final and state.of_friction is not None,
        )


def _followed(
    problem: LikelihoodProblem, state: SearchState, step: LevenbergStep, counted: Mask, number: int
) -> SearchState:
    """Apply what follows a step in a stage; return the state itself where nothing does."""
    if state.stage is Stage.OUTLIERS:
        weight = outlier_weights(problem, state, step, counted)
        return dataclasses.replace(state, outlier_weight=weight, stage=Stage.FINAL)
    if state.stage is Stage.LEVELS:
        return with_levels(problem, state, step, counted, number)
    if state.stage is Stage.INTERVALS and step.change <= _NEARER:
        return with_refined_intervals(problem, state, step, counted)
    return state


def _settled(
    state: SearchState, step: LevenbergStep, objective: Objective, rises: int
) -> SearchState:
    """Fix what follows the motion, at the end and where it alternates."""
    to_and_fro = rises >= _MOST_RISES
    if (state.stage is Stage.FINAL and step.change <= _FIXED) or to_and_fro:
        state = dataclasses.replace(state, of_friction=state.of_friction or state.point)
    if to_and_fro and state.truncation is None:
        state = dataclasses.replace(state, truncation=objective.motion.truncation)
    return state
