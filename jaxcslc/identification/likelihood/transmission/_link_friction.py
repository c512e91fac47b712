import dataclasses
from collections.abc import Iterator
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ....network import CSLC
from ....network.terms import HOST_FUNCTIONS, JointTerm, StaticFriction
from ._gears import Stencil


# Kinds that are no friction: a constant torque of a motor or of its sensor.
_OF_MOTORS = ("offset",)
# Where speeds change by less than this part of their size, a smoothed sign's mean is of instants.
_SMALL = 0.05
# Steps of speeds [rad/s or m/s] and of logarithms of slopes in central differences.
_RATE, _SLOPE = 1e-7, 1e-5
# Gauss-Legendre nodes and weights on (0, 1).
_NODES, _WEIGHTS = (np.polynomial.legendre.leggauss(4)[i] / 2 + (0.5, 0.0)[i] for i in (0, 1))

Series = Float[np.ndarray, "samples links"]
Rows = Float[np.ndarray, "equations links"]


class LinkInput(NamedTuple):
    """What a coefficient of friction is multiplied by on a link, averaged with a triangle.

    **Attributes**

    - `coefficient`: its index; `link`: which of the links that move apart, from 0.
    - `dry`: whether it jumps where the link turns.
    - `value`: (equations,).
    - `by_position`: (3, equations) by the link's position at three samples.
    - `by_slope`: (equations,) by the logarithm of the joint's slope of static friction.
    """

    coefficient: int
    link: int
    dry: bool
    value: Float[np.ndarray, " equations"]
    by_position: Float[np.ndarray, "3 equations"]
    by_slope: Float[np.ndarray, " equations"]


