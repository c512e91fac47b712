import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int

from ._band import Factored
from ._levels import Levels, NoiseDraws, noise_levels, position_errors
from ._levenberg import DAMPING, PROMISE, SMALL_DAMPING, LevenbergStep, levenberg_step
from ._linear import Linear
from ._objective import TURN, Objective, Point, Residuals
from ._problem import Problem
from ._readings import Intervals
from ._signs import Signs
from ._sticking import Sticking, sticking_equations
from .torque import Whitening, autocovariance


# Equations left uncertain on either side of a reversal, step by step; after these steps, reversals
# are moments to be estimated.
_MARGINS = (4, 3, 2)
# From this step on, a reversal that comes or goes is left uncertain.
_SIGN_STEPS = 7
# Noise levels go all the way to where residuals would have them in so many steps, then half of it;
# they are fixed when they change by less than this part in a step, or after so many steps.
_FREE_LEVEL_STEPS, _LEVEL_TOLERANCE, _MOST_LEVEL_STEPS = 6, 0.05, 14
_MOST_STEPS = 60
# It has converged when a step moves no coefficient by more than this part of a standard error, and
# linear equations promise less than this of the sum of squares, in units of variances.
_SETTLED = 1e-3
# Counts become intervals when a step moves no coefficient by more than this part of one; then the
# width of edges and the level of torque noise follow steps of less than this, so many times.
# The level goes all the way, and in later ones half of it.
_NEAR, _NEARER, _REFINEMENTS, _FREE_REFINEMENTS = 0.3, 1.0, 5, 3
# Standard deviation of friction that is anything up to break-away, and of a reversal's whose moment
# is estimated, as parts of the break-away torque. Simulated: 0.003 to 0.006 for the latter.
_UNCERTAIN, _REVERSAL = 0.6, 0.01
# Huber's constant, in standard deviations: what is beyond counts by its size, not by its square.
_OUTLIER = 4.0
# Readings of an encoder whose noise is less than so many times that of its steps have that.
_MORE_THAN_STEPS = 1.3
# A joint at rest moves by this part of its position noise from sample to sample.
_REST = 0.02
# Counts are intervals where positions are known better than this part of a step. The width of an
# edge is so many times the error of positions, for then scores are linear in errors, and at least
# that of an encoder, in steps. Intervals reduce the error, and their width follows.
_SHARP, _EDGE, _LEAST_EDGE = 0.1, 2.0, 0.01

Mask = Bool[np.ndarray, "equations joints"]


@dataclasses.dataclass(frozen=True)
class Minimum:
    """Where a search ended.

    **Attributes**

    - `point`: all unknowns; `objective`: the sum of squares there; `linear`: its equations.
    - `factored`: the equations, whose information is in units of the border's scale.
    - `torque_noise`, `position_noise`: (recordings, n) standard deviations.
    - `counted`: (equations, n), which equations have the full weight.
    - `steps`: Gauss-Newton steps; `converged`: whether the last one changed nothing.
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
    noise_coefficients: Float[np.ndarray, "order joints"] | None = None,
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
    - `noise_coefficients`: (order, n) of the autoregression of torque noise to start from; by
      default torque noise is white.
    """
    state = _State.start(
        problem, point, torque_noise, position_noise, noise_coefficients, fixed_levels, edge
    )
    first = 0 if edge is None else len(_MARGINS)
    number = first - 1
    while True:
        number += 1
        state, same = _with_signs(problem, state, number)
        objective, counted = _objective(problem, state)
        if number >= len(_MARGINS):
            objective = _with_sticking(problem, state, objective)
        linear = Linear.of(objective, state.point)
        step = levenberg_step(problem, linear, state.point, state.damping)
        state = dataclasses.replace(state, point=step.point, damping=step.damping)
        progress(f"maximum likelihood: step {number + 1 - first}")
        quiet = same and number >= len(_MARGINS) and step.damping <= SMALL_DAMPING
        settled = step.change <= _SETTLED and step.promise <= PROMISE
        converged = quiet and settled and state.final and (edge is None or number > first)
        # Rounding lets the sum grow: without a tolerance, that is no end.
        small = tolerance > 0.0 and state.final and number >= len(_MARGINS)
        small = small and step.fall < tolerance
        if converged or small or number == _MOST_STEPS - 1:
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
            )
        if edge is not None and number == first:
            weight = _outlier_weight(problem, state, linear, step, counted)
            state = dataclasses.replace(state, outlier_weight=weight)
        elif not state.levels_fixed:
            state = _with_levels(problem, state, linear, step, counted, number)
        elif state.intervals is not None and not state.final and step.change <= _NEARER:
            state = _refined(problem, state, linear, step, counted)
        elif not state.final and quiet and step.change <= _NEAR:
            state = _with_intervals(problem, state, linear, step.factored)


