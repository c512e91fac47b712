"""Laws of residuals that are no squares: counts as intervals, and joints that stick."""

import dataclasses
from collections.abc import Callable

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from .._processes import over_chunks
from ._signs import runs


# Edges further outside than this, in their widths, count by size and not by square (Huber).
_OUTSIDE = 6.0
# Least curvature, in inverse squares of a step: a reading amid its interval says nothing.
_LEAST_CURVATURE = 1e-2
# Readings further inside than this, in the same widths, say nothing: their probability rounds to 1.
_INSIDE = 9.0
# Terms of the exponential beyond which a normal density is nothing.
_FAR = 38.0


@dataclasses.dataclass(frozen=True)
class WorkingReadings:
    """A law of readings about residuals, as the weighted squares that have its derivatives.

    **Attributes**

    - `value`: (...), minus twice the logarithm of the density, up to a constant.
    - `weight`: (...), half of its second derivative.
    - `residual`: (...), half of its first derivative over `weight`.
    """

    value: Float[np.ndarray, "*shape"]
    weight: Float[np.ndarray, "*shape"]
    residual: Float[np.ndarray, "*shape"]

    @property
    def levels(self) -> Float[np.ndarray, "*shape"]:
        """(...), of parabolas with these derivatives, the values at their vertices."""
        return self.value - self.weight * self.residual**2


@dataclasses.dataclass(frozen=True)
class Intervals:
    """Encoders' counts as what they are: the position is within one step, and nothing else.

    Where the equations of motion say much more about a motion than single readings do, the edges of
    these intervals are what is left to learn from. The probability of a reading is

        Φ((step/2 - r) / s) - Φ(-(step/2 + r) / s)

    with r the residual and s, the width of an edge, how well all readings say where the joint is.
    Where s is not much less than a step, counts are normally distributed about positions as far as
    anybody could tell, with a variance of step²/12.

    **Attributes**

    - `share`: (samples, n) of a reading that counts, 1 except for joints at rest.
    - `step`: (samples, n) of the encoders [rad or m].
    - `edge`: (samples, n) widths of edges in steps; 0 for normally distributed readings.
    """

    share: Float[np.ndarray, "samples joints"]
    step: Float[np.ndarray, "samples joints"]
    edge: Float[np.ndarray, "samples joints"]

    def edges(self, part: Int[np.ndarray, " samples"]) -> Float[np.ndarray, "recordings joints"]:
        """Return edges of each recording; `part`: number of the recording of each sample."""
        return self.edge[np.unique(part, return_index=True)[1]]

    def working(
        self,
        residual: Float[np.ndarray, "samples joints"],
        weight: Float[np.ndarray, "samples joints"],
    ) -> WorkingReadings:
        """Return values and derivatives at residuals [rad or m]; `weight` of those without
        intervals."""
        rows = self.edge > 0.0
        law = lambda x: interval(x, self.edge[rows])
        return _replaced(residual, weight, rows, self.step[rows], law, self.share[rows])


def _replaced(
    residual: Float[np.ndarray, "*shape"],
    weight: Float[np.ndarray, "*shape"],
    rows: Bool[np.ndarray, "*shape"],
    unit: Float[np.ndarray, " some"],
    law: Callable[[np.ndarray], WorkingReadings],
    share: Float[np.ndarray, " some"] | float = 1.0,
) -> WorkingReadings:
    """Return squares, and of some residuals a law, in a unit of their own.

    - `share`: of a residual that counts.
    """
    value, weight, working = weight * residual**2, weight.copy(), residual.copy()
    of_law = law(residual[rows] / unit)
    value[rows] = share * of_law.value
    weight[rows] = share * of_law.weight / unit**2
    working[rows] = of_law.residual * unit
    return WorkingReadings(value, weight, working)


def interval(
    residual: Float[np.ndarray, "*shape"], edge: Float[np.ndarray, "*shape"]
) -> WorkingReadings:
    """Return the law of readings that are intervals, residuals and edges in steps.

    >>> import numpy as np
    >>> interval(np.array([0.0, 0.49, 0.5, 0.53]), np.full(4, 0.01)).value.round(2).tolist()
    [-0.0, 0.35, 1.39, 13.22]
    """
    result = np.zeros(residual.shape), np.full(residual.shape, _LEAST_CURVATURE), 0.0 * residual
    flat = [np.ravel(x) for x in (residual, edge)]

    def compute(first: int, last: int) -> None:
        of_chunk = [x[first:last] for x in flat]
        near = np.flatnonzero(np.abs(of_chunk[0]) > 0.5 - _INSIDE * of_chunk[1])
        values = _near_edges(*(x[near] for x in of_chunk))
        for of_all, of_near in zip(result, values, strict=True):
            of_all.reshape(-1)[first:last][near] = of_near

    # Readings that a thread computes.
    over_chunks(compute, residual.size, 32_768)
    return WorkingReadings(*result)


