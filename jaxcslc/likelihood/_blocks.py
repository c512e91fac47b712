"""Residual blocks: terms of the sum of squares that maximum likelihood minimises.

A block has residuals, a weight of each, and derivatives by unknowns in order of time (positions and
reversals) and by the border. Its residuals count by their squares unless it has a law of its own.
`Objective` adds blocks up; `Linear` is what their derivatives make of them.
"""

import abc
import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ._banded_solver import BandedEquations, Order
from ._equation_sums import (
    JointColumns,
    add_equations,
    equation_changes,
    equation_gradients,
    stencil,
)
from ._equations import AbstractEquations, EquationPoint
from ._laws import Intervals, Sticking, WorkingReadings
from ._point import Point, Step
from ._readings import TorqueRecord
from ._signs import Signs


# Prior standard deviation of a reversal about where velocity crosses zero, in intervals.
TURN = 0.5

Values = Float[np.ndarray, "*shape"]
Scale = Float[np.ndarray, " border"]


class Normal(NamedTuple):
    """Normal equations that squares of blocks are added to.

    **Attributes**

    - `equations`: of unknowns in order of time, and of a border of those that are free.
    - `order`: of the former; `free`: which of the border these are.
    - `column`: (border,) where each of the border is among those that are free.
    """

    equations: BandedEquations
    order: Order
    free: Int[np.ndarray, " free"]
    column: Int[np.ndarray, " border"]


class AbstractDerivatives(abc.ABC):
    """Derivatives of what a block predicts; of the border in units of its scale."""

    @abc.abstractmethod
    def changes(self, step: Step) -> Values:
        """Return by how much residuals fall in a step."""

    @abc.abstractmethod
    def add_gradient(self, force: Values, total: Step) -> None:
        """Add derivatives times `force`, weights times residuals, to a gradient."""

    @abc.abstractmethod
    def add_squares(self, weight: Values, normal: Normal) -> None:
        """Add weighted squares of derivatives to normal equations."""


class AbstractResidualBlock(abc.ABC):
    """A term of the sum of squares.

    **Attributes**

    - `weight`: inverse variances of residuals; 0 where they do not count.
    """

    weight: Values

    @abc.abstractmethod
    def residuals(self, point: Point) -> Values:
        """Return recorded or expected minus predicted values."""

    @abc.abstractmethod
    def derivatives(self, point: Point, scale: Scale) -> AbstractDerivatives:
        """Return derivatives about a point; `scale` of the border."""

    def linearised(self, point: Point, scale: Scale) -> tuple[Values, AbstractDerivatives]:
        """Return residuals and derivatives."""
        return self.residuals(point), self.derivatives(point, scale)

    @property
    def bent(self) -> bool:
        """Return whether residuals have a law other than their squares."""
        return False

    def law(self, residuals: Values) -> WorkingReadings:
        """Return the weighted squares that residuals count as, about these."""
        return WorkingReadings(self.weight * residuals**2, self.weight, residuals)


class ConstantBlock(AbstractResidualBlock, AbstractDerivatives):
    """A block whose derivatives are the same everywhere, and no others than by what is in time."""

    def derivatives(self, point: Point, scale: Scale) -> AbstractDerivatives:
        """Return itself."""
        del point, scale
        return self


@dataclasses.dataclass(frozen=True)
class ReadingBlock(AbstractResidualBlock):
    """Readings of joints, which have offsets.

    **Attributes**

    - `position`: (samples, n) as recorded; `part`: (samples,) number of the recording.
    - `intervals`: of readings that are intervals; None if all are normally distributed.
    """

    position: Float[np.ndarray, "samples joints"]
    part: Int[np.ndarray, " samples"]
    weight: Float[np.ndarray, "samples joints"]
    intervals: Intervals | None = None

    def residuals(self, point: Point) -> Float[np.ndarray, "samples joints"]:
        """Return recorded minus predicted positions."""
        return self.position - point.q - point.offset[self.part]

    def derivatives(self, point: Point, scale: Scale) -> "ReadingDerivatives":
        """Return derivatives by positions and offsets."""
        del point
        return ReadingDerivatives(self.part, self.position.shape[1], scale)

    @property
    def bent(self) -> bool:
        """Return whether some readings are intervals."""
        return self.intervals is not None

    def law(self, residuals: Float[np.ndarray, "samples joints"]) -> WorkingReadings:
        """Return the law of counts: of intervals, minus twice their logarithm."""
        if self.intervals is None:
            return super().law(residuals)
        return self.intervals.working(residuals, self.weight)


