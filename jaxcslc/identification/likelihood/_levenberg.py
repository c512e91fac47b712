import dataclasses
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError

from ._linear import Linear
from ._objective import Point, Residuals, Step
from ._problem import Problem
from ._signs import LATEST_TURN
from .band import Factored


_MOST_TRIALS, _MOST_HALVINGS = 8, 4
# Other parabolas are tried up to so many times where the sum of squares falls by less than this
# part of what linear equations promise.
_MOST_PARABOLAS, _POOR = 6, 0.1
# A whole step is corrected for what is not linear up to so many times, until the sum of squares
# falls by this part of what linear equations promise, and as long as what is missing of that falls
# below this part of what was missing before.
_MOST_CORRECTIONS, _GOOD, _NEARER = 6, 0.5, 0.3
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
    is halved. Counts and joints that stick, which a step takes from where they are flat to where
    they are steep, get parabolas of the step's end before anything is damped: damping holds all
    positions for the sake of some.

    **Raises** `RuntimeError` if rounding has made the equations indefinite.
    """
    value, promise, size, factored = linear.objective.value(linear.present), np.inf, np.inf, None
    bent, best = linear, None
    for number in range(_MOST_TRIALS + _MOST_PARABOLAS):
        try:
            solved = bent.factored(damping)
        except LinAlgError:
            damping = _FACTOR * max(damping, SMALL_DAMPING)
            continue
        factored = solved if bent is linear or factored is None else factored
        change = bent.step(solved, bent.residuals, damping)
        if promise == np.inf:  # before damping grows
            promise = linear.promise(change)
            size = float(np.sqrt(max(change.border @ solved.information @ change.border, 0.0)))
        # Where no more is promised, a rise by as much is of rounding too.
        rounding = max(1e-12 * abs(value), _ROUNDING if promise <= _ROUNDING else 0.0)
        trials = _Trials(problem, bent, solved, damping, point, value, rounding)
        trial = trials.best(change, promise)
        if best is None or trial.fall > best.fall:
            best = trial
        if best.fall < _POOR * promise and promise > PROMISE and number < _MOST_PARABOLAS:
            stiffer = bent.stiffened(trials.whole(change).residuals)
            if stiffer is not None:
                bent = stiffer
                continue
        trial = best
        if trial.fall >= -rounding:
            if trial.whole:
                damping = max(damping / _FACTOR, _LEAST_DAMPING)
            fall = trial.fall / value if value > 0.0 else 0.0
            return LevenbergStep(
                trial.point, trial.residuals, factored, damping, size, promise, fall
            )
        damping = _FACTOR * max(damping, 1e-5)
    if factored is None:
        raise RuntimeError("maximum likelihood: rounding has made the normal equations indefinite")
    # A minimum up to rounding, if nothing was to be expected.
    damping = SMALL_DAMPING if promise <= PROMISE else DAMPING
    return LevenbergStep(point, linear.present, factored, damping, size, promise, 0.0)


class _Trial(NamedTuple):
    """A point that was tried: residuals there, how far the sum of squares fell, and whether the
    step to it was a whole one."""

    point: Point
    residuals: Residuals
    fall: float
    whole: bool


@dataclasses.dataclass(frozen=True)
class _Trials:
    """Steps from a point with one factorisation.

    - `value`: the sum of squares there; `rounding`: how far it may rise.
    """

    problem: Problem
    linear: Linear
    factored: Factored
    damping: float
    start: Point
    value: float
    rounding: float

    def best(self, change: Step, promise: float) -> _Trial:
        """The step with its corrections or, where none is good, the first part of it that is.

        The sum of squares need not fall in it.
        """
        trial = self._corrected(change, promise)
        for number in range(1, _MOST_HALVINGS):
            if trial.fall >= -self.rounding:
                break
            trial = self._trial(change.scaled(0.5**number), whole=False)
        return trial

    def whole(self, change: Step) -> _Trial:
        """The step as it is."""
        return self._trial(change, whole=True)

    def _corrected(self, change: Step, promise: float) -> _Trial:
        """As long as corrections come much nearer to what linear equations promise."""
        linear, part, last = self.linear, change, None
        best = trial = self._trial(change, whole=True)
        for _ in range(_MOST_CORRECTIONS if promise > _ROUNDING else 0):
            if trial.fall > best.fall:
                best = trial
            missing = promise - trial.fall
            if missing <= (1.0 - _GOOD) * promise or (last and missing > _NEARER * last):
                break
            moved, left = linear.objective.moved(self.start, part), trial.residuals
            if not np.array_equal(moved.border, trial.point.border):  # it went to a bound
                left = linear.objective.residuals(moved)
            missed = left.torque - linear.after(part, linear.present).torque
            corrected = dataclasses.replace(
                linear.residuals, torque=linear.residuals.torque + missed
            )
            part, last = linear.step(self.factored, corrected, self.damping), missing
            trial = self._trial(part, whole=True)
        return trial if trial.fall > best.fall else best

    def _trial(self, part: Step, *, whole: bool) -> _Trial:
        objective = self.linear.objective
        point = _bounded(self.problem, objective.moved(self.start, part), self.start)
        residuals = objective.residuals(point)
        return _Trial(point, residuals, self.value - objective.value(residuals), whole)


def _bounded(problem: Problem, point: Point, before: Point) -> Point:
    low, high = problem.slope_bounds
    near = np.clip(point.slopes, before.slopes - _SLOPE_STEP, before.slopes + _SLOPE_STEP)
    return dataclasses.replace(
        point,
        slopes=np.clip(near, low, high),
        calibration=problem.calibration.bounded(point.calibration, before.calibration),
        turn=np.clip(point.turn, -LATEST_TURN, LATEST_TURN),
        transmission=(
            point.transmission
            if problem.transmission is None
            else problem.transmission.bounded(point.transmission)
        ),
    )