def _near_edges(
    residual: Float[np.ndarray, " readings"], edge: Float[np.ndarray, " readings"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return values, weights and residuals of `interval`."""
    size = np.abs(residual)
    outside = np.maximum(size - 0.5 - _OUTSIDE * edge, 0.0)
    inside = size - outside
    far, near = np.minimum((0.5 + inside) / edge, _FAR), np.minimum((0.5 - inside) / edge, _FAR)
    probability = scipy.special.ndtr(near) - scipy.special.ndtr(-far)
    density_far, density_near = np.exp(-0.5 * far**2), np.exp(-0.5 * near**2)
    root = np.sqrt(2.0 * np.pi) * edge * probability
    score = (density_near - density_far) / root
    bend = (near * density_near + far * density_far) / (root * edge)
    # The first derivative stays what it is further outside, and the weight is a secant's.
    curvature = (score**2 + bend) / (1.0 + outside / (_OUTSIDE * edge))
    curvature = np.maximum(curvature, _LEAST_CURVATURE)
    value = -2.0 * np.log(probability) + 2.0 * score * outside
    return value, curvature, np.copysign(score, residual) / curvature


def score_share(edge: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Return the variance of scores over their mean curvature, were edges sharp; 1 for none.

    The width of an edge stands for what is not known of the position, not for noise: positions are
    inside their intervals. So errors are smaller than a law says in which they may be outside.

    >>> import numpy as np
    >>> score_share(np.array([0.0, 0.01])).round(2).tolist()
    [1.0, 0.41]
    """
    result = np.ones_like(edge)
    position = np.linspace(-0.5, 0.5, 4001)
    for width in np.unique(edge[edge > 0.0]):
        working = interval(position, np.full_like(position, width))
        squares = np.mean((working.weight * working.residual) ** 2)
        result[edge == width] = squares / np.mean(working.weight)
    return result


# Equations at the start and at the end of a rest that say nothing of break-away: a joint creeps
# within a step of its encoder before a reading changes.
_START, _END = 4, 16
# Torque beyond this part of break-away, at any time of a rest, is a limit's or a brake's.
_MOST = 1.5
# Standard deviations beyond which the tail of a normal density is that of a parabola.
_TAIL = 30.0


@dataclasses.dataclass(frozen=True)
class Sticking:
    """Equations of joints that stick: friction is what motion needs, and at most break-away.

    The torque that friction bears is known, and no more of its coefficients than a bound: a
    censored observation (Tobin 1958). With f the torque less what motion and gravity need, b the
    friction at break-away and s the noise of torque, its probability is Φ((b - |f|) / s). Torque
    well below break-away says nothing; torque that would have moved the joint is excluded.

    **Attributes**

    - `mask`: (equations, n), which equations these are.
    - `direction`: (equations, n) sign of f, in which equations hold b.
    - `noise`: (equations, n) s [N m or N].
    """

    mask: Bool[np.ndarray, "equations joints"]
    direction: Float[np.ndarray, "equations joints"]
    noise: Float[np.ndarray, "equations joints"]

    def working(
        self,
        residual: Float[np.ndarray, "equations joints"],
        weight: Float[np.ndarray, "equations joints"],
    ) -> WorkingReadings:
        """Return values and derivatives at residuals [N m or N]; `weight` of all other
        equations."""
        unit = self.direction[self.mask] * self.noise[self.mask]
        return _replaced(residual, weight, self.mask, unit, bound)


def bound(excess: Float[np.ndarray, " rows"]) -> WorkingReadings:
    """Return the law of quantities that are at most zero, in standard deviations.

    >>> import numpy as np
    >>> bound(np.array([-5.0, 0.0, 5.0])).value.round(2).tolist()
    [0.0, 1.39, 30.13]
    """
    near = np.clip(excess, -_TAIL, _TAIL)
    log_probability = scipy.special.log_ndtr(-near)
    score = np.exp(-0.5 * near**2 - 0.5 * np.log(2.0 * np.pi) - log_probability)
    curvature = np.maximum(score * (score - near), 1e-12)
    score, curvature = (
        np.where(excess > _TAIL, excess, score),
        np.where(excess > _TAIL, 1.0, curvature),
    )
    beyond = np.maximum(excess, _TAIL) ** 2 - _TAIL**2
    return WorkingReadings(beyond - 2.0 * log_probability, curvature, score / curvature)


def sticking_equations(
    at_rest: Bool[np.ndarray, "equations joints"],
    friction: Float[np.ndarray, "equations joints"],
    breakaway: Float[np.ndarray, " joints"],
) -> Bool[np.ndarray, "equations joints"]:
    """Return those that break-away bounds: amid a rest that nothing but friction holds.

    - `at_rest`: equations of joints at standstill.
    - `friction`: torque less what motion and gravity need [N m or N].
    - `breakaway`: (n,) at present [N m or N].
    """
    result = np.zeros_like(at_rest)
    for joint in range(at_rest.shape[1]):
        for start, end in runs(at_rest[:, joint]):
            rows = slice(start + _START, max(end - _END, start + _START))
            size = np.abs(friction[rows, joint])
            result[rows, joint] = size.size > 0 and size.max() <= _MOST * breakaway[joint]
    return result
