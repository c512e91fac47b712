import dataclasses

import numpy as np
from jaxtyping import Float, Int

from ._readings import Intervals, WorkingReadings
from ._signs import Signs
from ._sticking import Sticking
from .equations import AbstractEquations
from .torque import TorqueRecord


# Prior standard deviation of a reversal about where velocity crosses zero, in intervals.
TURN = 0.5


@dataclasses.dataclass(frozen=True)
class Point:
    """Values of all unknowns.

    **Attributes**

    - `k`: (p,) coefficients; `slopes`: (n,) logarithms of static friction's.
    - `offset`: (recordings, n) of the encoders.
    - `q`: (samples, n) positions; `turn`: (reversals,) moments of the reversals.
    - `transmission`: (parameters,) of gears that give way, see `TransmissionParameters`; n is then
      the number of joints and of links that move apart from their rotors, together.
    """

    k: Float[np.ndarray, " coefficients"]
    slopes: Float[np.ndarray, " slopes"]
    offset: Float[np.ndarray, "recordings joints"]
    q: Float[np.ndarray, "samples joints"]
    turn: Float[np.ndarray, " reversals"]
    transmission: Float[np.ndarray, " parameters"] = dataclasses.field(
        default_factory=lambda: np.zeros(0)
    )

    @property
    def laws(self) -> Float[np.ndarray, " laws"]:
        """Slopes, and parameters of gears if there are any."""
        return np.concatenate([self.slopes, self.transmission])

    @property
    def border(self) -> Float[np.ndarray, " border"]:
        """Coefficients, laws and offsets: what all equations share."""
        return np.concatenate([self.k, self.laws, self.offset.ravel()])


@dataclasses.dataclass(frozen=True)
class Residuals:
    """One for each equation and each reading.

    **Attributes**

    - `torque`: (equations, n), `position`: (samples, n), recorded minus predicted.
    - `standstill`: (intervals, n) motion of joints at standstill, negative.
    - `turn`: (reversals,), `border`: (border,), expected minus present values.
    """

    torque: Float[np.ndarray, "equations joints"]
    position: Float[np.ndarray, "samples joints"]
    standstill: Float[np.ndarray, "intervals joints"]
    turn: Float[np.ndarray, " reversals"]
    border: Float[np.ndarray, " border"]


@dataclasses.dataclass(frozen=True)
class Step:
    """Changes of all unknowns; `border` in units of its scale."""

    border: Float[np.ndarray, " border"]
    position: Float[np.ndarray, "samples joints"]
    turn: Float[np.ndarray, " reversals"]

    def scaled(self, factor: float) -> "Step":
        """A part of it."""
        return Step(factor * self.border, factor * self.position, factor * self.turn)


@dataclasses.dataclass(frozen=True)
class Objective:
    """The sum of squares that is minimised, for fixed signs and noise levels.

    **Attributes**

    - `equations`: torque as a function of positions.
    - `position`: (samples, n) and `torque` as recorded.
    - `part`: (samples,) number of the recording.
    - `signs`: directions and reversals.
    - `weights`: inverse variances of all residuals; of the border 0 where nothing is known
      beforehand.
    - `expected`: (border,) values known beforehand.
    - `scale`: (border,) size of each coefficient, slope and offset; 0 fixes it.
    - `intervals`: of readings that are intervals; None if all are normally distributed.
    - `sticking`: equations that bound friction at break-away; None if there are none.
    - `truncation`: (equations, n) torque that is added to what equations predict [N m or N].
    """

    equations: AbstractEquations
    position: Float[np.ndarray, "samples joints"]
    torque: TorqueRecord
    part: Int[np.ndarray, " samples"]
    signs: Signs
    weights: Residuals
    expected: Float[np.ndarray, " border"]
    scale: Float[np.ndarray, " border"]
    intervals: Intervals | None = None
    sticking: Sticking | None = None
    truncation: Float[np.ndarray, "equations joints"] | float = 0.0

    def residuals(self, point: Point) -> Residuals:
        """Recorded minus predicted."""
        predicted = self.equations.torque(
            point.k, point.laws, point.q, self.signs.turns(point.turn), self.signs.direction
        )
        return self.residuals_of(point, np.asarray(predicted))

    def value(self, residuals: Residuals) -> float:
        """The sum of squares over their variances; of intervals, minus twice their logarithm."""
        return self.total(residuals, self.torques(residuals), self.readings(residuals))

    def total(
        self, residuals: Residuals, torques: WorkingReadings, readings: WorkingReadings
    ) -> float:
        """`value`, of these laws at the residuals."""
        of_laws = float(np.sum(torques.value)) + float(np.sum(readings.value))
        return of_laws + self.squares(residuals)

    def squares(self, residuals: Residuals) -> float:
        """The part of the sum that is not of equations of motion or of readings."""
        return sum(
            float(np.sum(getattr(self.weights, name) * values**2))
            for name, values in vars(residuals).items()
            if name not in ("position", "torque")
        )

    def torques(self, residuals: Residuals) -> WorkingReadings:
        """The weighted squares that equations count as, about residuals."""
        torque, weight = residuals.torque, self.weights.torque
        if self.sticking is None:
            return WorkingReadings(weight * torque**2, weight, torque)
        return self.sticking.working(torque, weight)

    def readings(self, residuals: Residuals) -> WorkingReadings:
        """The weighted squares that readings count as, about residuals."""
        position, weight = residuals.position, self.weights.position
        if self.intervals is None:
            return WorkingReadings(weight * position**2, weight, position)
        return self.intervals.working(position, weight)

    def moved(self, point: Point, step: Step) -> Point:
        """The point after a step."""
        border = point.border + self.scale * step.border
        p, n = len(point.k), point.q.shape[1]
        of_slopes = p + len(point.slopes)
        first = p + len(point.laws)
        return Point(
            border[:p],
            border[p:of_slopes],
            border[first:].reshape(-1, n),
            point.q + step.position,
            point.turn + step.turn,
            border[of_slopes:first],
        )

    def residuals_of(
        self, point: Point, predicted: Float[np.ndarray, "equations joints"]
    ) -> Residuals:
        """Recorded minus predicted, with torque that has been predicted before."""
        return Residuals(
            self.torque.averaged - predicted - self.truncation,
            self.position - point.q - point.offset[self.part],
            -np.diff(point.q, axis=0),
            self.signs.turn - point.turn,
            self.expected - point.border,
        )
