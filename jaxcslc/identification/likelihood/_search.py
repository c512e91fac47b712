import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import LinAlgError

from ._band import Factored
from ._levels import Levels, NoiseDraws, noise_levels, position_errors
from ._linear import Linear
from ._objective import TURN, Objective, Point, Residuals
from ._problem import Problem
from ._readings import Intervals
from ._signs import LATEST_TURN, Signs


# Equations left uncertain on either side of a reversal, step by step; after these steps, reversals
# are moments to be estimated.
_MARGINS = (4, 3, 2)
# From this step on, a reversal that comes or goes is left uncertain.
_SIGN_STEPS = 7
# Noise levels go all the way to where residuals would have them in so many steps, then half of it;
# they are fixed when they change by less than this part in a step, or after so many steps.
_FREE_LEVEL_STEPS, _LEVEL_TOLERANCE, _MOST_LEVEL_STEPS = 6, 0.05, 14
_MOST_STEPS, _MOST_TRIALS, _MOST_HALVINGS = 60, 8, 4
# It has converged when a step moves no coefficient by more than this part of a standard error, and
# linear equations promise less than this of the sum of squares, in units of variances.
_SETTLED, _PROMISE = 1e-3, 0.02
# Counts become intervals when a step moves no coefficient by more than this part of one.
_NEAR = 0.3
# Levenberg and Marquardt's damping: at first, least, its factor after good and bad steps, and the
# most with which a search has converged.
_DAMPING, _LEAST_DAMPING, _FACTOR, _SMALL_DAMPING = 1e-3, 1e-9, 10.0, 1e-6
# Standard deviation of friction that is anything up to break-away, and of a reversal's whose moment
# is estimated, as parts of the break-away torque. Simulated: 0.003 to 0.006 for the latter.
_UNCERTAIN, _REVERSAL = 0.6, 0.01
# Huber's constant, in standard deviations: what is beyond counts by its size, not by its square.
_OUTLIER = 4.0
# How far the logarithm of a slope moves in a step.
_SLOPE_STEP = 0.7
# A joint at rest moves by this part of its position noise from sample to sample.
_REST = 0.02
# Counts are intervals where positions are known better than this part of a step. The width of an
# edge is this part of the error of positions, by which intervals reduce it, and at least that of an
# encoder, in steps.
_SHARP, _EDGE, _LEAST_EDGE = 0.1, 0.4, 0.01

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
) -> Minimum:
    """Minimises step by step: signs, weights and noise levels are fixed within each step.

    At first counts are normally distributed and noise levels follow the residuals; then the levels
    are fixed, and counts become intervals where that says more.

    - `fixed_levels`: whether noise levels are those of the start, and no count is an interval.
    """
    state = _State.start(problem, point, torque_noise, position_noise, fixed_levels)
    number = -1
    while True:
        number += 1
        state, same = _with_signs(problem, state, number)
        objective, counted = _objective(problem, state)
        linear = Linear.of(objective, state.point)
        step = _step(problem, linear, state.point, state.damping)
        state = dataclasses.replace(state, point=step.point, damping=step.damping)
        progress(f"maximum likelihood: step {number + 1}")
        quiet = same and number >= len(_MARGINS) and step.damping <= _SMALL_DAMPING
        settled = step.change <= _SETTLED and step.promise <= _PROMISE
        converged = quiet and settled and state.final
        if converged or number == _MOST_STEPS - 1:
            linear = Linear.of(objective, state.point)
            return Minimum(
                state.point,
                objective,
                linear,
                linear.factored(0.0),
                state.torque_noise,
                state.position_noise,
                counted,
                number + 1,
                converged,
            )
        if not state.levels_fixed:
            state = _with_levels(problem, state, linear, step, counted, number)
        elif not state.final and quiet and step.change <= _NEAR:
            state = _with_intervals(problem, state, linear, step.factored)


@dataclasses.dataclass(frozen=True)
class _State:
    """What changes from step to step.

    - `outlier_weight`: (equations, n) of equations far beyond the noise.
    - `ambiguous`: (equations, n) of reversals that came and went.
    - `levels_fixed`: whether noise levels and these weights are; `final`: and what counts are.
    """

    point: Point
    signs: Signs | None
    torque_noise: Levels
    position_noise: Levels
    outlier_weight: Float[np.ndarray, "equations joints"]
    ambiguous: Mask
    intervals: Intervals | None
    damping: float
    levels_fixed: bool
    final: bool

    @classmethod
    def start(
        cls,
        problem: Problem,
        point: Point,
        torque_noise: Levels,
        position_noise: Levels,
        fixed: bool,
    ) -> "_State":
        samples, n = problem.readings.position.shape
        return cls(
            point,
            None,
            np.maximum(torque_noise, problem.least_torque_noise),
            position_noise,
            np.ones((samples - 2, n)),
            np.zeros((samples - 2, n), bool),
            None,
            _DAMPING,
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
    extra = _friction_variance(problem, signs, point)
    weight = state.outlier_weight / (state.torque_noise[of_equation] ** 2 + extra)
    beyond = problem.calibration.outside(point.calibration)
    without = problem.at_rest | (readings.joined | beyond)[:, None]
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
        state.intervals,
    )
    return objective, (extra == 0.0) & ~without


