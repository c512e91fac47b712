import numpy as np
from jaxtyping import Float

from ...network import CSLC
from ._factors import JointFactors
from ._triangle import triangle_of


# Rows of this size under columns of unit length stand for 'as small as possible' where patterns
# leave coefficients open. Of what they do tell, it changes 1e-16.
_RIDGE = 1e-8
_ROUNDS = 3


def fit_without_each(
    network: CSLC, factors: JointFactors, *, residual_weights: bool
) -> Float[np.ndarray, "folds coefficients"]:
    """The coefficients fitted to all folds but one, for each one left out.

    Triangles of folds stack like the patterns that they stand for, so no pattern is seen again.
    The same minimum as that of `LeastSquares.fit`, without what only a final fit needs to
    tell (rank,
    standard errors), and not compiled: in a search this is called some thirty times on a few
    hundred rows, and takes about 5 ms.

    **Arguments**

    - `factors`: of the folds, all arrays with a leading axis of folds.
    - `residual_weights`: divide each joint's equations by their residual.
    """
    folds = factors.counts.shape[0]
    kept = ~np.eye(folds, dtype=bool)
    triangles = [
        triangle_of(np.stack([t[own].reshape(-1, t.shape[-1]) for own in kept]))
        for t in map(np.asarray, factors.triangles)
    ]
    counts = kept @ np.asarray(factors.counts)
    weights = np.ones_like(counts)
    k = _solved(network, triangles, weights)
    for _ in range(_ROUNDS if residual_weights else 0):
        error = _residuals(network, triangles, k) / np.sqrt(np.maximum(counts, 1.0))
        # A joint without equations, or without error, gets no more weight than it can bear.
        largest = np.max(error, axis=1, keepdims=True)
        floor = np.where(largest > 0.0, 1e-12 * largest, 1.0)
        weights = np.where(counts > 0.0, 1.0 / np.maximum(error, floor), 1.0)
        k = _solved(network, triangles, weights)
    return k


def _solved(
    network: CSLC,
    triangles: list[Float[np.ndarray, "folds _ _"]],
    weights: Float[np.ndarray, "folds joints"],
) -> Float[np.ndarray, "folds coefficients"]:
    p, folds = network.size, weights.shape[0]
    ends = np.cumsum([0, *(t.shape[1] for t in triangles)])
    stacked = np.zeros((folds, ends[-1] + p, p + 1))
    for joint, (support, triangle) in enumerate(zip(network.support, triangles, strict=True)):
        rows = slice(ends[joint], ends[joint + 1])
        stacked[:, rows, [*support, p]] = weights[:, joint, None, None] * triangle
    lengths = np.linalg.norm(stacked[:, :, :p], axis=1)
    lengths = np.where(lengths > 0.0, lengths, 1.0)
    stacked[:, :, :p] /= lengths[:, None, :]
    stacked[:, ends[-1] :, :p] = _RIDGE * np.eye(p)
    triangle = triangle_of(stacked)
    scaled = np.linalg.solve(triangle[:, :p, :p], triangle[:, :p, p:])[..., 0]
    return scaled / lengths


def _residuals(
    network: CSLC,
    triangles: list[Float[np.ndarray, "folds _ _"]],
    k: Float[np.ndarray, "folds coefficients"],
) -> Float[np.ndarray, "folds joints"]:
    """Root of the sum of squared errors of each joint's own equations."""
    norms = [
        np.linalg.norm(
            (triangle[..., :-1] @ k[:, list(support), None])[..., 0] - triangle[..., -1], axis=-1
        )
        for support, triangle in zip(network.support, triangles, strict=True)
    ]
    return np.stack(norms, axis=-1)