@dataclasses.dataclass(frozen=True)
class _State:
    """What changes from step to step.

    - `whitening`: of torque residuals.
    - `outlier_weight`: (equations, n) of equations far beyond the noise.
    - `ambiguous`: (equations, n) of reversals that came and went.
    - `levels_fixed`: whether noise levels and these weights are, while readings are normally
      distributed; `final`: and what counts are.
    - `refinements`: of the level of torque noise beside intervals.
    """

    point: Point
    signs: Signs | None
    torque_noise: Levels
    position_noise: Levels
    whitening: Whitening
    outlier_weight: Float[np.ndarray, "equations joints"]
    ambiguous: Mask
    intervals: Intervals | None
    damping: float
    levels_fixed: bool
    final: bool
    refinements: int = 0

    @classmethod
    def start(
        cls,
        problem: Problem,
        point: Point,
        torque_noise: Levels,
        position_noise: Levels,
        noise_coefficients: Float[np.ndarray, "order joints"] | None,
        fixed: bool,
        edge: Levels | None,
    ) -> "_State":
        samples, n = problem.readings.position.shape
        intervals = None if edge is None else _intervals(problem, edge)
        return cls(
            point,
            None,
            np.maximum(torque_noise, problem.least_torque_noise),
            position_noise,
            Whitening(np.zeros((0, n)) if noise_coefficients is None else noise_coefficients),
            np.ones((samples - 2, n)),
            np.zeros((samples - 2, n), bool),
            intervals,
            DAMPING,
            fixed,
            fixed,
        )


def _with_signs(problem: Problem, state: _State, number: int) -> tuple[_State, bool]:
    """The signs of the present motion, unless they are those of before, which is said.

    A reversal between two samples belongs to the one that it was with. Of a reversal that comes and
    goes, as next to a rest, equations stay uncertain.
    """
    readings, before, point = problem.readings, state.signs, state.point
    modelled = number >= len(_MARGINS)
    ambiguous = state.ambiguous
    while True:
        signs = Signs.of(
            point.q,
            readings.time,
            problem.stuck,
            margin=_MARGINS[min(number, len(_MARGINS) - 1)],
            modelled=modelled,
            joined=readings.joined,
            ambiguous=ambiguous,
        )
        if before is None or number <= len(_MARGINS):
            break
        unmatched = signs.unmatched(before)
        if not unmatched.any():
            return state, True
        if number < _SIGN_STEPS or np.all(ambiguous[unmatched]):
            break
        ambiguous = ambiguous | unmatched
    turn = signs.turn if before is None else signs.carried(before, point.turn)
    point = dataclasses.replace(point, turn=turn)
    return dataclasses.replace(state, signs=signs, point=point, ambiguous=ambiguous), False