@dataclasses.dataclass(frozen=True)
class ReadingDerivatives(AbstractDerivatives):
    """Derivatives of readings by position and by offset: all one."""

    part: Int[np.ndarray, " samples"]
    joints: int
    scale: Scale

    @property
    def first(self) -> int:
        """Return where offsets begin in the border."""
        return len(self.scale) - self.joints * (int(self.part[-1]) + 1)

    @property
    def offset(self) -> Int[np.ndarray, "samples joints"]:
        """Return (samples, n): where the offset of each reading is in the border."""
        return self.first + self.joints * self.part[:, None] + np.arange(self.joints)

    def changes(self, step: Step) -> Float[np.ndarray, "samples joints"]:
        """Return changes with positions and offsets."""
        return step.position[:, : self.joints] + (self.scale * step.border)[self.offset]

    def add_gradient(self, force: Float[np.ndarray, "samples joints"], total: Step) -> None:
        """Add the gradient by positions and offsets."""
        total.position[:, : self.joints] += force
        total.border[self.first :] += self.scale[self.first :] * self._of_offsets(force)

    def add_squares(self, weight: Float[np.ndarray, "samples joints"], normal: Normal) -> None:
        """Add squares of positions, offsets and both."""
        index, offset = normal.order.position[:, : self.joints], self.offset
        normal.equations.band[index, 0] += weight
        normal.equations.mixed[index, normal.column[offset]] += weight * self.scale[offset]
        of_offsets = np.arange(self.first, len(self.scale))
        squares = self._of_offsets(weight) * self.scale[of_offsets] ** 2
        column = normal.column[of_offsets]
        np.add.at(normal.equations.border, (column, column), squares)

    def _of_offsets(self, readings: Float[np.ndarray, "samples joints"]) -> np.ndarray:
        """Return sums over the readings of each offset, one recording after the other."""
        firsts = np.flatnonzero(np.diff(self.part, prepend=-1))
        return np.add.reduceat(readings, firsts, axis=0).ravel()


@dataclasses.dataclass(frozen=True)
class MotionBlock(AbstractResidualBlock):
    """Equations of motion: recorded minus predicted torque.

    **Attributes**

    - `equations`: torque as a function of positions.
    - `record`: torques as recorded.
    - `signs`: directions and reversals.
    - `sticking`: equations that bound friction at break-away; None if there are none.
    - `truncation`: (equations, n) torque that is added to what equations predict [N m or N].
    """

    equations: AbstractEquations
    record: TorqueRecord
    signs: Signs
    weight: Float[np.ndarray, "equations joints"]
    sticking: Sticking | None = None
    truncation: Float[np.ndarray, "equations joints"] | float = 0.0

    def at(self, point: Point) -> EquationPoint:
        """Return what equations need to know of a point."""
        turns, direction = self.signs.turns(point.turn), self.signs.direction
        return EquationPoint(point.k, point.laws, point.q, turns, direction)

    def residuals(self, point: Point) -> Float[np.ndarray, "equations joints"]:
        """Return recorded minus predicted torque."""
        return self._left(self.equations.torque(self.at(point)))

    def derivatives(self, point: Point, scale: Scale) -> "MotionDerivatives":
        """Return derivatives by three positions, the border and moments of reversals."""
        return self.linearised(point, scale)[1]

    def linearised(
        self, point: Point, scale: Scale
    ) -> tuple[Float[np.ndarray, "equations joints"], "MotionDerivatives"]:
        """Return both from one evaluation; without moments of reversals that are at a bound."""
        signs = self.signs
        values = self.equations.linearised(self.at(point))
        by_turn = np.zeros((3, len(signs.samples)))
        for index, offset in enumerate((-1, 0, 1)):
            inside = np.abs(point.turn - offset) < 1.0
            of_turn = values.by_turn[signs.samples - 1 + offset, signs.joints]
            by_turn[index] = np.where(inside, of_turn, 0.0)
        by_border = values.by_coefficient.widened(len(scale)).scaled(scale)
        derivatives = MotionDerivatives(signs, values.by_position, by_border, by_turn)
        return self._left(values.torque), derivatives

    @property
    def bent(self) -> bool:
        """Return whether some equations are bounds."""
        return self.sticking is not None

    def law(self, residuals: Float[np.ndarray, "equations joints"]) -> WorkingReadings:
        """Return the law of equations: of bounds, minus twice their logarithm."""
        if self.sticking is None:
            return super().law(residuals)
        return self.sticking.working(residuals, self.weight)

    def _left(self, predicted: np.ndarray) -> Float[np.ndarray, "equations joints"]:
        return self.record.averaged - np.asarray(predicted) - self.truncation