def _friction_variance(
    problem: Problem, signs: Signs, point: Point
) -> Float[np.ndarray, "equations joints"]:
    """Variance of friction that signs do not tell."""
    breakaway = problem.breakaway(point)
    extra = np.where(signs.uncertain, (_UNCERTAIN * breakaway) ** 2, 0.0)
    for offset in (-1, 0, 1):
        extra[signs.samples - 1 + offset, signs.joints] = (_REVERSAL * breakaway[signs.joints]) ** 2
    return extra


@dataclasses.dataclass(frozen=True)
class _Step:
    """A step of Levenberg and Marquardt's method.

    - `point`: after it; `residuals` there; `factored`: the equations that it solves.
    - `damping`: for the next one.
    - `change`: of the border, in standard errors: no coefficient moves by more of its own.
    - `promise`: as of `Linear`.
    """

    point: Point
    residuals: Residuals
    factored: Factored
    damping: float
    change: float
    promise: float


def _step(problem: Problem, linear: Linear, point: Point, damping: float) -> _Step:
    """Damped until the sum of squares falls; without a change where it never does.

    **Raises** `RuntimeError` if rounding has made the equations indefinite.
    """
    objective = linear.objective
    residuals = objective.residuals(point)
    value, promise, size, factored = objective.value(residuals), np.inf, np.inf, None
    for _ in range(_MOST_TRIALS):
        try:
            factored = linear.factored(damping)
        except LinAlgError:
            damping = _FACTOR * max(damping, _SMALL_DAMPING)
            continue
        change = linear.step(factored, linear.residuals, damping)
        if promise == np.inf:  # before damping grows
            promise = linear.promise(change)
            size = float(np.sqrt(max(change.border @ factored.information @ change.border, 0.0)))
        for number in range(_MOST_HALVINGS):
            part = change.scaled(0.5**number)
            moved = _bounded(problem, objective.moved(point, part), point)
            left = objective.residuals(moved)
            if objective.value(left) <= value * (1.0 + 1e-12):
                if number == 0:
                    damping = max(damping / _FACTOR, _LEAST_DAMPING)
                return _Step(moved, left, factored, damping, size, promise)
        damping = _FACTOR * max(damping, 1e-5)
    if factored is None:
        raise RuntimeError("maximum likelihood: rounding has made the normal equations indefinite")
    # A minimum up to rounding, if nothing was to be expected.
    damping = _SMALL_DAMPING if promise <= _PROMISE else _DAMPING
    return _Step(point, residuals, factored, damping, size, promise)


def _bounded(problem: Problem, point: Point, before: Point) -> Point:
    low, high = problem.slope_bounds
    near = np.clip(point.slopes, before.slopes - _SLOPE_STEP, before.slopes + _SLOPE_STEP)
    return dataclasses.replace(
        point,
        slopes=np.clip(near, low, high),
        calibration=problem.calibration.bounded(point.calibration, before.calibration),
        turn=np.clip(point.turn, -LATEST_TURN, LATEST_TURN),
    )


def _with_levels(
    problem: Problem, state: _State, linear: Linear, step: _Step, counted: Mask, number: int
) -> _State:
    """Noise levels and weights of outliers that follow the residuals of a step."""
    part, signs = problem.readings.part, linear.objective.signs
    draws = NoiseDraws.of(linear, step.factored, part, state.torque_noise, state.position_noise)
    torque_noise, position_noise = noise_levels(
        step.residuals,
        draws,
        counted,
        problem.moving,
        part,
        state.torque_noise,
        state.position_noise,
        problem.encoder_step > 0.0,
    )
    torque_noise = np.maximum(torque_noise, problem.least_torque_noise)
    position_noise = np.maximum(position_noise, problem.least_position_noise)
    if number > _FREE_LEVEL_STEPS:
        torque_noise = np.sqrt(torque_noise * state.torque_noise)
        position_noise = np.sqrt(position_noise * state.position_noise)
    # Uncertain friction is within break-away; what pushes a joint at its limit is not.
    extra = np.where(signs.uncertain, _friction_variance(problem, signs, step.point), 0.0)
    deviation = np.sqrt(torque_noise[part[1:-1]] ** 2 + extra)
    robust = (counted | signs.uncertain) & (linear.weights.torque > 0.0)
    size = np.maximum(np.abs(step.residuals.torque), 1e-300)
    change = max(
        np.abs(np.log(new / old)).max()
        for new, old in (
            (torque_noise, state.torque_noise),
            (position_noise, state.position_noise),
        )
    )
    modelled = number > len(_MARGINS)
    return dataclasses.replace(
        state,
        torque_noise=torque_noise,
        position_noise=position_noise,
        outlier_weight=np.where(robust, np.minimum(1.0, _OUTLIER * deviation / size), 1.0),
        levels_fixed=number >= _MOST_LEVEL_STEPS or (modelled and bool(change <= _LEVEL_TOLERANCE)),
    )


def _with_intervals(problem: Problem, state: _State, linear: Linear, factored: Factored) -> _State:
    """Counts as intervals, where positions are known much better than a step."""
    part, step = problem.readings.part, problem.encoder_step
    draws = NoiseDraws.of(linear, factored, part, state.torque_noise, state.position_noise)
    errors = position_errors(draws, problem.moving, part, len(step))
    errors = errors / np.where(step > 0.0, step, 1e-300)
    edge = np.where(errors <= _SHARP, np.maximum(_EDGE * errors, _LEAST_EDGE), 0.0)
    intervals = None
    if edge.any():
        intervals = Intervals(problem.reading_shares, step[part], edge[part])
    return dataclasses.replace(state, intervals=intervals, final=True)
