"""The step to the minimum of linear equations under laws that are no squares."""

import dataclasses

from ._linear import Linear
from ._objective import Residuals
from ._point import Step
from .band import Factored


# The laws of counts and of joints that stick are taken where a step ends up to so many times, until
# the sum of squares falls by this part of what their parabolas promise.
_MOST_SOLUTIONS, _GOOD = 8, 0.5
# Halvings of a step whose solutions have all gone up.
_MOST_HALVINGS = 20


@dataclasses.dataclass(frozen=True)
class LinearMinimum:
    """The step to the minimum of an objective, were all equations of motion linear.

    Counts and bounds of joints that stick are flat on one side and steep on the other. Parabolas
    about the present residuals are those of one side: the step to their minimum goes far beyond the
    other one, and what it promises never comes. So where the laws are steeper, their parabolas are
    taken where that step ends, and it is solved again, without another evaluation of the equations
    of motion: an active set. (Newton's method, which takes all parabolas from there, goes to and
    fro between the sides where a joint creeps before it turns, and leans on its bound for long.)

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

        **Arguments**

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
            if 0.0 <= result.promise <= least or fall >= _GOOD * max(result.promise, 0.0):
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
        for _ in range(_MOST_HALVINGS):
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
