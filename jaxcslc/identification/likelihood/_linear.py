import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int

from ._objective import Objective, Point, Residuals, Step
from ._signs import LATEST_TURN
from .band import (
    BandedEquations,
    Factored,
    JointColumns,
    Order,
    add_equations,
    equation_changes,
    equation_gradients,
)


# A law that is so far above its parabola is steeper.
_BENT = 0.1


@dataclasses.dataclass(frozen=True)
class Linear:
    """An objective about a point: residuals, and their derivatives by all unknowns.

    **Attributes**

    - `objective`.
    - `weights`, `residuals`: squares that have the objective's derivatives; those of intervals and
      of joints that stick are not the readings' and the equations' residuals.
    - `present`: the objective's own residuals at the point.
    - `order`: of the unknowns.
    - `by_position`: (equations, n, 3 n) of torque, by the positions at three samples.
    - `by_border`: of the same by the border, in units of its scale.
    - `by_turn`: (3, reversals) of the same from one sample before a reversal's on.
    - `levels`: of laws of readings and of equations, at the vertices of these squares.
    - `present_value`: the objective's at the point.
    """

    objective: Objective
    weights: Residuals
    residuals: Residuals
    present: Residuals
    order: Order
    by_position: Float[np.ndarray, "equations joints positions"]
    by_border: JointColumns
    by_turn: Float[np.ndarray, "rows reversals"]
    levels: Mapping[str, Float[np.ndarray, "_ joints"]]
    present_value: float

    @classmethod
    def of(cls, objective: Objective, point: Point) -> "Linear":
        """The Gauss-Newton equations about a point."""
        signs, scale = objective.signs, objective.scale
        samples, n = point.q.shape
        derivatives = objective.equations.linearised(
            point.k, point.laws, point.q, signs.turns(point.turn), signs.direction
        )
        by_border = derivatives.by_coefficient.widened(len(scale)).scaled(scale)
        by_turn = np.zeros((3, len(signs.samples)))
        for index, offset in enumerate((-1, 0, 1)):
            inside = np.abs(point.turn - offset) < 1.0
            of_turn = derivatives.by_turn[signs.samples - 1 + offset, signs.joints]
            by_turn[index] = np.where(inside, of_turn, 0.0)
        residuals = objective.residuals_of(point, derivatives.torque)
        readings, torques = objective.readings(residuals), objective.torques(residuals)
        result = cls(
            objective,
            dataclasses.replace(objective.weights, position=readings.weight, torque=torques.weight),
            dataclasses.replace(residuals, position=readings.residual, torque=torques.residual),
            residuals,
            Order.of(samples, n, signs.samples),
            derivatives.by_position,
            by_border,
            by_turn,
            {"position": readings.levels, "torque": torques.levels},
            objective.total(residuals, torques, readings),
        )
        return result._within_bounds(point.turn)

    def factored(self, damping: float) -> Factored:
        """The normal equations, damped and factorised.

        **Raises** `numpy.linalg.LinAlgError` if rounding has made them indefinite.
        """
        weights, order = self.weights, self.order
        scale = self.objective.scale
        # Where all are fixed, a column of zeros remains.
        free = np.flatnonzero(scale) if scale.any() else np.zeros(1, int)
        # Columns of the same joints side by side: whole registers of zeros are left out.
        free = free[np.argsort(self.by_border.patterns[free], kind="stable")]
        by_border = self.by_border.among(free)
        result = BandedEquations(order.size, len(free), self._diagonals)
        add_equations(
            result.band,
            result.mixed,
            order.position,
            weights.torque,
            self.by_position,
            by_border,
        )
        result.border += by_border.square(weights.torque)
        result.border += np.diag((scale**2 * weights.border)[free])

        index = order.position
        result.band[index, 0] += weights.position
        offset = self.offset
        column = np.zeros(len(scale), int)  # whatever for fixed ones, whose scale is 0
        column[free] = np.arange(len(free))
        result.mixed[index, column[offset]] += weights.position * scale[offset]
        of_offsets = np.arange(self.first_offset, len(scale))
        squares = self._of_offsets(weights.position) * scale[of_offsets] ** 2
        np.add.at(result.border, (column[of_offsets], column[of_offsets]), squares)
        row, joint = np.nonzero(weights.standstill)
        pair = np.stack([index[row, joint], index[row + 1, joint]], axis=1)
        difference = np.array([[1.0, -1.0], [-1.0, 1.0]])
        result.add(pair, weights.standstill[row, joint][:, None, None] * difference)
        self._add_turns(result, by_border)

        diagonal = np.zeros(order.size)
        diagonal[order.position] = self.objective.weights.position
        diagonal[order.turn] = weights.turn
        return result.factored(damping * diagonal, free, len(scale))

    def step(self, factored: Factored, residuals: Residuals, damping: float = 0.0) -> Step:
        """The change of all unknowns that fits residuals best.

        **Arguments**

        - `factored`: the normal equations.
        - `residuals`: those of the present point, or others.
        - `damping`: of the border, as a part of its information.
        """
        return self.steps(factored, [residuals], damping)[0]

    def steps(
        self, factored: Factored, residuals: Sequence[Residuals], damping: float = 0.0
    ) -> list[Step]:
        """`step` for several residuals, which takes less time than one by one."""
        gradients = [self._gradient(values) for values in residuals]
        inner, border = (np.stack(sides, axis=1) for sides in zip(*gradients, strict=True))
        inner, border = factored.step(inner, border, damping)
        return [
            Step(of_border, of_inner[self.order.position], of_inner[self.order.turn])
            for of_inner, of_border in zip(inner.T, border.T, strict=True)
        ]

    def about(self, residuals: Residuals) -> "Linear":
        """With the parabolas of laws at other residuals, where they are above the present ones.

        A count is flat inside its interval and steep outside, and so is the bound of a joint that
        sticks: a step that knows the flat part alone goes far out.

        **Arguments**

        - `residuals`: the objective's, at a step's end.
        """
        objective = self.objective
        weights, vertices, levels = {}, {}, {}
        for name, law in (("position", objective.readings), ("torque", objective.torques)):
            # Vertices are kept as residuals about the present ones.
            change = getattr(residuals, name) - getattr(self.present, name)
            weight, vertex = getattr(self.weights, name), getattr(self.residuals, name)
            end, level = law(residuals), self.levels[name]
            bent = end.value > level + weight * (vertex + change) ** 2 + _BENT
            weights[name] = np.where(bent, end.weight, weight)
            vertices[name] = np.where(bent, end.residual - change, vertex)
            levels[name] = np.where(bent, end.levels, level)
        return dataclasses.replace(
            self,
            weights=dataclasses.replace(self.weights, **weights),
            residuals=dataclasses.replace(self.residuals, **vertices),
            levels=levels,
        )

    def value(self, residuals: Residuals) -> float:
        """The sum of squares at other residuals of the objective's, by these parabolas."""
        total = self.objective.squares(residuals)
        for name, level in self.levels.items():
            vertex = getattr(self.present, name) - getattr(self.residuals, name)
            squares = (getattr(residuals, name) - vertex) ** 2
            total += float(np.sum(level + getattr(self.weights, name) * squares))
        return total

    def promise(self, step: Step) -> float:
        """How much the sum of squares would fall in a step, were all equations linear."""
        inner, border = self._gradient(self.residuals)
        order = self.order
        return float(
            border @ step.border
            + np.sum(inner[order.position] * step.position)
            + inner[order.turn] @ step.turn
        )

    def after(self, step: Step, residuals: Residuals) -> Residuals:
        """The residuals that a step leaves, were all equations linear."""
        objective = self.objective
        torque = equation_changes(self.by_position, self.by_border, step.position, step.border)
        for reversals, rows, joints, derivative in self.turn_parts:
            np.add.at(torque, (rows, joints), derivative * step.turn[reversals])
        change = objective.scale * step.border
        return Residuals(
            residuals.torque - torque,
            residuals.position - step.position - change[self.offset],
            residuals.standstill - np.diff(step.position, axis=0),
            residuals.turn - step.turn,
            residuals.border - change,
        )

    @property
    def first_offset(self) -> int:
        """Where offsets of readings begin in the border."""
        n, part = self.order.position.shape[1], self.objective.part
        return len(self.objective.scale) - n * (int(part[-1]) + 1)

    @property
    def offset(self) -> Int[np.ndarray, "samples joints"]:
        """(samples, n): where the offset of each reading is in the border."""
        n, part = self.order.position.shape[1], self.objective.part
        return self.first_offset + n * part[:, None] + np.arange(n)

    def _of_offsets(self, readings: Float[np.ndarray, "samples joints"]) -> np.ndarray:
        """Sums over the readings of each offset, one recording after the other."""
        part = self.objective.part
        firsts = np.flatnonzero(np.diff(part, prepend=-1))
        return np.add.reduceat(readings, firsts, axis=0).ravel()

    @property
    def turn_parts(self) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """Equations that a reversal is in, the first of each reversal, then the second, and so on:
        numbers of reversals, equations, joints and derivatives."""
        signs, equations = self.objective.signs, len(self.by_position)
        parts: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]] = []
        for index, derivatives in enumerate(self.by_turn):
            rows = signs.samples - 2 + index
            inside = np.flatnonzero(rows < equations)
            parts.append((inside, rows[inside], signs.joints[inside], derivatives[inside]))
        return parts

    @property
    def _stencil(self) -> Int[np.ndarray, "equations positions"]:
        """The unknowns of each equation."""
        position = self.order.position
        return np.concatenate([position[:-2], position[1:-1], position[2:]], axis=1)

    def _gradient(
        self, residuals: Residuals
    ) -> tuple[Float[np.ndarray, " inner"], Float[np.ndarray, " border"]]:
        objective, order = self.objective, self.order
        weights, scale = self.weights, objective.scale
        force = weights.torque * residuals.torque
        of_positions, border = equation_gradients(self.by_position, self.by_border, force)
        reading = weights.position * residuals.position
        of_positions += reading
        standstill = weights.standstill * residuals.standstill
        of_positions[1:] += standstill
        of_positions[:-1] -= standstill
        inner = np.zeros(order.size)
        inner[order.position] = of_positions
        inner[order.turn] += self._turn_gradient(residuals, force)
        border[self.first_offset :] += scale[self.first_offset :] * self._of_offsets(reading)
        border += scale * weights.border * residuals.border
        return inner, border

    def _turn_gradient(
        self, residuals: Residuals, force: Float[np.ndarray, "equations joints"]
    ) -> Float[np.ndarray, " reversals"]:
        """By the moments of reversals; `force`: weights times residuals of torque."""
        result = self.weights.turn * residuals.turn
        for reversals, rows, joints, derivative in self.turn_parts:
            result[reversals] += derivative * force[rows, joints]
        return result

    def _within_bounds(self, turn: Float[np.ndarray, " reversals"]) -> "Linear":
        """The same without moments of reversals that are at a bound and would go beyond it.

        What linear equations promise of such a step does not come, and a search that waits for it
        does not end.
        """
        force = self.weights.torque * self.residuals.torque
        outwards = self._turn_gradient(self.residuals, force) * turn > 0.0
        fixed = outwards & (np.abs(turn) >= LATEST_TURN)
        if not fixed.any():
            return self
        of_turn = np.where(fixed, 0.0, self.residuals.turn)
        return dataclasses.replace(
            self,
            residuals=dataclasses.replace(self.residuals, turn=of_turn),
            by_turn=np.where(fixed, 0.0, self.by_turn),
        )

    @property
    def _diagonals(self) -> int:
        """Of the band: how far apart in order of time unknowns of one equation are, and one."""
        position, stencil = self.order.position, self._stencil
        apart = [stencil[:, -1] - stencil[:, 0], position[1:, -1] - position[:-1, 0]]
        for reversals, row, _, _ in self.turn_parts:
            turn = self.order.turn[reversals]
            apart += [np.abs(turn - stencil[row, 0]), np.abs(turn - stencil[row, -1])]
        return 1 + max(int(values.max(initial=0)) for values in apart)

    def _add_turns(self, result: BandedEquations, by_border: JointColumns) -> None:
        order, torque, stencil = self.order, self.weights.torque, self._stencil
        size = self.by_position.shape[2]
        result.add(order.turn[:, None], self.weights.turn[:, None, None])
        for reversals, row, joint, slope in self.turn_parts:
            turn = order.turn[reversals][:, None]
            weight = torque[row, joint] * slope
            near = self.by_position[row, joint]
            block = np.zeros((len(row), 1 + size, 1 + size))
            block[:, 0, 0] = weight * slope
            block[:, 1:, 0] = block[:, 0, 1:] = weight[:, None] * near
            result.add(np.concatenate([turn, stencil[row]], axis=1), block)
            result.mixed[order.turn[reversals]] += weight[:, None] * by_border.rows(row, joint)
