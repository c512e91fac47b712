"""The sum of squares that is minimised, for fixed signs and noise levels."""

import dataclasses
from collections.abc import Mapping
from typing import cast

import numpy as np
from jaxtyping import Float

from ._blocks import AbstractResidualBlock, MotionBlock, ReadingBlock
from ._point import Point, Step
from ._readings import WorkingReadings


Residuals = Mapping[str, np.ndarray]
"""Residuals, or what else there is one of for each, by block: of `"torque"`, (equations, series),
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
        """Return the sum with other blocks of these names."""
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