@dataclasses.dataclass(frozen=True)
class LinkFriction:
    """Friction of links, whose motion nothing reads: smooth where they turn or stick.

    Where a link turns cannot be read from an encoder, and one that hangs on compliant gears sticks
    while its rotor moves. So its friction is a function of speed that goes from one direction to
    the other within about `speed`: one that sticks creeps by less.

    **Attributes**

    - `network`: n joints; `joints`: (f,) which links move apart, from 0.
    - `stencil`: of the samples; `intervals`: (samples - 1,) [s].
    - `speed`: (f,) [rad/s or m/s].
    """

    network: CSLC
    joints: Int[np.ndarray, " links"]
    stencil: Stencil
    intervals: Float[np.ndarray, " intervals"]
    speed: Float[np.ndarray, " links"]

    @cached_property
    def laws(self) -> tuple[tuple[int, int, bool, Any, int], ...]:
        """Of each coefficient: its index, link, whether it is dry friction's, law and input."""
        return tuple(self._laws())

    def _laws(self) -> Iterator[tuple[int, int, bool, Any, int]]:
        for term in self.network.terms:
            if not isinstance(term, JointTerm) or term.kind in _OF_MOTORS:
                continue
            if term.law.properties.part != "friction":
                continue
            first = self.network.layout.indices(term.kind).reshape(-1, len(term.joints))
            for link, joint in enumerate(self.joints):
                if joint not in term.joints:
                    continue
                for number, indices in enumerate(first):
                    above, below = self._limits(term.law, number)
                    index = int(indices[term.joints.index(joint)])
                    yield index, link, above != below, term.law, number

    def inputs(
        self, slopes: Float[np.ndarray, " joints"], link: Series, *, derivatives: bool
    ) -> list[LinkInput]:
        """Of all coefficients of friction of these joints, at (samples, f) positions of links.

        **Arguments**

        - `slopes`: (n,) logarithms of static friction's.
        - `derivatives`: whether they are computed; zeros if not.
        """
        result: list[LinkInput] = []
        for index, number, dry, law, position in self.laws:
            motion = _Motion.of(link[:, number], self.intervals, self.speed[number])
            joint = int(self.joints[number])
            value, by_speed, by_change = self._mean(law, position, slopes[joint], motion)
            by_position = np.zeros((3, len(value)))
            by_slope = np.zeros(len(value))
            if derivatives:
                by_position = (
                    by_speed * motion.speed_weights + by_change * self.stencil.acceleration
                )
            if derivatives and isinstance(law, StaticFriction):
                up, down = (
                    self._mean(law, position, slopes[joint] + step, motion)[0]
                    for step in (_SLOPE, -_SLOPE)
                )
                by_slope = (up - down) / (2 * _SLOPE)
            result.append(LinkInput(index, number, dry, value, by_position, by_slope))
        return result

    def _mean(
        self, law: Any, number: int, slope: float, motion: "_Motion"
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A law's input, and its derivatives by speed at the sample and by acceleration."""
        above, below = self._limits(law, number)
        rate = self._with_slope(law, slope)

        def smooth(v: np.ndarray) -> np.ndarray:
            """The input without its jump."""
            jump = np.where(v > 0.0, above, below)
            return np.asarray(rate.inputs(HOST_FUNCTIONS, np.zeros_like(v), v)[number]) - jump

        value = np.full(len(motion.speed), 0.5 * (above + below))
        by_speed, by_change = np.zeros_like(value), np.zeros_like(value)
        for share, reach in motion.sides:
            change = motion.acceleration * reach
            sign, of_speed, of_change = _mean_sign(motion.speed, change, motion.scale)
            half = 0.5 * (above - below) * share
            value += half * sign
            by_speed += half * of_speed
            by_change += half * of_change * reach
            for x, weight in zip(_NODES, 2.0 * _WEIGHTS * (1.0 - _NODES), strict=True):
                v = motion.speed + x * change
                slope_of = (smooth(v + _RATE) - smooth(v - _RATE)) / (2 * _RATE)
                slope_of = np.where(np.abs(v) > _RATE, slope_of, 0.0)
                value += share * weight * smooth(v)
                by_speed += share * weight * slope_of
                by_change += share * weight * slope_of * x * reach
        return value, by_speed, by_change

    def _limits(self, law: Any, number: int) -> tuple[float, float]:
        """An input's limits at rest, from above and from below."""
        of_joint = self._with_slope(law, 0.0)
        v = np.array([1e-12, -1e-12])
        values = np.asarray(of_joint.inputs(HOST_FUNCTIONS, np.zeros(2), v)[number])
        above, below = values.round(6).tolist()
        return above, below

    @staticmethod
    def _with_slope(law: Any, slope: float) -> Any:
        if not isinstance(law, StaticFriction):
            return law
        return StaticFriction(np.array([np.exp(slope)]))


class _Motion(NamedTuple):
    """Of one link: (equations,) speed at the middle sample, acceleration; both sides of it.

    - `speed_weights`: (3, equations) of three positions in the speed.
    - `sides`: share of an interval in the mean, and the way to its end [s], negative before.
    - `scale`: speed within which friction changes its direction.
    """

    speed: Float[np.ndarray, " equations"]
    acceleration: Float[np.ndarray, " equations"]
    speed_weights: Float[np.ndarray, "3 equations"]
    sides: tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
    scale: float

    @classmethod
    def of(
        cls,
        q: Float[np.ndarray, " samples"],
        intervals: Float[np.ndarray, " intervals"],
        scale: float,
    ) -> "_Motion":
        before, after = intervals[:-1], intervals[1:]
        total = before + after
        weights = np.stack(
            [
                -after / (before * total),
                after / (before * total) - before / (after * total),
                before / (after * total),
            ]
        )
        mean = np.diff(q) / intervals
        speed = (after * mean[:-1] + before * mean[1:]) / total
        acceleration = 2.0 * (mean[1:] - mean[:-1]) / total
        sides = ((before / total, -before), (after / total, after))
        return cls(speed, acceleration, weights, sides, scale)


def _mean_sign(
    v: Float[np.ndarray, " equations"], w: Float[np.ndarray, " equations"], scale: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean of s(v + w x), x from 0 to 1 with weights 2 (1 - x); and its derivatives by v and w.

    s(v) = v / sqrt(v² + scale²), whose first and second integrals have closed forms.

    >>> import numpy as np
    >>> mean, _, _ = _mean_sign(np.array([1.0, -1.0]), np.array([0.0, 2.0]), 1e-6)
    >>> mean.round(6).tolist()
    [1.0, -0.5]
    """
    small = np.abs(w) < _SMALL * np.hypot(v, scale)
    x, weights = _NODES[:, None], (2.0 * _WEIGHTS * (1.0 - _NODES))[:, None]
    root = np.hypot(v + x * w, scale)
    bend = scale**2 / root**3
    near = (
        np.sum(weights * (v + x * w) / root, axis=0),
        np.sum(weights * bend, axis=0),
        np.sum(weights * x * bend, axis=0),
    )
    wide = np.where(small, 1.0, w)
    end = v + wide

    def first(v: np.ndarray) -> np.ndarray:
        return np.hypot(v, scale)

    def second(v: np.ndarray) -> np.ndarray:
        return 0.5 * (v * np.hypot(v, scale) + scale**2 * np.arcsinh(v / scale))

    mean = 2.0 * (second(end) - second(v) - wide * first(v)) / wide**2
    by_v = 2.0 * (first(end) - first(v) - wide * v / first(v)) / wide**2
    by_w = 2.0 * (first(end) - first(v)) / wide**2 - 2.0 * mean / wide
    mean, by_v, by_w = (
        np.where(small, a, b) for a, b in zip(near, (mean, by_v, by_w), strict=True)
    )
    return mean, by_v, by_w
