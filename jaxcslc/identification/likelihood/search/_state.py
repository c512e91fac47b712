"""What changes from step to step of a search."""

import dataclasses
import enum

import numpy as np
from jaxtyping import Bool, Float

from .._levels import Levels
from .._levenberg import DAMPING
from .._point import Point
from .._problem import Problem
from .._readings import Intervals
from .._signs import Signs


# Equations left uncertain on either side of a reversal, step by step; after these steps, reversals
# are moments to be estimated.
MARGINS = (4, 3, 2)
# From this step on, a reversal that comes or goes is left uncertain.
SIGN_STEPS = 7

Mask = Bool[np.ndarray, "equations joints"]


class Stage(enum.Enum):
    """What follows the motion from step to step, beside signs.

    - `LEVELS`: noise levels and weights of outliers, while readings are normally distributed.
    - `COUNTS`: nothing, until steps are short: then counts become intervals where that says more.
    - `INTERVALS`: edges of intervals, and the torque noise that these leave.
    - `OUTLIERS`: weights of outliers, once, of a search that starts near its end.
    - `FINAL`: nothing.
    """

    LEVELS = enum.auto()
    COUNTS = enum.auto()
    INTERVALS = enum.auto()
    OUTLIERS = enum.auto()
    FINAL = enum.auto()


@dataclasses.dataclass(frozen=True)
class State:
    """What changes from step to step.

    - `outlier_weight`: (equations, n) of equations far beyond the noise.
    - `ambiguous`: (equations, n) of reversals that came and went.
    - `undecided`: (equations, n) of joints with a common shaft that may turn either way.
    - `stage`: what else changes.
    - `moments`: (samples, n) of reversals to start from, NaN where they are not known; None if none
      is.
    - `refinements`: of the level of torque noise beside intervals.
    - `of_friction`: the point whose friction says how uncertain friction is where its sign is, and
      how large static friction may be; None: the present one.
    - `truncation`: what equations leave out [N m or N]; None: what they do at the present point.
    """

    point: Point
    signs: Signs | None
    torque_noise: Levels
    position_noise: Levels
    outlier_weight: Float[np.ndarray, "equations joints"]
    ambiguous: Mask
    undecided: Mask
    intervals: Intervals | None
    damping: float
    stage: Stage
    refinements: int = 0
    moments: Float[np.ndarray, "samples _"] | None = None
    of_friction: Point | None = None
    truncation: Float[np.ndarray, "equations series"] | float | None = None

    @classmethod
    def start(
        cls,
        problem: Problem,
        point: Point,
        torque_noise: Levels,
        position_noise: Levels,
        fixed: bool,
        edge: Levels | None,
        moments: Float[np.ndarray, "samples _"] | None,
    ) -> "State":
        samples, n = problem.readings.position.shape
        intervals = None if edge is None else intervals_of(problem, edge)
        stage = Stage.LEVELS
        if fixed:
            stage = Stage.FINAL if edge is None else Stage.OUTLIERS
        return cls(
            point,
            None,
            np.maximum(torque_noise, problem.least_torque_noise),
            position_noise,
            np.ones((samples - 2, n)),
            np.zeros((samples - 2, n), bool),
            np.zeros((samples - 2, n), bool),
            intervals,
            DAMPING,
            stage,
            moments=moments,
        )

    def same_motion(self, other: "State") -> bool:
        """Whether signs and what is uncertain of them are the other's, so that sums of squares are
        comparable."""
        return self.signs is other.signs and np.array_equal(self.undecided, other.undecided)


def with_signs(problem: Problem, state: State, number: int) -> tuple[State, bool]:
    """Return the signs of the present motion, unless they are those of before, which is said.

    A reversal between two samples belongs to the one that it was with. Of a reversal that comes and
    goes, as next to a rest, and of one whose moment would leave its samples, as where a joint
    breaks away, equations stay uncertain.
    """
    readings, before, point = problem.readings, state.signs, state.point
    modelled = number >= len(MARGINS)
    ambiguous = state.ambiguous
    while True:
        signs = Signs.of(
            point.q[:, : problem.joints],
            readings.time,
            problem.stuck,
            margin=MARGINS[min(number, len(MARGINS) - 1)],
            modelled=modelled,
            joined=readings.joined,
            ambiguous=ambiguous,
        )
        if before is None and state.moments is not None:
            unknown = signs.without_moments(state.moments) & ~ambiguous
            if not unknown.any():
                break
            ambiguous = ambiguous | unknown
            continue
        if before is None or number <= len(MARGINS):
            break
        unmatched = signs.unmatched(before)
        if number >= SIGN_STEPS:
            unmatched |= before.at_bounds(point.turn)
        if not unmatched.any():
            return state, True
        if number < SIGN_STEPS or np.all(ambiguous[unmatched]):
            break
        ambiguous = ambiguous | unmatched
    if before is not None:
        turn = signs.carried(before, point.turn)
    elif state.moments is not None:
        turn = signs.from_moments(state.moments)
    else:
        turn = signs.turn
    point = dataclasses.replace(point, turn=turn)
    return dataclasses.replace(state, signs=signs, point=point, ambiguous=ambiguous), False


def intervals_of(problem: Problem, edge: Levels) -> Intervals | None:
    """Return readings with edges of these widths; None if all are 0."""
    if not edge.any():
        return None
    part = problem.readings.part
    return Intervals(problem.reading_shares, problem.encoder_step[part], edge[part])
