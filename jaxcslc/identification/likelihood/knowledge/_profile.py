"""The sum of squares as a function of coefficients, all else at its minimum."""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from .._linear import Linear
from .._objective import Objective
from ..band import Factored
from ..search import Minimum, State


# The sum of squares may bend more than its parabola by this part of it: then it falls in a step to
# the parabola's minimum among a convex set, by a quarter of the square of the step at least.
_MOST_BEND = 0.75
# Else a part of the step is tried: what would be right for a parabola that bends as much, no less
# than this, and so often. Where the square of a step says less than searches leave, the next is
# half of one: no more bend than twice the parabola's was seen.
_LEAST_PART, _MOST_PARTS, _SMALL = 0.1, 4, 0.1

Coefficients = Float[np.ndarray, " coefficients"]


@dataclasses.dataclass(frozen=True)
class Profile:
    """The sum of squares as a function of coefficients, all else at its minimum for these.

    **Attributes**

    - `minimum`: of all else, with equations in which coefficients are unknown, too.
    - `target`: (p,) coefficients at the minimum of the parabola about the present ones.
    - `step`: to it, and `information`: (p, p), in units of `scale`; of coefficients that are known,
      0.
    """

    minimum: Minimum
    target: Coefficients
    step: Coefficients
    information: Float[np.ndarray, "coefficients coefficients"]
    scale: Coefficients

    @classmethod
    def of(cls, minimum: Minimum, scale: Float[np.ndarray, " border"]) -> "Profile":
        """Expand about the end of a search with fixed coefficients; `scale` of the problem
        without."""
        objective = dataclasses.replace(minimum.objective, scale=scale)
        linear = Linear.of(objective, minimum.point)
        factored = linear.factored(0.0)
        unconfined = dataclasses.replace(
            minimum, objective=objective, linear=linear, factored=factored
        )
        step, p = linear.step(factored, linear.residuals), len(minimum.point.k)
        return cls(
            unconfined,
            objective.moved(minimum.point, step).k,
            step.border[:p],
            _eliminated(objective, factored, p),
            scale[:p],
        )

    @property
    def k(self) -> Coefficients:
        """(p,) present coefficients."""
        return self.minimum.point.k

    def towards(
        self, change: Coefficients, part: float, search: Callable[[Coefficients, State], Minimum]
    ) -> tuple[Minimum, float, int]:
        """Return the minimum of all else for coefficients that are changed, or for a part of the
        change.

        **Arguments**

        - `change`: (p,) to the minimum of the parabola among a convex set; `part`: of it that is
          tried first.
        - `search`: of the minimum for coefficients, with the signs and weights of a state.

        **Returns** the minimum, the part that would be right where the sum of squares bends as much
        as on the way there, and how many steps its search has taken.
        """
        state, steps = self.minimum.state, 0
        for number in range(1, _MOST_PARTS + 1):
            trial = search(self.k + part * change, state)
            steps += trial.steps
            comparable = trial.state.same_motion(state)
            if not comparable:
                return trial, part, steps
            if self._size(part * change) <= _SMALL:
                return trial, min(part, 0.5), steps
            bend = self._bend(trial)
            part = float(np.clip(1.0 / (1.0 + bend), _LEAST_PART, 1.0)) if bend > 0.0 else 1.0
            if bend <= _MOST_BEND or number == _MOST_PARTS:
                return trial, part, steps
        raise AssertionError

    def _size(self, change: Coefficients) -> float:
        """Return the square of a change, in the metric of the information."""
        of_scale = self._scaled(change)
        return float(of_scale @ self.information @ of_scale)

    def _bend(self, trial: Minimum) -> float:
        """How much more the sum of squares bends up to a trial than its parabola, as a part of
        that."""
        change = trial.point.k - self.k
        square = self._size(change)
        promise = 2.0 * float(self._scaled(change) @ self.information @ self.step) - square
        fall = self.minimum.linear.present_value - trial.linear.present_value
        return (promise - fall) / square

    def _scaled(self, change: Coefficients) -> Coefficients:
        return np.where(self.scale > 0.0, change / np.where(self.scale > 0.0, self.scale, 1.0), 0.0)


def _eliminated(
    objective: Objective, factored: Factored, p: int
) -> Float[np.ndarray, "coefficients coefficients"]:
    """Return the information of coefficients, slopes and offsets eliminated."""
    others = p + np.flatnonzero(objective.scale[p:])
    of_others = factored.information[np.ix_(others, others)]
    mixed = factored.information[np.ix_(others, np.arange(p))]
    left = np.linalg.lstsq(of_others, mixed, rcond=None)[0]
    return factored.information[:p, :p] - mixed.T @ left
