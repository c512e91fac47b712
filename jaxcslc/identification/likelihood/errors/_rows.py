"""Rows of a fit with positions eliminated, summed up."""

import dataclasses

import numpy as np
from jaxtyping import Float

from ...._chunks import over_chunks
from .._linear import Linear
from .._readings import score_share
from ..band import Factored, gram, stencil_parts


# Stretches of time in which products of rows are summed.
_STRETCHES = 256


@dataclasses.dataclass(frozen=True)
class RowSums:
    """What equations and readings say of the border beyond what they say of positions, summed up.

    With positions eliminated, a fit is a regression; see `eliminated_rows`. Its rows are several
    times as large as all matrices of a fit together, so that they are computed stretch by stretch.

    **Attributes**

    - `scores`: (samples, border), sums of an instant's rows times residuals.
    - `grams`: (stretches, border, border), products of rows; `middles`: (stretches,) of their
      samples, counted from 0.
    - `noise`: (border, border), the variance of the sum of scores for white noise of the levels
      that weights assume.
    """

    scores: Float[np.ndarray, "samples border"]
    grams: Float[np.ndarray, "stretches border border"]
    middles: Float[np.ndarray, " stretches"]
    noise: Float[np.ndarray, "border border"]

    @classmethod
    def of(cls, linear: Linear, factored: Factored) -> "RowSums":
        """Sum up rows of equations at the minimum."""
        samples, intervals = len(linear.order.position), linear.objective.readings.intervals
        ends = np.linspace(0, samples, min(_STRETCHES, samples) + 1).astype(int)
        size = len(linear.objective.scale)
        scores, grams = np.empty((samples, size)), np.empty((len(ends) - 1, size, size))
        shares = None if intervals is None else score_share(intervals.edge)

        def add(first: int, last: int) -> np.ndarray:
            noise = np.zeros((size, size))
            for number in range(first, last):
                stretch = slice(int(ends[number]), int(ends[number + 1]))
                rows, scores[stretch] = eliminated_rows(linear, factored, stretch)
                grams[number] = gram(rows.reshape(-1, size))
                if shares is not None:
                    rows[:, -shares.shape[1] :] *= np.sqrt(shares[stretch])[:, :, None]
                    noise += gram(rows.reshape(-1, size))
            return noise

        parts = over_chunks(add, len(grams), 1 + len(grams) // 16)
        noise = np.sum(grams if shares is None else parts, axis=0)
        return cls(scores, grams, 0.5 * (ends[1:] + ends[:-1] - 1), noise)

    def independent_covariance(
        self, inverse: Float[np.ndarray, "border border"]
    ) -> Float[np.ndarray, "border border"]:
        """Return the Cramér-Rao bound; for counts that are intervals, what replaces it.

        The bound of sharp intervals is none: errors fall with the number of readings, not with its
        root. With edges of some width, scores vary less than curvatures say (`score_share`): a
        sandwich of both.

        **Arguments**

        - `inverse`: of the information, in units of the border's scale.
        """
        return inverse - inverse @ (np.sum(self.grams, axis=0) - self.noise) @ inverse


def eliminated_rows(
    linear: Linear, factored: Factored, stretch: slice
) -> tuple[Float[np.ndarray, "samples rows border"], Float[np.ndarray, "samples border"]]:
    """Return rows of a stretch's instants in standard deviations, and their sums times residuals.

    With positions eliminated, a fit is a regression whose rows are what an equation or a reading
    says of the border beyond what it says of positions: n equations, then n readings. The first
    and the last sample of all have readings and no equation.
    """
    objective, order, eliminated = linear.objective, linear.order, factored.eliminated
    weights, residuals = linear.weights, linear.residuals
    first, last = stretch.start, stretch.stop
    equations = slice(max(first - 1, 0), max(min(last - 1, len(order.position) - 2), 0))
    count, n = last - first, linear.readings.joints
    motion, series = linear.motion, order.position.shape[1]
    within = equations.start + 1 - first  # of the first equation among the samples

    torque = motion.by_border.between(equations).dense
    for columns, of_part, samples in stencil_parts(motion.by_position):
        some = _common(equations, of_part)
        shift = samples.start - of_part.start
        near = eliminated[order.position[some.start + shift : some.stop + shift]]
        rows = slice(some.start - equations.start, some.stop - equations.start)
        torque[rows] -= np.matmul(motion.by_position[some, :, columns], near)
    for reversals, equation, joint, derivative in motion.turns:
        inside = np.flatnonzero((equation >= equations.start) & (equation < equations.stop))
        turned = derivative[inside, None] * eliminated[order.turn[reversals[inside]]]
        np.subtract.at(torque, (equation[inside] - equations.start, joint[inside]), turned)
    reading = -eliminated[order.position[stretch, :n]]
    sample, joints = np.indices((count, n))
    offset = linear.readings.offset[stretch]
    reading[sample, joints, offset] += objective.scale[offset]

    of_torque, of_position = weights["torque"][equations], weights["position"][stretch]
    result, scaled = (
        np.zeros((count, series + n, len(objective.scale))),
        np.zeros((count, series + n)),
    )
    rows = slice(within, within + len(of_torque))
    result[rows, :series] = torque * np.sqrt(of_torque)[:, :, None]
    result[:, series:] = reading * np.sqrt(of_position)[:, :, None]
    scaled[rows, :series] = residuals["torque"][equations] * np.sqrt(of_torque)
    scaled[:, series:] = residuals["position"][stretch] * np.sqrt(of_position)
    return result, np.matmul(scaled[:, None], result)[:, 0]


def _common(one: slice, other: slice) -> slice:
    """Return what two slices share; empty, not reversed, where that is nothing."""
    first = max(one.start, other.start)
    return slice(first, max(min(one.stop, other.stop), first))
