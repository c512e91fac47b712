"""A step of Levenberg and Marquardt's method, with corrections for what is not linear."""

import dataclasses
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError

from ._linear import Linear
from ._linear_minimum import LinearMinimum
from ._objective import Residuals
from ._point import Point, Step
from ._problem import Problem


_MOST_TRIALS, _MOST_HALVINGS = 8, 4
# A whole step is corrected for what is not linear up to so many times, until the sum of squares
# falls by this part of what linear equations promise, and as long as what is missing of that falls
# below this part of what was missing before.
_MOST_CORRECTIONS, _GOOD, _NEARER = 6, 0.5, 0.3
# A step in which the sum of squares falls by less than this part of its promise is too long: the
# sum bends more than linear equations say, and steps go to and fro over its minimum (a pendulum
# whose friction grows little by little with speed: 15 steps in place of 44). Not beside counts and
# joints that stick, whose laws are no parabolas: there 60 steps were not enough in place of 20.
_POOR = 0.25
# A promise below this is of rounding.
_ROUNDING = 1e-5
# The damping: at first, least, its factor after good and bad steps, and the most with which a
# search has converged.
DAMPING, _LEAST_DAMPING, _FACTOR, SMALL_DAMPING = 1e-3, 1e-9, 10.0, 1e-6
# A minimum is where linear equations promise less than this of the sum of squares.
PROMISE = 0.02
# At a kink they may promise as much as this, and it never comes; damping that grew there says
# nothing of the next step.
AT_KINK = 0.1


@dataclasses.dataclass(frozen=True)
class LevenbergStep:
    """A step of Levenberg and Marquardt's method.

    - `point`: after it; `residuals` there.
    - `minimum`: that it went for, before damping grew.
    - `damping`: for the next one.
    - `change`: of the border, in standard errors: no coefficient moves by more of its own.
    - `fall`: how much the sum of squares fell, as a part of it.
    """

    point: Point
    residuals: Residuals
    minimum: LinearMinimum
    damping: float
    change: float
    fall: float

    @property
    def promise(self) -> float:
        """How far the sum of squares was to fall, were all equations linear."""
        return self.minimum.promise


def levenberg_step(problem: Problem, linear: Linear, point: Point, damping: float) -> LevenbergStep:
    """Take a step, damped until the sum of squares falls; none where it never does.

    Where torque is nearly exact, a minimum is at the end of a bent valley: magnitude times slope of
    static friction stays the same along it. A step that misses it is solved again for the torque
    that linear equations missed, with the same factorisation (Transtrum and Sethna 2012), before it
    is halved. Damping that had to grow stays for another step.

    **Raises** `RuntimeError` if rounding has made the equations indefinite.
    """
    value, first, size = linear.present_value, None, np.inf
    start: Linear | None = None
    # Optimistix's trust region as judge of steps and damping (PUMA 560, encoders, 1,500 samples):
    # 31 steps instead of 24; with static friction no end in 60 instead of one after 19.
    for number in range(_MOST_TRIALS):
        try:
            minimum = LinearMinimum.of(linear, damping, PROMISE, start)
        except LinAlgError:
            damping = _FACTOR * max(damping, SMALL_DAMPING)
            continue
        if first is None:  # before damping grows
            first, border = minimum, minimum.step.border
            size = float(np.sqrt(max(border @ first.factored.information @ border, 0.0)))
        # Where no more is promised, a rise by as much is of rounding too.
        rounding = max(1e-12 * abs(value), _ROUNDING if first.promise <= _ROUNDING else 0.0)
        trial = _Trials(problem, minimum, damping, point, value, rounding).best()
        if trial.fall >= -rounding:
            if trial.whole and not number:
                damping = max(damping / _FACTOR, _LEAST_DAMPING)
            if first.promise <= AT_KINK:
                damping = min(damping, SMALL_DAMPING)
            fall = trial.fall / value if value > 0.0 else 0.0
            return LevenbergStep(trial.point, trial.residuals, first, damping, size, fall)
        damping = _FACTOR * max(damping, 1e-5)
        start = minimum.linear
        del minimum  # its matrices are as large as all else together
    if first is None:
        raise RuntimeError("maximum likelihood: rounding has made the normal equations indefinite")
    # A minimum up to rounding, if nothing was to be expected.
    damping = SMALL_DAMPING if first.promise <= PROMISE else DAMPING
    return LevenbergStep(point, linear.present, first, damping, size, 0.0)


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

    - `minimum`: of linear equations; `damping`: of these.
    - `value`: the sum of squares there; `rounding`: how far it may rise.
    """

    problem: Problem
    minimum: LinearMinimum
    damping: float
    start: Point
    value: float
    rounding: float

    def best(self) -> _Trial:
        """Return the step with its corrections or, where none is good, the first part of it that
        is.

        The sum of squares need not fall in it.
        """
        trial, promise = self._corrected(), self.minimum.promise
        objective = self.minimum.linear.objective
        if not objective.bent and trial.fall < _POOR * promise and promise > PROMISE:
            # To the minimum of the parabola with this slope and this fall.
            part = promise / (2.0 * promise - trial.fall)
            shorter = self._trial(self.minimum.step.scaled(part), whole=False)
            trial = shorter if shorter.fall > trial.fall else trial
        missing = promise - trial.fall
        for number in range(1, _MOST_HALVINGS):
            # What is not linear in residuals grows with the square of a step.
            if trial.fall >= -self.rounding or 0.5 ** (4 * number) * missing > promise:
                break
            trial = self._trial(self.minimum.step.scaled(0.5**number), whole=False)
        return trial

    def _corrected(self) -> _Trial:
        """As long as corrections come much nearer to what linear equations promise."""
        linear, part, promise = self.minimum.linear, self.minimum.step, self.minimum.promise
        last = None
        best = trial = self._trial(part, whole=True)
        for _ in range(_MOST_CORRECTIONS if promise > _ROUNDING else 0):
            if trial.fall > best.fall:
                best = trial
            missing = promise - trial.fall
            if missing <= (1.0 - _GOOD) * promise or (last and missing > _NEARER * last):
                break
            moved, left = linear.objective.moved(self.start, part), trial.residuals
            if not np.array_equal(moved.border, trial.point.border):  # it went to a bound
                left = linear.objective.residuals(moved)
            missed = left["torque"] - linear.after(part, linear.present)["torque"]
            corrected = {**linear.residuals, "torque": linear.residuals["torque"] + missed}
            part, last = linear.step(self.minimum.factored, corrected, self.damping), missing
            trial = self._trial(part, whole=True)
        return trial if trial.fall > best.fall else best

    def _trial(self, part: Step, *, whole: bool) -> _Trial:
        objective = self.minimum.linear.objective
        point = self.problem.bounded(objective.moved(self.start, part), self.start)
        residuals = objective.residuals(point)
        return _Trial(point, residuals, self.value - objective.value(residuals), whole)
