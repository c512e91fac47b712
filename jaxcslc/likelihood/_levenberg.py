"""The step to the minimum of linear equations under laws that are no squares."""

import dataclasses
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError

from ._banded_solver import Factored
from ._objective import Linear, Residuals
from ._point import Point, Step
from ._problem import LikelihoodProblem


# The laws of counts and of joints that stick are taken where a step ends up to so many times, until
# the sum of squares falls by this part of what their parabolas promise.
_MOST_SOLUTIONS, _GOOD_LINEAR_STEP = 8, 0.5


@dataclasses.dataclass(frozen=True)
class LinearMinimum:
    """The step to the minimum of an objective, were all equations of motion linear.

    Laws of encoder intervals and of joints that stick are flat on one side and steep on the other.
    A parabola about the present residual is that of one side: the step to its minimum overshoots on
    the other side, and the predicted decrease does not occur. So where the laws are steeper, their
    parabolas are taken at the end of that step, and it is solved again, without another evaluation
    of the equations of motion: an active set. (Newton's method takes all parabolas from there. It
    alternates between the sides where a joint creeps before it turns, and leans on its bound for
    long.)

    **Attributes**

    - `linear`: with the parabolas of the last solution; `factored`: its normal equations.
    - `damping`: of these; `step`: to its minimum; `after`: residuals there.
    - `promise`: how far the sum of squares falls in the step, by these parabolas or by the laws as
      they are.
    """

    linear: Linear
    factored: Factored
    damping: float
    step: Step
    after: Residuals
    promise: float

    @classmethod
    def of(
        cls, linear: Linear, damping: float, least: float, start: Linear | None = None
    ) -> "LinearMinimum":
        """Solve equations about a point.

        - `damping`: of the normal equations.
        - `least`: what is promised below this is not worth another solution.
        - `start`: the same equations, whose parabolas are the first; those of `linear` if None.

        **Raises** `numpy.linalg.LinAlgError` if rounding has made the equations indefinite.
        """
        objective, present, value = linear.objective, linear.present, linear.present_value

        def solved(linear: Linear) -> LinearMinimum:
            factored = linear.factored(damping)
            step = linear.step(factored, linear.residuals, damping)
            after = linear.after(step, present)
            return cls(linear, factored, damping, step, after, value - linear.value(after))

        result = solved(start or linear)
        if not objective.bent:
            return dataclasses.replace(result, promise=linear.promise(result.step))
        fall = value - objective.value(result.after)
        for _ in range(_MOST_SOLUTIONS):
            if 0.0 <= result.promise <= least or fall >= _GOOD_LINEAR_STEP * max(
                result.promise, 0.0
            ):
                break
            bent = result.linear.about(result.after)
            del result  # its matrices are as large as all else together
            result = solved(bent)
            fall = value - objective.value(result.after)
        else:
            if fall <= 0.0:
                del result
                return solved(start or linear)._shortened(value)
        # Parabolas of steep sides are above flat ones, and may promise less than there is.
        return dataclasses.replace(result, promise=max(result.promise, fall))

    def _shortened(self, value: float) -> "LinearMinimum":
        """Return a part of the step in which laws fall from a value, the best of its halves.

        The set of steep laws only grows. Where many are steep that should not be, the step to the
        minimum of their parabolas goes up, and a search that waits for another one does not end.
        Parabolas of the present have the slope of the laws: along their step these fall at first.
        """
        objective, present, best = self.linear.objective, self.linear.present, self
        fall, part = 0.0, 1.0
        # Halvings of a step whose solutions have all gone up.
        for _ in range(20):
            part *= 0.5
            step = self.step.scaled(part)
            after = self.linear.after(step, present)
            of_part = value - objective.value(after)
            if of_part <= fall and fall > 0.0:
                break
            if of_part > fall:
                fall = of_part
                best = dataclasses.replace(self, step=step, after=after, promise=fall)
        return best


# Dampings that a step is tried with, and halvings of a step whose sum of squares has gone up.
_MOST_TRIALS, _MOST_HALVINGS = 8, 4
# A whole step is corrected for what is not linear up to so many times, until the sum of squares
# falls by this part of what linear equations promise, and as long as what is missing of that falls
# below this part of what was missing before.
_MOST_CORRECTIONS, _GOOD, _NEARER = 6, 0.5, 0.3
# A step in which the sum of squares falls by less than this part of its promise is too long: the
# sum bends more than linear equations say, and steps go back and forth over its minimum (a pendulum
# whose friction grows little by little with speed: 15 steps instead of 44). Not beside counts and
# joints that stick, whose laws are no parabolas: there 60 steps were not enough instead of 20.
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
        """Fall of the sum of squares that linear equations promise."""
        return self.minimum.promise


def levenberg_step(
    problem: LikelihoodProblem, linear: Linear, point: Point, damping: float
) -> LevenbergStep:
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

    problem: LikelihoodProblem
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
        """Correct the step as long as it comes much nearer to the promise of linear equations."""
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