def _objective(problem: Problem, state: _State) -> tuple[Objective, Mask]:
    """The sum of squares, and which equations have their full weight."""
    readings, signs, point = problem.readings, state.signs, state.point
    assert signs is not None
    of_equation, of_interval = readings.part[1:-1], readings.part[:-1]
    extra = state.whitening.variance(_friction_variance(problem, signs, point))
    weight = state.outlier_weight / (state.torque_noise[of_equation] ** 2 + extra)
    beyond = problem.calibration.outside(point.calibration)
    without = state.whitening.touched(problem.at_rest | (readings.joined | beyond)[:, None])
    weight[without] = 0.0
    expected, known = problem.known(point)
    at_rest = 1.0 / (_REST * state.position_noise[of_interval]) ** 2
    weights = Residuals(
        torque=weight,
        position=problem.reading_shares / state.position_noise[readings.part] ** 2,
        standstill=np.where(problem.stuck, at_rest, 0.0),
        turn=np.full(len(signs.samples), TURN**-2),
        border=known,
    )
    objective = Objective(
        problem.equations,
        readings.position,
        problem.calibration,
        readings.part,
        signs,
        weights,
        expected,
        problem.scale,
        state.whitening,
        state.intervals,
    )
    return objective, (extra == 0.0) & ~without


def _with_sticking(problem: Problem, state: _State, objective: Objective) -> Objective:
    """With the equations of joints that stick, which bound friction at break-away.

    Not beside torque noise with a spectrum: an equation that is a bound has no residual.
    """
    point, breakaway = state.point, problem.breakaway(state.point)
    if state.whitening.order or not problem.at_rest.any():
        return objective
    part, signs = problem.readings.part, objective.signs
    friction = objective.residuals(point).torque + signs.direction * breakaway
    mask = sticking_equations(problem.at_rest, friction, breakaway)
    mask &= ~problem.readings.joined[:, None]
    mask &= ~problem.calibration.outside(point.calibration)[:, None]
    if not mask.any():
        return objective
    direction = np.where(mask, np.where(friction < 0.0, -1.0, 1.0), signs.direction)
    return dataclasses.replace(
        objective,
        signs=dataclasses.replace(signs, direction=direction),
        sticking=Sticking(mask, direction, state.torque_noise[part[1:-1]]),
    )


def _friction_variance(
    problem: Problem, signs: Signs, point: Point
) -> Float[np.ndarray, "equations joints"]:
    """Variance of friction that signs do not tell."""
    breakaway = problem.breakaway(point)
    extra = np.where(signs.uncertain, (_UNCERTAIN * breakaway) ** 2, 0.0)
    for offset in (-1, 0, 1):
        extra[signs.samples - 1 + offset, signs.joints] = (_REVERSAL * breakaway[signs.joints]) ** 2
    return extra


def _with_levels(
    problem: Problem, state: _State, linear: Linear, step: LevenbergStep, counted: Mask, number: int
) -> _State:
    """Noise levels and weights of outliers that follow the residuals of a step."""
    part = problem.readings.part
    draws = NoiseDraws.of(linear, step.factored, part, state.torque_noise, state.position_noise)
    torque_noise, position_noise = noise_levels(
        step.residuals,
        draws,
        counted,
        problem.moving,
        part,
        state.torque_noise,
        state.position_noise,
    )
    torque_noise = np.maximum(torque_noise, problem.least_torque_noise)
    position_noise = np.maximum(position_noise, problem.least_position_noise)
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
    modelled = number > len(_MARGINS)
    whitening = state.whitening
    if modelled and whitening.order:
        whitening = _coloured(whitening, step.residuals, draws, counted, state.torque_noise, part)
        moved = whitening.coefficients - state.whitening.coefficients
        change = max(change, float(np.abs(moved).max()))
    final = number >= _MOST_LEVEL_STEPS or (modelled and bool(change <= _LEVEL_TOLERANCE))
    if final:
        least = problem.least_position_noise
        counted_steps = (problem.encoder_step > 0.0) & (position_noise <= _MORE_THAN_STEPS * least)
        position_noise = np.where(counted_steps, least, position_noise)
    levelled = dataclasses.replace(state, torque_noise=torque_noise, position_noise=position_noise)
    return dataclasses.replace(
        levelled,
        whitening=whitening,
        outlier_weight=_outlier_weight(problem, levelled, linear, step, counted),
        levels_fixed=final,
    )


