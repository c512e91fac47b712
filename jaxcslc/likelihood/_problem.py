"""What a search needs to know: equations, readings, and what is known beforehand."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ._blocks import AbstractResidualBlock
from ._equations import AbstractEquations
from ._point import Point, UnknownLayout
from ._readings import Readings
from ._signs import LATEST_TURN, runs


# No torque noise is below this part of the torque, where errors of second differences are: 1e-6 to
# 2e-5 of the joints of a simulated arm at 500 Hz.
_LEAST_TORQUE_NOISE = 3e-6
# How far the logarithm of a slope moves in a step.
_SLOPE_STEP = 0.7

Values = Float[np.ndarray, " values"]


class SearchStart(NamedTuple):
    """Start of a search.

    - `point`: all unknowns.
    - `torque_noise`, `position_noise`: (recordings, n) standard deviations.
    """

    point: Point
    torque_noise: Float[np.ndarray, "recordings joints"]
    position_noise: Float[np.ndarray, "recordings joints"]


@dataclasses.dataclass(frozen=True)
class LikelihoodProblem:
    """Problem of maximum likelihood that a search solves.

    **Attributes**

    - `equations`: torque as a function of positions.
    - `readings`: of one recording or of several.
    - `stuck`: (intervals, n), where joints are at standstill.
    - `layout`, `scale`: (border,) of the unknowns that all equations share; 0 fixes one.
    - `known`: from a point, and from one whose dry friction counts, mean and inverse variance,
      (border,) each, of what is known of these beforehand.
    - `bounds`: least and greatest values of parts of the border, by name.
    - `breakaway`: from a point, (n,) the greatest friction at standstill, as it is recorded.
    - `encoder_step`: (recordings, n) [rad or m]; 0 where positions are not counts.
    - `least_position_noise`: (recordings, n) [rad or m]; of counts, that of their steps.
    - `scatter`: (recordings, n) of readings about smooth motion [rad or m]; 0 of counts.
    - `added`: blocks beside those that every problem has, by name.
    """

    equations: AbstractEquations
    readings: Readings
    stuck: Bool[np.ndarray, "intervals joints"]
    layout: UnknownLayout
    scale: Float[np.ndarray, " border"]
    known: Callable[
        [Point, Point], tuple[Float[np.ndarray, " border"], Float[np.ndarray, " border"]]
    ]
    bounds: Mapping[str, tuple[Float[np.ndarray, " values"], Float[np.ndarray, " values"]]]
    breakaway: Callable[[Point], Float[np.ndarray, " joints"]]
    encoder_step: Float[np.ndarray, "recordings joints"]
    least_position_noise: Float[np.ndarray, "recordings joints"]
    scatter: Float[np.ndarray, "recordings joints"]
    added: Mapping[str, AbstractResidualBlock] = dataclasses.field(default_factory=dict)

    @property
    def joints(self) -> int:
        """n: positions of what else moves are not read."""
        return self.stuck.shape[1]

    def bounded(self, point: Point, before: Point) -> Point:
        """Return a point within bounds, whose slopes and reversals are no further than a step may
        go."""
        near = np.clip(point.slopes, before.slopes - _SLOPE_STEP, before.slopes + _SLOPE_STEP)
        values = {"slopes": near}
        for name, (low, high) in self.bounds.items():
            values[name] = np.clip(values.get(name, point.values(name)), low, high)
        turn = np.clip(point.turn, -LATEST_TURN, LATEST_TURN)
        return dataclasses.replace(point.with_values(**values), turn=turn)

    def fixing(self, *names: str) -> "LikelihoodProblem":
        """Fix parts of the border."""
        scale = self.scale.copy()
        for name in names:
            scale[self.layout.part(name)] = 0.0
        return dataclasses.replace(self, scale=scale)

    def with_unknowns(
        self, name: str, scale: Values, mean: Values, precision: Values, low: Values
    ) -> "LikelihoodProblem":
        """Add the unknowns of an added block to the border.

        **Arguments**

        - `scale`: sizes; `mean`, `precision`: what is known of them beforehand; `low`: bounds.
        """
        layout = self.layout.with_part(name, len(scale))

        def known(point: Point, of_dry: Point) -> tuple[np.ndarray, np.ndarray]:
            means, precisions = self.known(point, of_dry)
            return layout.inserted(means, name, mean), layout.inserted(precisions, name, precision)

        return dataclasses.replace(
            self,
            layout=layout,
            scale=layout.inserted(self.scale, name, scale),
            known=known,
            bounds={**self.bounds, name: (low, np.full(len(low), np.inf))},
        )

    @property
    def at_rest(self) -> Bool[np.ndarray, "equations joints"]:
        """Equations of joints at standstill."""
        return self.stuck[1:] | self.stuck[:-1]

    @property
    def moving(self) -> Bool[np.ndarray, "samples joints"]:
        """Readings of joints that are not."""
        return ~np.concatenate([self.stuck, np.zeros_like(self.stuck[:1])])

    @property
    def reading_shares(self) -> Float[np.ndarray, "samples joints"]:
        """The readings of a rest are one reading, for they have one error."""
        shares = np.ones((len(self.stuck) + 1, self.stuck.shape[1]))
        for joint in range(self.stuck.shape[1]):
            for start, end in runs(self.stuck[:, joint]):
                shares[start : end + 1, joint] = 1.0 / (end + 1 - start)
        return shares

    @property
    def least_torque_noise(self) -> Float[np.ndarray, " joints"]:
        """(n,) [N m or N]."""
        size = np.sqrt(np.mean(self.readings.torque.averaged**2, axis=0))
        return np.maximum(_LEAST_TORQUE_NOISE * size, 1e-9)
