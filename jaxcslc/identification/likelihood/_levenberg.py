import dataclasses
from collections.abc import Iterator

import numpy as np
from scipy.linalg import LinAlgError

from ._band import Factored
from ._linear import Linear
from ._objective import Point, Residuals, Step
from ._problem import Problem
from ._signs import LATEST_TURN


_MOST_TRIALS, _MOST_HALVINGS = 8, 4
# Up to so many whole steps are tried, the later ones corrected for what is not linear, until the
# sum of squares falls by this part of what linear equations promise.
_MOST_CORRECTIONS, _GOOD = 3, 0.5
# A promise below this is of rounding.
_ROUNDING = 1e-5
# The damping: at first, least, its factor after good and bad steps, and the most with which a
# search has converged.
DAMPING, _LEAST_DAMPING, _FACTOR, SMALL_DAMPING = 1e-3, 1e-9, 10.0, 1e-6
# A minimum is where linear equations promise less than this of the sum of squares.
PROMISE = 0.02
# How far the logarithm of a slope moves in a step.
_SLOPE_STEP = 0.7


@dataclasses.dataclass(frozen=True)
class LevenbergStep:
    """A step of Levenberg and Marquardt's method.

    - `point`: after it; `residuals` there; `factored`: the equations that it solves.
    - `damping`: for the next one.
    - `change`: of the border, in standard errors: no coefficient moves by more of its own.
    - `promise`: as of `Linear`; `fall`: how much the sum of squares fell, as a part of it.
    """

    point: Point
    residuals: Residuals
    factored: Factored
    damping: float
    change: float
    promise: float
    fall: float


def levenberg_step(problem: Problem, linear: Linear, point: Point, damping: float) -> LevenbergStep:
    """Damped until the sum of squares falls; without a change where it never does.

    Where torque is nearly exact, a minimum is at the end of a bent valley: magnitude times slope of
    static friction stays the same along it. A step that misses it is solved again for the torque
    that linear equations missed, with the same factorisation (Transtrum and Sethna 2012), before it
    is halved.

    **Raises** `RuntimeError` if rounding has made the equations indefinite.
    """
    objective = linear.objective
    residuals = objective.residuals(point)
    value, promise, size, factored = objective.value(residuals), np.inf, np.inf, None
    for _ in range(_MOST_TRIALS):
        try:
            factored = linear.factored(damping)
        except LinAlgError:
            damping = _FACTOR * max(damping, SMALL_DAMPING)
            continue
        change = linear.step(factored, linear.residuals, damping)
        if promise == np.inf:  # before damping grows
            promise = linear.promise(change)
            size = float(np.sqrt(max(change.border @ factored.information @ change.border, 0.0)))
        for part, whole, least in _trials(linear, factored, change, damping, point, promise):
            moved = _bounded(problem, objective.moved(point, part), point)
            left = objective.residuals(moved)
            fall = value - objective.value(left)
            # Where no more is promised, a rise by as much is of rounding too.
            rounding = _ROUNDING if promise <= _ROUNDING else 0.0
            if fall >= least - max(1e-12 * abs(value), rounding):
                if whole:
                    damping = max(damping / _FACTOR, _LEAST_DAMPING)
                fall = fall / value if value > 0.0 else 0.0
                return LevenbergStep(moved, left, factored, damping, size, promise, fall)
        damping = _FACTOR * max(damping, 1e-5)
    if factored is None:
        raise RuntimeError("maximum likelihood: rounding has made the normal equations indefinite")
    # A minimum up to rounding, if nothing was to be expected.
    damping = SMALL_DAMPING if promise <= PROMISE else DAMPING
    return LevenbergStep(point, residuals, factored, damping, size, promise, 0.0)


def _trials(
    linear: Linear,
    factored: Factored,
    change: Step,
    damping: float,
    point: Point,
    promise: float,
) -> Iterator[tuple[Step, bool, float]]:
    """Steps to try, whether each is a whole one, and how far the sum of squares is to fall in it.

    First the step and its corrections for the torque that linear equations missed, then parts.
    """
    objective, residuals = linear.objective, linear.residuals
    part = change
    for _ in range(_MOST_CORRECTIONS if promise > _ROUNDING else 0):
        yield part, True, _GOOD * promise
        left = objective.residuals(objective.moved(point, part)).torque
        missed = left - linear.after(part, residuals).torque
        corrected = dataclasses.replace(residuals, torque=residuals.torque + missed)
        part = linear.step(factored, corrected, damping)
    for number in range(_MOST_HALVINGS):
        yield change.scaled(0.5**number), number == 0, 0.0


def _bounded(problem: Problem, point: Point, before: Point) -> Point:
    low, high = problem.slope_bounds
    near = np.clip(point.slopes, before.slopes - _SLOPE_STEP, before.slopes + _SLOPE_STEP)
    return dataclasses.replace(
        point,
        slopes=np.clip(near, low, high),
        calibration=problem.calibration.bounded(point.calibration, before.calibration),
        turn=np.clip(point.turn, -LATEST_TURN, LATEST_TURN),
    )