@dataclasses.dataclass(frozen=True)
class MotionDerivatives(AbstractDerivatives):
    """Derivatives of torque.

    **Attributes**

    - `by_position`: (equations, n, 3 n) by the positions at three samples.
    - `by_border`: by the border, in units of its scale.
    - `by_turn`: (3, reversals) from the equation one sample before a reversal's on.
    """

    signs: Signs
    by_position: Float[np.ndarray, "equations joints positions"]
    by_border: JointColumns
    by_turn: Float[np.ndarray, "rows reversals"]

    def changes(self, step: Step) -> Float[np.ndarray, "equations joints"]:
        """Return changes with positions, the border and moments of reversals."""
        result = equation_changes(self.by_position, self.by_border, step.position, step.border)
        for reversals, rows, joints, derivative in self.turns:
            np.add.at(result, (rows, joints), derivative * step.turn[reversals])
        return result

    def add_gradient(self, force: Float[np.ndarray, "equations joints"], total: Step) -> None:
        """Add the gradient by positions, the border and moments of reversals."""
        position, border = equation_gradients(self.by_position, self.by_border, force)
        total.position[:] += position
        total.border[:] += border
        total.turn[:] += self.turn_gradient(force)

    def turn_gradient(
        self, force: Float[np.ndarray, "equations joints"]
    ) -> Float[np.ndarray, " reversals"]:
        """Return derivatives by moments of reversals."""
        result = np.zeros(self.by_turn.shape[1])
        for reversals, rows, joints, derivative in self.turns:
            result[reversals] += derivative * force[rows, joints]
        return result

    def add_squares(self, weight: Float[np.ndarray, "equations joints"], normal: Normal) -> None:
        """Add squares of all unknowns."""
        result, order = normal.equations, normal.order
        by_border = self.by_border.among(normal.free)
        columns = result.band, result.mixed, order.position
        add_equations(*columns, weight, self.by_position, by_border)
        result.border += by_border.square(weight)
        stencil, size = self.stencil(order), self.by_position.shape[2]
        for reversals, row, joint, slope in self.turns:
            turn = order.turn[reversals][:, None]
            of_turn = weight[row, joint] * slope
            near = self.by_position[row, joint]
            block = np.zeros((len(row), 1 + size, 1 + size))
            block[:, 0, 0] = of_turn * slope
            block[:, 1:, 0] = block[:, 0, 1:] = of_turn[:, None] * near
            result.add(np.concatenate([turn, stencil[row]], axis=1), block)
            result.mixed[turn[:, 0]] += of_turn[:, None] * by_border.rows(row, joint)

    @property
    def turns(self) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """Return equations that a reversal is in, the first of each, then the second, and so on:
        numbers of reversals, equations, joints and derivatives."""
        signs, equations = self.signs, len(self.by_position)
        parts: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]] = []
        for index, derivatives in enumerate(self.by_turn):
            rows = signs.samples - 2 + index
            inside = np.flatnonzero(rows < equations)
            parts.append((inside, rows[inside], signs.joints[inside], derivatives[inside]))
        return parts

    def stencil(self, order: Order) -> Int[np.ndarray, "equations positions"]:
        """Return the positions of each equation among the unknowns in order of time."""
        return stencil(order.position)

    def diagonals(self, order: Order) -> int:
        """Return the diagonals of the band: how far apart unknowns of an equation are, and one."""
        position, stencil = order.position, self.stencil(order)
        apart = [stencil[:, -1] - stencil[:, 0], position[1:, -1] - position[:-1, 0]]
        for reversals, row, _, _ in self.turns:
            turn = order.turn[reversals]
            apart += [np.abs(turn - stencil[row, 0]), np.abs(turn - stencil[row, -1])]
        return 1 + max(int(values.max(initial=0)) for values in apart)


