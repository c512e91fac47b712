import dataclasses
from collections.abc import Iterator
from functools import cached_property

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ....network import CSLC
from ..band import JointColumns
from ._linearisation import Linearisation
from ._motion_code import MotionCode, motion_code
from ._motion_equations import MotionEquations


# Equations that are computed at a time. A function is compiled for a number of equations, which
# takes seconds; for this one it is compiled once for recordings of any length.
_EQUATIONS = 512

Samples = Float[np.ndarray, "samples joints"]
Rows = Float[np.ndarray, "equations joints"]


@dataclasses.dataclass(frozen=True)
class Stretches:
    """Equations of motion of a recording of any length.

    By C code where there is a compiler; else `MotionEquations` in stretches of one length. The last
    one is filled up; what that gives is left out.

    **Attributes**

    - `network`: n joints, p coefficients.
    - `intervals`: (samples - 1,) between samples [s].
    """

    network: CSLC
    intervals: Float[np.ndarray, " intervals"]

    def torque(
        self,
        k: Float[np.ndarray, " coefficients"],
        slopes: Float[np.ndarray, " joints"],
        q: Samples,
        turn: Rows,
        direction: Rows,
    ) -> Rows:
        """As of `MotionEquations`, (equations, n)."""
        if self._code is not None:
            return self._code.torque(self.intervals, k, slopes, q, turn, direction)
        return np.concatenate(
            [
                np.asarray(equations.torque(k, slopes, *motion))[:count]
                for equations, motion, count in self._stretches(q, turn, direction)
            ]
        )

    def linearised(
        self,
        k: Float[np.ndarray, " coefficients"],
        slopes: Float[np.ndarray, " joints"],
        q: Samples,
        turn: Rows,
        direction: Rows,
    ) -> Linearisation:
        """As of `MotionEquations`."""
        if self._code is not None:
            return self._code.linearised(self.intervals, k, slopes, q, turn, direction)
        parts = [
            [np.asarray(values)[:count] for values in equations.linearised(k, slopes, *motion)]
            for equations, motion, count in self._stretches(q, turn, direction)
        ]
        torque, by_position, by_coefficient, by_turn = (
            np.concatenate(values) for values in zip(*parts, strict=True)
        )
        return Linearisation(torque, by_position, JointColumns.of(by_coefficient), by_turn)

    def smooth(
        self, k: Float[np.ndarray, " coefficients"], q: Rows, velocity: Rows, acceleration: Rows
    ) -> Rows:
        """Torque of all terms but friction at instants, (equations, n)."""
        if self._code is not None:
            return self._code.smooth(k, q, velocity, acceleration)
        parts = []
        for start in range(0, len(q), _EQUATIONS):
            motion = [x[start : start + _EQUATIONS] for x in (q, velocity, acceleration)]
            torque = self._equations[0].smooth(k, *(_filled(x, 0, 0.0) for x in motion))
            parts.append(np.asarray(torque)[: len(motion[0])])
        return np.concatenate(parts)

    def friction(
        self,
        k: Float[np.ndarray, " coefficients"],
        slopes: Float[np.ndarray, " joints"],
        q: Samples,
        turn: Rows,
        direction: Rows,
        shift: Rows,
    ) -> Rows:
        """As of `MotionEquations`, (equations, n)."""
        if self._code is not None:
            return self._code.friction(self.intervals, k, slopes, q, turn, direction, shift)
        parts = []
        stretches = self._stretches(q, turn, direction)
        for number, (equations, motion, count) in enumerate(stretches):
            rows = slice(number * _EQUATIONS, (number + 1) * _EQUATIONS)
            torque = equations.friction(k, slopes, *motion, _filled(shift[rows], 0, 0.0))
            parts.append(np.asarray(torque)[:count])
        return np.concatenate(parts)

    @cached_property
    def _code(self) -> MotionCode | None:
        return motion_code(self.network)

    @cached_property
    def _equations(self) -> list[MotionEquations]:
        return [
            MotionEquations(
                self.network,
                jnp.asarray(_filled(self.intervals[start : start + _EQUATIONS + 1], 1, 1.0)),
            )
            for start in range(0, len(self.intervals) - 1, _EQUATIONS)
        ]

    def _stretches(
        self, q: Samples, turn: Rows, direction: Rows
    ) -> Iterator[tuple[MotionEquations, tuple[Samples, Rows, Rows], int]]:
        """Each with its motion, turns and directions, and how many of its equations count."""
        for number, equations in enumerate(self._equations):
            start = number * _EQUATIONS
            rows = slice(start, start + _EQUATIONS)
            motion = (
                _filled(q[start : start + _EQUATIONS + 2], 2, 0.0),
                _filled(turn[rows], 0, -1.0),
                _filled(direction[rows], 0, 1.0),
            )
            yield equations, motion, len(turn[rows])


def _filled(values: np.ndarray, more: int, value: float) -> np.ndarray:
    """As many rows as a stretch has equations, and some more."""
    missing = _EQUATIONS + more - len(values)
    if missing == 0:
        return values
    return np.concatenate([values, np.full((missing, *values.shape[1:]), value)])
