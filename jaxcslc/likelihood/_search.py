"""Equations in which a shaft of two joints turns."""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from ..network import CoupledTerm
from ._levenberg import (
    AT_KINK,
    DAMPING,
    PROMISE,
    SMALL_DAMPING,
    LevenbergStep,
    LinearMinimum,
    levenberg_step,
)
from ._normal_equations import Factored
from ._objective import Linear, Objective, Residuals
from ._point import Point
from ._problem import LikelihoodProblem
from ._search_state import (
    MARGINS,
    SIGN_STEPS,
    Levels,
    Mask,
    NoiseDraws,
    SearchState,
    Stage,
    hidden_noise,
    intervals_of,
    noise_levels,
    objective_of,
    outlier_weights,
    position_errors,
    with_signs,
)
from ._signs import dilated


def with_common_shafts(
    problem: LikelihoodProblem, state: SearchState, number: int
) -> tuple[SearchState, bool]:
    """Leave out equations in which a common shaft of two joints turns.

    Also returns whether these equations are those of before.

    Dry friction of a shaft that two joints turn together has the sign of a sum of their velocities,
    which no sign of a single joint holds while a step is judged. Where the shaft turns, the sum of
    squares jumps with noise of positions. Linear equations do not know of that, and damping grows
    without an end (a Stäubli TX40, which begins at rest: 12 were promised, and a thirtieth of that
    step lost 10).

    As of other reversals, more is left out in the first steps; later no equation comes back.
    """
    terms = problem.equations.network.terms
    pairs = [
        pair
        for term in terms
        if isinstance(term, CoupledTerm) and term.kind == "coupled_dry"
        for pair in term.pairs
    ]
    if not pairs:
        return state, True
    mask = np.zeros_like(state.undecided)
    margin = MARGINS[number] if number < len(MARGINS) else 0
    for pair in pairs:
        joints = [pair.first - 1, pair.second - 1]
        sign = np.sign(np.diff(state.point.q[:, joints] @ [1.0, float(pair.ratio)]))
        mask[:, joints] |= dilated((sign[1:] * sign[:-1] <= 0.0)[:, None], margin)
    if number >= SIGN_STEPS:
        mask |= state.undecided
    same = np.array_equal(mask, state.undecided)
    return dataclasses.replace(state, undecided=mask), same


# Noise levels go all the way to where residuals would have them in so many steps, then half of it;
# they are fixed when they change by less than this part in a step, or after so many steps.
_FREE_LEVEL_STEPS, _LEVEL_TOLERANCE, _MOST_LEVEL_STEPS, _MOST_STEPS_OF_ADDED = 6, 0.05, 14, 40
# Counts become intervals when a step moves no coefficient by more than this part of its standard
# error. Where all of them will, the level of torque noise need not be settled: it follows later.
NEAR = 0.3
# Beside intervals, edges and the level of torque noise follow so many steps. The level goes all the
# way, and in later ones half of it.
_REFINEMENTS, _FREE_REFINEMENTS = 5, 3
# Readings of an encoder whose noise is less than so many times that of its steps have that.
_MORE_THAN_STEPS = 1.3
# Counts are intervals where positions are known better than this part of a step. The width of an
# edge is so many times the error of positions, for then scores are linear in errors, and at least
# that of an encoder, in steps. Intervals reduce the error, and their width follows.
_SHARP, _EDGE, _LEAST_EDGE = 0.1, 2.0, 0.01
# With less damping than this part of the readings' weights, draws of noise are fitted all the same.
LITTLE_DAMPING = 1e-2


def with_levels(
    problem: LikelihoodProblem, state: SearchState, step: LevenbergStep, counted: Mask, number: int
) -> SearchState:
    """Let noise levels and weights of outliers follow the residuals of a step."""
    draws = _draws(problem, state, step.minimum)
    torque_noise, position_noise = _levels_of(problem, state, step.residuals, draws, counted)
    hidden = hidden_noise(problem.scatter, step.minimum.linear, problem.readings.part, torque_noise)
    position_noise = np.maximum(position_noise, hidden)
    if number > _FREE_LEVEL_STEPS:
        torque_noise = np.sqrt(torque_noise * state.torque_noise)
        position_noise = np.sqrt(position_noise * state.position_noise)
    change = max(
        np.abs(np.log(new / old)).max()
        for new, old in (
            (torque_noise, state.torque_noise),
            (position_noise, state.position_noise),
        )
    )
    modelled = number > len(MARGINS)
    settled = modelled and bool(change <= _LEVEL_TOLERANCE)
    if not problem.added:
        final = settled or number >= _MOST_LEVEL_STEPS
    else:  # what added blocks let bodies do shows little by little
        final = (settled and step.change <= NEAR) or number >= _MOST_STEPS_OF_ADDED
    if modelled and step.change <= NEAR:
        final |= _all_sharp(problem, draws, position_noise)
    if final:
        least = problem.least_position_noise
        counted_steps = (problem.encoder_step > 0.0) & (position_noise <= _MORE_THAN_STEPS * least)
        position_noise = np.where(counted_steps, least, position_noise)
    levelled = dataclasses.replace(state, torque_noise=torque_noise, position_noise=position_noise)
    return dataclasses.replace(
        levelled,
        outlier_weight=outlier_weights(problem, levelled, step, counted),
        stage=Stage.COUNTS if final else Stage.LEVELS,
    )