@dataclasses.dataclass(frozen=True)
class RestBlock(ConstantBlock):
    """Joints at rest, which move little from sample to sample."""

    weight: Float[np.ndarray, "intervals joints"]

    def residuals(self, point: Point) -> Float[np.ndarray, "intervals joints"]:
        """Return minus the motion of an interval."""
        return -np.diff(point.q, axis=0)

    def changes(self, step: Step) -> Float[np.ndarray, "intervals joints"]:
        """Return changes with positions."""
        return np.diff(step.position, axis=0)

    def add_gradient(self, force: Float[np.ndarray, "intervals joints"], total: Step) -> None:
        """Add the gradient by positions."""
        total.position[1:] += force
        total.position[:-1] -= force

    def add_squares(self, weight: Float[np.ndarray, "intervals joints"], normal: Normal) -> None:
        """Add squares of the two positions of an interval."""
        index, (row, joint) = normal.order.position, np.nonzero(weight)
        pair = np.stack([index[row, joint], index[row + 1, joint]], axis=1)
        difference = np.array([[1.0, -1.0], [-1.0, 1.0]])
        normal.equations.add(pair, weight[row, joint][:, None, None] * difference)


@dataclasses.dataclass(frozen=True)
class ReversalBlock(ConstantBlock):
    """Moments of reversals, expected where velocity crosses zero; `expected`: (reversals,)."""

    expected: Float[np.ndarray, " reversals"]
    weight: Float[np.ndarray, " reversals"]

    def residuals(self, point: Point) -> Float[np.ndarray, " reversals"]:
        """Return expected minus present moments."""
        return self.expected - point.turn

    def changes(self, step: Step) -> Float[np.ndarray, " reversals"]:
        """Return changes with moments."""
        return step.turn

    def add_gradient(self, force: Float[np.ndarray, " reversals"], total: Step) -> None:
        """Add the gradient by moments."""
        total.turn[:] += force

    def add_squares(self, weight: Float[np.ndarray, " reversals"], normal: Normal) -> None:
        """Add squares of moments."""
        normal.equations.add(normal.order.turn[:, None], weight[:, None, None])


@dataclasses.dataclass(frozen=True)
class PriorBlock(AbstractResidualBlock):
    """Residuals of what is known of the border beforehand; `expected`: (border,) values."""

    expected: Float[np.ndarray, " border"]
    weight: Float[np.ndarray, " border"]

    def residuals(self, point: Point) -> Float[np.ndarray, " border"]:
        """Return expected minus present values."""
        return self.expected - point.border

    def derivatives(self, point: Point, scale: Scale) -> "PriorDerivatives":
        """Return the scale."""
        del point
        return PriorDerivatives(scale)


@dataclasses.dataclass(frozen=True)
class PriorDerivatives(AbstractDerivatives):
    """Derivatives of the border by itself."""

    scale: Scale

    def changes(self, step: Step) -> Float[np.ndarray, " border"]:
        """Return changes with the border."""
        return self.scale * step.border

    def add_gradient(self, force: Float[np.ndarray, " border"], total: Step) -> None:
        """Add the gradient by the border."""
        total.border[:] += self.scale * force

    def add_squares(self, weight: Float[np.ndarray, " border"], normal: Normal) -> None:
        """Add squares of the border."""
        diagonal = np.arange(len(normal.free))
        normal.equations.border[diagonal, diagonal] += (self.scale**2 * weight)[normal.free]
