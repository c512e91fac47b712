import dataclasses

import numpy as np
from jaxtyping import Float, Int

from ._band import BandedEquations, Factored, Order
from ._objective import Objective, Point, Residuals, Step


@dataclasses.dataclass(frozen=True)
class Linear:
    """An objective about a point: residuals, and their derivatives by all unknowns.

    **Attributes**

    - `objective`.
    - `weights`, `residuals`: squares that have the objective's derivatives; those of intervals are
      not the readings' residuals.
    - `order`: of the unknowns.
    - `by_position`: (equations, n, 3 n) of torque, by the positions at three samples.
    - `by_border`: (equations, n, border) of torque, in units of the border's scale.
    - `by_turn`: (3, reversals) of the torque one sample before a reversal's, at it and after it.
    """

    objective: Objective
    weights: Residuals
    residuals: Residuals
    order: Order
    by_position: Float[np.ndarray, "equations joints positions"]
    by_border: Float[np.ndarray, "equations joints border"]
    by_turn: Float[np.ndarray, "three reversals"]

    @classmethod
    def of(cls, objective: Objective, point: Point) -> "Linear":
        """The Gauss-Newton equations about a point."""
        signs, scale = objective.signs, objective.scale
        samples, n = point.q.shape
        derivatives = objective.equations.linearised(
            point.k, point.slopes, point.q, signs.turns(point.turn), signs.direction
        )
        gain = objective.torque.gain(point.calibration)
        predicted = np.asarray(derivatives.torque)
        of_coefficients = np.asarray(derivatives.by_coefficient) / gain[:, None]
        of_calibration = objective.torque.by_values(point.calibration, predicted / gain)
        first = of_coefficients.shape[2]
        last = first + of_calibration.shape[2]
        by_border = np.zeros((samples - 2, n, len(scale)))
        by_border[:, :, :first] = of_coefficients * scale[:first]
        by_border[:, :, first:last] = of_calibration * scale[first:last]
        all_by_turn = np.asarray(derivatives.by_turn) / gain
        by_turn = np.zeros((3, len(signs.samples)))
        for index, offset in enumerate((-1, 0, 1)):
            inside = np.abs(point.turn - offset) < 1.0
            of_turn = all_by_turn[signs.samples - 1 + offset, signs.joints]
            by_turn[index] = np.where(inside, of_turn, 0.0)
        residuals = objective.residuals_of(point, predicted)
        readings = objective.readings(residuals)
        return cls(
            objective,
            dataclasses.replace(objective.weights, position=readings.weight),
            dataclasses.replace(residuals, position=readings.residual),
            Order.of(samples, n, signs.samples),
            np.asarray(derivatives.by_position) / gain[:, None],
            by_border,
            by_turn,
        )

    def factored(self, damping: float) -> Factored:
        """The normal equations, damped and factorised.

        **Raises** `numpy.linalg.LinAlgError` if rounding has made them indefinite.
        """
        weights, order = self.weights, self.order
        scale = self.objective.scale
        samples, n = weights.position.shape
        result = BandedEquations(order.size, len(scale))
        heavy = np.swapaxes(self.by_position * weights.torque[:, :, None], 1, 2)
        result.add(self._stencil, heavy @ self.by_position)
        mixed = heavy @ self.by_border
        of_sample = np.zeros((samples, n, len(scale)))
        for i in range(3):
            of_sample[i : samples - 2 + i] += mixed[:, i * n : (i + 1) * n]
        result.mixed[order.position] = of_sample
        flat = self.by_border.reshape(-1, len(scale))
        result.border += flat.T @ (flat * weights.torque.reshape(-1, 1))
        result.border += np.diag(scale**2 * weights.border)

        index = order.position
        result.add(index.reshape(-1, 1), weights.position.reshape(-1, 1, 1))
        offset = self.offset
        result.mixed[index, offset] += weights.position * scale[offset]
        np.add.at(result.border, (offset, offset), weights.position * scale[offset] ** 2)
        row, joint = np.nonzero(weights.standstill)
        pair = np.stack([index[row, joint], index[row + 1, joint]], axis=1)
        difference = np.array([[1.0, -1.0], [-1.0, 1.0]])
        result.add(pair, weights.standstill[row, joint][:, None, None] * difference)
        self._add_turns(result)

        diagonal = np.zeros(order.size)
        diagonal[order.position] = self.objective.weights.position
        diagonal[order.turn] = weights.turn
        return result.factored(damping * diagonal)

    def step(self, factored: Factored, residuals: Residuals, damping: float = 0.0) -> Step:
        """The change of all unknowns that fits residuals best.

        **Arguments**

        - `factored`: the normal equations.
        - `residuals`: those of the present point, or others.
        - `damping`: of the border, as a part of its information.
        """
        inner, border = factored.step(*self._gradient(residuals), damping)
        return Step(border, inner[self.order.position], inner[self.order.turn])

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
        moved = step.position.ravel()[self._positions]
        torque = np.einsum("ijk,ik->ij", self.by_position, moved) + self.by_border @ step.border
        signs = objective.signs
        for index, offset in enumerate((-1, 0, 1)):
            rows = signs.samples - 1 + offset
            np.add.at(torque, (rows, signs.joints), self.by_turn[index] * step.turn)
        change = objective.scale * step.border
        return Residuals(
            residuals.torque - torque,
            residuals.position - step.position - change[self.offset],
            residuals.standstill - np.diff(step.position, axis=0),
            residuals.turn - step.turn,
            residuals.border - change,
        )

    @property
    def offset(self) -> Int[np.ndarray, "samples joints"]:
        """(samples, n): where the offset of each reading is in the border."""
        n, part = self.order.position.shape[1], self.objective.part
        first = len(self.objective.scale) - n * (int(part[-1]) + 1)
        return first + n * part[:, None] + np.arange(n)

    @property
    def _stencil(self) -> Int[np.ndarray, "equations positions"]:
        """The unknowns of each equation: the positions at three samples."""
        position = self.order.position
        return np.concatenate([position[:-2], position[1:-1], position[2:]], axis=1)

    @property
    def _positions(self) -> Int[np.ndarray, "equations positions"]:
        """The same, counted among positions alone."""
        samples, n = self.order.position.shape
        index = np.arange(samples * n).reshape(samples, n)
        return np.concatenate([index[:-2], index[1:-1], index[2:]], axis=1)

    def _gradient(
        self, residuals: Residuals
    ) -> tuple[Float[np.ndarray, " inner"], Float[np.ndarray, " border"]]:
        objective, order = self.objective, self.order
        weights, scale, signs = self.weights, objective.scale, objective.signs
        samples, n = weights.position.shape
        inner = np.zeros(order.size)
        force = weights.torque * residuals.torque
        by_position = np.einsum("ijk,ij->ik", self.by_position, force)
        for i in range(3):
            inner[order.position[i : samples - 2 + i]] += by_position[:, i * n : (i + 1) * n]
        reading = weights.position * residuals.position
        inner[order.position] += reading
        standstill = weights.standstill * residuals.standstill
        inner[order.position[1:]] += standstill
        inner[order.position[:-1]] -= standstill
        inner[order.turn] += weights.turn * residuals.turn
        for index, offset in enumerate((-1, 0, 1)):
            rows = signs.samples - 1 + offset
            inner[order.turn] += self.by_turn[index] * force[rows, signs.joints]
        border = np.einsum("ijk,ij->k", self.by_border, force)
        np.add.at(border, self.offset, reading * scale[self.offset])
        border += scale * weights.border * residuals.border
        return inner, border

    def _add_turns(self, result: BandedEquations) -> None:
        signs, order = self.objective.signs, self.order
        torque = self.weights.torque
        n = order.position.shape[1]
        turn = order.turn[:, None]
        result.add(turn, self.weights.turn[:, None, None])
        for index, offset in enumerate((-1, 0, 1)):
            row, slope = signs.samples - 1 + offset, self.by_turn[index]
            weight = torque[row, signs.joints] * slope
            near = self.by_position[row, signs.joints]
            block = np.zeros((len(row), 1 + 3 * n, 1 + 3 * n))
            block[:, 0, 0] = weight * slope
            block[:, 1:, 0] = block[:, 0, 1:] = weight[:, None] * near
            result.add(np.concatenate([turn, self._stencil[row]], axis=1), block)
            result.mixed[order.turn] += weight[:, None] * self.by_border[row, signs.joints]