def _draws(problem: LikelihoodProblem, state: SearchState, minimum: LinearMinimum) -> NoiseDraws:
    # Damped positions do not follow noise that is drawn: they would seem to be known better than
    # readings say (a Stäubli TX40 with damping of 1e4: to 0.005 of a step in place of 0.28).
    little = minimum.damping <= LITTLE_DAMPING
    factored = minimum.factored if little else minimum.linear.factored(SMALL_DAMPING)
    return NoiseDraws.of(
        minimum.linear,
        factored,
        problem.readings.part,
        state.torque_noise,
        state.position_noise,
    )


def _levels_of(
    problem: LikelihoodProblem,
    state: SearchState,
    residuals: Residuals,
    draws: NoiseDraws,
    counted: Mask,
) -> tuple[Levels, Levels]:
    """Return noise levels that residuals have, of torque and of positions, none below its least."""
    torque_noise, position_noise = noise_levels(
        residuals,
        draws,
        counted,
        problem.moving,
        problem.readings.part,
        state.torque_noise,
        state.position_noise,
    )
    return (
        np.maximum(torque_noise, problem.least_torque_noise),
        np.maximum(position_noise, problem.least_position_noise),
    )


def _all_sharp(problem: LikelihoodProblem, draws: NoiseDraws, position_noise: Levels) -> bool:
    """Return whether positions of all joints that move are known much better than steps."""
    errors = _in_steps(problem, draws)
    steps = position_noise <= _MORE_THAN_STEPS * problem.least_position_noise
    return bool(np.all(np.isinf(errors) | (steps & (errors <= _SHARP))))


def with_intervals(
    problem: LikelihoodProblem, state: SearchState, minimum: LinearMinimum
) -> SearchState:
    """Make counts intervals, where positions are known much better than a step."""
    errors = _in_steps(problem, _draws(problem, state, minimum))
    counts = state.position_noise <= problem.least_position_noise
    edge = np.where(counts & (errors <= _SHARP), np.maximum(_EDGE * errors, _LEAST_EDGE), 0.0)
    intervals = intervals_of(problem, edge)
    # What linear equations say of intervals holds near only.
    damping = state.damping if intervals is None else max(state.damping, DAMPING)
    stage = Stage.FINAL if intervals is None else Stage.INTERVALS
    return dataclasses.replace(state, intervals=intervals, stage=stage, damping=damping)


def with_refined_intervals(
    problem: LikelihoodProblem, state: SearchState, step: LevenbergStep, counted: Mask
) -> SearchState:
    """Let torque noise and edges follow what intervals leave.

    Single counts hide torque noise far below what they leave of torque. Intervals show it, and with
    a level that is too large, standard errors would be.
    """
    part, intervals = problem.readings.part, state.intervals
    assert intervals is not None
    draws = _draws(problem, state, step.minimum)
    errors = _in_steps(problem, draws)
    torque_noise, _ = _levels_of(problem, state, step.residuals, draws, counted)
    if state.refinements >= _FREE_REFINEMENTS:
        torque_noise = np.sqrt(torque_noise * state.torque_noise)
    edge = np.clip(_EDGE * errors, _LEAST_EDGE, _EDGE * _SHARP)[part]
    refinements = state.refinements + 1
    return dataclasses.replace(
        state,
        intervals=dataclasses.replace(intervals, edge=np.where(intervals.edge > 0.0, edge, 0.0)),
        torque_noise=torque_noise,
        refinements=refinements,
        stage=Stage.FINAL if refinements == _REFINEMENTS else Stage.INTERVALS,
    )


def _in_steps(problem: LikelihoodProblem, draws: NoiseDraws) -> Levels:
    """Return errors of estimated positions in steps of encoders; infinite where there are none."""
    step = problem.encoder_step
    errors = position_errors(draws, problem.moving, problem.readings.part, len(step))
    return errors / np.where(step > 0.0, step, 1e-300)


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
        """All unknowns."""
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
    most_steps: int = _MOST_STEPS,
    moments: Float[np.ndarray, "samples _"] | None = None,
) -> Minimum:
    """Minimise step by step: signs, weights and noise levels are fixed within each step.

    What else follows the motion between steps is said by stages (`Stage`).

    **Arguments**

    - `fixed_levels`: whether noise levels are those of the start.
    - `edge`: (recordings, n) widths of intervals' edges in steps, 0 where counts are none. The
      start is then near the minimum. None with fixed levels: no count is an interval.
    - `tolerance`: the search ends also when the sum of squares falls by less than this part of it.
    - `most_steps`: after so many it ends wherever it is.
    - `moments`: (samples, n) of reversals to start from, as `LikelihoodFit.reversal_moments`.
    """
    levels = torque_noise, position_noise
    state = SearchState.start(problem, point, *levels, fixed_levels, edge, moments)
    first = 0 if edge is None else len(MARGINS)
    return _ended(problem, state, first, progress, tolerance=tolerance, most_steps=most_steps)


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
    problem: LikelihoodProblem,
    state: SearchState,
    first: int,
    progress: Callable[[str], None],
    *,
    tolerance: float = 0.0,
    most_steps: int = _MOST_STEPS,
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
        if test.converged or test.stalled or small or number == most_steps - 1:
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
    """Fix what follows the motion, at the end and where it goes to and fro."""
    to_and_fro = rises >= _MOST_RISES
    if (state.stage is Stage.FINAL and step.change <= _FIXED) or to_and_fro:
        state = dataclasses.replace(state, of_friction=state.of_friction or state.point)
    if to_and_fro and state.truncation is None:
        state = dataclasses.replace(state, truncation=objective.motion.truncation)
    return state
