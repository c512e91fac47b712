"""The sum of squares that is minimised, and its Gauss-Newton equations about a point."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import cast

import numpy as np
from jaxtyping import Float

from ._banded_solver import BandedEquations, Factored, Order
from ._blocks import (
    AbstractDerivatives,
    AbstractResidualBlock,
    MotionBlock,
    MotionDerivatives,
    Normal,
    ReadingBlock,
    ReadingDerivatives,
)
from ._laws import WorkingReadings
from ._point import Point, Step
from ._signs import LATEST_TURN


Residuals = Mapping[str, np.ndarray]
"""Residuals, or what else there is one of for each, by block: of `"torque"`, (equations, n),
`"position"`, (samples, n), and of what else an objective has."""


@dataclasses.dataclass(frozen=True)
class Objective:
    """A sum of residual blocks.

    **Attributes**

    - `blocks`: by name; `"torque"`, equations of motion, and `"position"`, readings, among them.
    - `scale`: (border,) size of each unknown of the border; 0 fixes it.
    """

    blocks: Mapping[str, AbstractResidualBlock]
    scale: Float[np.ndarray, " border"]

    @property
    def motion(self) -> MotionBlock:
        """Return equations of motion."""
        return cast(MotionBlock, self.blocks["torque"])

    @property
    def readings(self) -> ReadingBlock:
        """Return readings of joints."""
        return cast(ReadingBlock, self.blocks["position"])

    @property
    def weights(self) -> Residuals:
        """Return weights of all residuals, were they to count by their squares."""
        return {name: block.weight for name, block in self.blocks.items()}

    @property
    def bent(self) -> bool:
        """Return whether some residuals count other than by their squares."""
        return any(block.bent for block in self.blocks.values())

    def with_blocks(self, **blocks: AbstractResidualBlock) -> "Objective":
        """Return the sum with the blocks of the given names replaced."""
        return dataclasses.replace(self, blocks={**self.blocks, **blocks})

    def residuals(self, point: Point) -> Residuals:
        """Return recorded minus predicted, by block."""
        return {name: block.residuals(point) for name, block in self.blocks.items()}

    def laws(self, residuals: Residuals) -> Mapping[str, WorkingReadings]:
        """Return the weighted squares that residuals count as, about these."""
        return {name: block.law(residuals[name]) for name, block in self.blocks.items()}

    def value(self, residuals: Residuals) -> float:
        """Return the sum of squares over variances; of other laws, minus twice the logarithm."""
        return sum(float(np.sum(law.value)) for law in self.laws(residuals).values())

    def moved(self, point: Point, step: Step) -> Point:
        """Return the point after a step."""
        return dataclasses.replace(
            point,
            border=point.border + self.scale * step.border,
            q=point.q + step.position,
            turn=point.turn + step.turn,
        )


# A law that is so far above its parabola is steeper.
_BENT = 0.1


@dataclasses.dataclass(frozen=True)
class Linear:
    """An objective about a point.

    **Attributes**

    - `objective`.
    - `weights`, `residuals`: squares that have the objective's derivatives; those of intervals and
      of joints that stick are not the readings' and the equations' residuals.
    - `present`: the objective's own residuals at the point.
    - `order`: of the unknowns.
    - `derivatives`: by block.
    - `levels`: of laws that are no squares, at the vertices of those that stand for them.
    - `present_value`: the objective's at the point.
    """

    objective: Objective
    weights: Residuals
    residuals: Residuals
    present: Residuals
    order: Order
    derivatives: Mapping[str, AbstractDerivatives]
    levels: Residuals
    present_value: float

    @classmethod
    def of(cls, objective: Objective, point: Point) -> "Linear":
        """Return the Gauss-Newton equations about a point."""
        parts = {
            name: block.linearised(point, objective.scale)
            for name, block in objective.blocks.items()
        }
        residuals = {name: values for name, (values, _) in parts.items()}
        laws = objective.laws(residuals)
        result = cls(
            objective,
            {name: law.weight for name, law in laws.items()},
            {name: law.residual for name, law in laws.items()},
            residuals,
            Order.of(len(point.q), point.q.shape[1], objective.motion.signs.samples),
            {name: derivatives for name, (_, derivatives) in parts.items()},
            {name: law.levels for name, law in laws.items() if objective.blocks[name].bent},
            sum(float(np.sum(law.value)) for law in laws.values()),
        )
        return result._within_bounds(point.turn)

    @property
    def motion(self) -> MotionDerivatives:
        """Return derivatives of equations of motion."""
        return cast(MotionDerivatives, self.derivatives["torque"])

    @property
    def readings(self) -> ReadingDerivatives:
        """Return derivatives of readings."""
        return cast(ReadingDerivatives, self.derivatives["position"])

    def with_motion(self, motion: MotionDerivatives) -> "Linear":
        """Return it with other derivatives of equations of motion."""
        return dataclasses.replace(self, derivatives={**self.derivatives, "torque": motion})

    def factored(self, damping: float) -> Factored:
        """Return the normal equations, damped and factorised.

        **Raises** `numpy.linalg.LinAlgError` if rounding has made them indefinite.
        """
        order, scale = self.order, self.objective.scale
        # Where all are fixed, a column of zeros remains.
        free = np.flatnonzero(scale) if scale.any() else np.zeros(1, int)
        # Columns of the same joints side by side: whole registers of zeros are left out.
        free = free[np.argsort(self.motion.by_border.patterns[free], kind="stable")]
        column = np.zeros(len(scale), int)  # whatever for fixed ones, whose scale is 0
        column[free] = np.arange(len(free))
        equations = BandedEquations(order.size, len(free), self.motion.diagonals(order))
        normal = Normal(equations, order, free, column)
        for name, derivatives in self.derivatives.items():
            derivatives.add_squares(self.weights[name], normal)
        diagonal = np.zeros(order.size)
        readings = self.objective.weights["position"]
        diagonal[order.position[:, : readings.shape[1]]] = readings
        diagonal[order.turn] = self.weights["turn"]
        return equations.factored(damping * diagonal, free, len(scale))

    def step(self, factored: Factored, residuals: Residuals, damping: float = 0.0) -> Step:
        """Return the change of all unknowns that fits residuals best.

        - `factored`: the normal equations.
        - `residuals`: those of the present point, or others.
        - `damping`: of the border, as a part of its information.
        """
        return self.steps(factored, [residuals], damping)[0]

    def steps(
        self, factored: Factored, residuals: Sequence[Residuals], damping: float = 0.0
    ) -> list[Step]:
        """Return `step` for several residuals, which takes less time than one by one."""
        order, gradients = self.order, [self._gradient(values) for values in residuals]
        inner = np.zeros((order.size, len(gradients)))
        for number, gradient in enumerate(gradients):
            inner[order.position, number] = gradient.position
            inner[order.turn, number] = gradient.turn
        border = np.stack([gradient.border for gradient in gradients], axis=1)
        inner, border = factored.step(inner, border, damping)
        return [
            Step(of_border, of_inner[order.position], of_inner[order.turn])
            for of_inner, of_border in zip(inner.T, border.T, strict=True)
        ]

    def about(self, residuals: Residuals) -> "Linear":
        """Return it with parabolas of laws at other residuals, where these are above the present.

        A count is flat inside its interval and steep outside, and so is the bound of a joint that
        sticks: a step that knows the flat part alone goes far out.

        - `residuals`: the objective's, at a step's end.
        """
        weights, vertices, levels = dict(self.weights), dict(self.residuals), dict(self.levels)
        for name, level in self.levels.items():
            # Vertices are kept as residuals about the present ones.
            change = residuals[name] - self.present[name]
            weight, vertex = weights[name], vertices[name]
            end = self.objective.blocks[name].law(residuals[name])
            bent = end.value > level + weight * (vertex + change) ** 2 + _BENT
            weights[name] = np.where(bent, end.weight, weight)
            vertices[name] = np.where(bent, end.residual - change, vertex)
            levels[name] = np.where(bent, end.levels, level)
        return dataclasses.replace(self, weights=weights, residuals=vertices, levels=levels)

    def value(self, residuals: Residuals) -> float:
        """Return the sum of squares at other residuals of the objective's, by these parabolas."""
        total = 0.0
        for name, values in residuals.items():
            level = self.levels.get(name)
            vertex = 0.0 if level is None else self.present[name] - self.residuals[name]
            squares = self.weights[name] * (values - vertex) ** 2
            total += float(np.sum(squares if level is None else level + squares))
        return total

    def promise(self, step: Step) -> float:
        """Return how much the sum of squares would fall in a step, were all equations linear."""
        gradient = self._gradient(self.residuals)
        return float(
            gradient.border @ step.border
            + np.sum(gradient.position * step.position)
            + gradient.turn @ step.turn
        )

    def after(self, step: Step, residuals: Residuals) -> Residuals:
        """Return the residuals that a step leaves, were all equations linear."""
        return {
            name: residuals[name] - derivatives.changes(step)
            for name, derivatives in self.derivatives.items()
        }

    def zeros(self, **residuals: np.ndarray) -> Residuals:
        """Return residuals of some blocks; those of all others are 0."""
        return {name: residuals.get(name, 0.0 * values) for name, values in self.present.items()}

    def _gradient(self, residuals: Residuals) -> Step:
        total = Step(
            np.zeros(len(self.objective.scale)),
            np.zeros(self.order.position.shape),
            np.zeros(len(self.order.turn)),
        )
        for name, derivatives in self.derivatives.items():
            derivatives.add_gradient(self.weights[name] * residuals[name], total)
        return total

    def _within_bounds(self, turn: Float[np.ndarray, " reversals"]) -> "Linear":
        """Return the same without moments of reversals that are at a bound and would go beyond it.

        What linear equations promise of such a step does not come, and a search that waits for it
        does not end.
        """
        weights, residuals = self.weights, self.residuals
        gradient = self.motion.turn_gradient(weights["torque"] * residuals["torque"])
        outwards = (gradient + weights["turn"] * residuals["turn"]) * turn > 0.0
        fixed = outwards & (np.abs(turn) >= LATEST_TURN)
        if not fixed.any():
            return self
        by_turn = np.where(fixed, 0.0, self.motion.by_turn)
        result = self.with_motion(dataclasses.replace(self.motion, by_turn=by_turn))
        of_turn = np.where(fixed, 0.0, residuals["turn"])
        return dataclasses.replace(result, residuals={**residuals, "turn": of_turn})