def _coloured(
    whitening: Whitening,
    residuals: Residuals,
    draws: NoiseDraws,
    counted: Mask,
    torque_noise: Levels,
    part: Int[np.ndarray, " samples"],
) -> Whitening:
    """The filter of the noise that torque residuals show (expectation and maximisation).

    Positions take up a part of the noise: what they take up of a draw of the present noise is added
    to the autocovariance of residuals.
    """
    drawn, taken = draws.torque * torque_noise[part[1:-1]], draws.by_torque.torque

    def covariance(white: np.ndarray) -> np.ndarray:
        return autocovariance(whitening.removed(white), counted, whitening.order)

    missing = covariance(drawn) - covariance(taken) - covariance(draws.by_position.torque)
    return Whitening.fitted(covariance(residuals.torque) + missing)


def _outlier_weight(
    problem: Problem, state: _State, linear: Linear, step: LevenbergStep, counted: Mask
) -> Float[np.ndarray, "equations joints"]:
    """Huber's weights of a step's residuals.

    Uncertain friction is within break-away; what pushes a joint at its limit is not.
    """
    signs, noise = linear.objective.signs, state.torque_noise[problem.readings.part[1:-1]]
    extra = np.where(signs.uncertain, _friction_variance(problem, signs, step.point), 0.0)
    extra = state.whitening.variance(extra)
    deviation = np.sqrt(noise**2 + extra)
    robust = (counted | (extra > 0.0)) & (linear.weights.torque > 0.0)
    size = np.maximum(np.abs(step.residuals.torque), 1e-300)
    return np.where(robust, np.minimum(1.0, _OUTLIER * deviation / size), 1.0)


def _with_intervals(problem: Problem, state: _State, linear: Linear, factored: Factored) -> _State:
    """Counts as intervals, where positions are known much better than a step."""
    errors, _ = _position_errors(problem, state, linear, factored)
    counts = state.position_noise <= problem.least_position_noise
    edge = np.where(counts & (errors <= _SHARP), np.maximum(_EDGE * errors, _LEAST_EDGE), 0.0)
    intervals = _intervals(problem, edge)
    return dataclasses.replace(state, intervals=intervals, final=intervals is None)


def _intervals(problem: Problem, edge: Levels) -> Intervals | None:
    """Readings with edges of these widths; None if all are 0."""
    if not edge.any():
        return None
    part = problem.readings.part
    return Intervals(problem.reading_shares, problem.encoder_step[part], edge[part])


def _refined(
    problem: Problem, state: _State, linear: Linear, step: LevenbergStep, counted: Mask
) -> _State:
    """Torque noise and edges that follow what intervals leave.

    Single counts hide torque noise far below what they leave of torque. Intervals show it, and with
    a level that is too large, standard errors would be.
    """
    part, intervals = problem.readings.part, state.intervals
    assert intervals is not None
    errors, draws = _position_errors(problem, state, linear, step.factored)
    torque_noise, _ = noise_levels(
        step.residuals,
        draws,
        counted,
        problem.moving,
        part,
        state.torque_noise,
        state.position_noise,
    )
    torque_noise = np.maximum(torque_noise, problem.least_torque_noise)
    if state.refinements >= _FREE_REFINEMENTS:
        torque_noise = np.sqrt(torque_noise * state.torque_noise)
    edge = np.clip(_EDGE * errors, _LEAST_EDGE, _EDGE * _SHARP)[part]
    return dataclasses.replace(
        state,
        intervals=dataclasses.replace(intervals, edge=np.where(intervals.edge > 0.0, edge, 0.0)),
        torque_noise=torque_noise,
        refinements=state.refinements + 1,
        final=state.refinements + 1 == _REFINEMENTS,
    )


def _position_errors(
    problem: Problem, state: _State, linear: Linear, factored: Factored
) -> tuple[Levels, NoiseDraws]:
    """Of estimated positions in steps of encoders, (recordings, n), and the draws that say so."""
    part, step = problem.readings.part, problem.encoder_step
    draws = NoiseDraws.of(linear, factored, part, state.torque_noise, state.position_noise)
    errors = position_errors(draws, problem.moving, part, len(step))
    return errors / np.where(step > 0.0, step, 1e-300), draws
