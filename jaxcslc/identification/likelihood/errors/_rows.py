import numpy as np
from jaxtyping import Float

from .._linear import Linear
from .._readings import score_share
from ..band import Factored, gram, stencil_parts


def eliminated_rows(
    linear: Linear, factored: Factored
) -> tuple[Float[np.ndarray, "samples rows border"], Float[np.ndarray, "samples border"]]:
    """Rows of each instant in standard deviations, and their sums times residuals.

    With positions eliminated, a fit is a regression whose rows are what an equation or a reading
    says of the border beyond what it says of positions: n equations, then n readings. The first
    and the last sample have readings and no equation.
    """
    objective, order = linear.objective, linear.order
    weights, residuals, eliminated = linear.weights, linear.residuals, factored.eliminated
    samples, n = order.position.shape
    of_position = eliminated[order.position]  # (samples, n, border)
    torque = linear.by_border.dense
    for columns, equations, of_equation in stencil_parts(linear.by_position):
        stencil = linear.by_position[equations, :, columns]
        torque[equations] -= np.matmul(stencil, of_position[of_equation])
    for reversals, equation, joint, derivative in linear.turn_parts:
        turned = derivative[:, None] * eliminated[order.turn[reversals]]
        np.subtract.at(torque, (equation, joint), turned)
    reading = -of_position
    sample, joints = np.indices(weights.position.shape)
    reading[sample, joints, linear.offset] += objective.scale[linear.offset]

    root = np.sqrt(weights.torque)
    rows = np.zeros((samples, 2 * n, len(objective.scale)))
    rows[1:-1, :n] = torque * root[:, :, None]
    rows[:, n:] = reading * np.sqrt(weights.position)[:, :, None]
    scaled = np.zeros((samples, 2 * n))
    scaled[1:-1, :n] = residuals.torque * root
    scaled[:, n:] = residuals.position * np.sqrt(weights.position)
    return rows, np.einsum("srb,sr->sb", rows, scaled)


def independent_covariance(
    linear: Linear,
    rows: Float[np.ndarray, "samples rows border"],
    inverse: Float[np.ndarray, "border border"],
) -> Float[np.ndarray, "border border"]:
    """The Cramér-Rao bound; for counts that are intervals, what replaces it.

    The bound of sharp intervals is none: errors fall with the number of readings, not with its
    root. With edges of some width, scores vary less than curvatures say (`score_share`): a sandwich
    of both.

    **Arguments**

    - `linear`: the equations at the minimum; `rows`: of `eliminated_rows`.
    - `inverse`: of the information, in units of the border's scale.
    """
    if linear.objective.intervals is None:
        return inverse
    return (
        inverse - inverse @ gram(_flat(rows * np.sqrt(1.0 - _shares(linear))[:, :, None])) @ inverse
    )


def score_gram(
    linear: Linear, rows: Float[np.ndarray, "samples rows border"]
) -> Float[np.ndarray, "border border"]:
    """The variance of the sum of scores for white noise of the levels that weights assume.

    **Arguments** as of `independent_covariance`.
    """
    if linear.objective.intervals is None:
        return gram(_flat(rows))
    return gram(_flat(rows * np.sqrt(_shares(linear))[:, :, None]))


def _shares(linear: Linear) -> Float[np.ndarray, "samples rows"]:
    """Of each row, the variance of its score over its curvature."""
    intervals = linear.objective.intervals
    assert intervals is not None
    return np.concatenate([np.ones_like(intervals.edge), score_share(intervals.edge)], axis=1)


def _flat(rows: Float[np.ndarray, "samples rows border"]) -> Float[np.ndarray, "_ border"]:
    """Rows of all samples, one after the other."""
    return rows.reshape(-1, rows.shape[2])
