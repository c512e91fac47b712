"""Misfit: how far errors of a fit exceed those that its residuals show, and errors of its prior.

Noise averages out, and a model that lacks something does not. Nor do torques at a wrong time, or
samples that repeat others. Residuals do not tell them apart. Predictions of motion unlike the
fitted one do: their errors are larger than the covariance of the fit says.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..least_squares import (
    FoldFit,
    Identification,
    JointFactors,
    LeastSquares,
    WeightedEquations,
)
from ..network import CSLC
from ..recordings import Patterns
from ._prior import KnownRows


# Misfits of the data that are tried, as factors of variances. A thousandfold leaves a usual
# recording the weight of a few samples.
_OF_DATA = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
# Misfits of the prior, as factors of variances: its deviations are up to five times larger.
_OF_PRIOR = (6.25, 25.0)
# Natural units of the mean score that misfit has to gain, which is 5 % of an error. (Heuristic.)
_GAIN = 0.1
# Relative precisions and variances below this are rounding.
_SILENT = 1e-12


class Misfit(NamedTuple):
    """Factors of variances, at most one of them larger than one.

    - `data`: of errors of the fit, beyond what its residuals show.
    - `prior`: of errors of the prior, beyond what it says.
    """

    data: float = 1.0
    prior: float = 1.0


def misfit_of(
    network: CSLC, patterns: Patterns, solver: LeastSquares, fit: Identification, prior: KnownRows
) -> Misfit:
    """Return the misfit that predicts unlike motion best; none of too few samples.

    A fit of some of the motion and the prior predict the torque of other motion, with an error. Its
    variance v is that of residuals and that of the coefficients, which misfit multiplies. The score
    of a joint is log v + e²/v, e² being the mean square error. Its expectation is least where v is
    right (Dawid and Sebastiani 1999).

    **Arguments**

    - `patterns`: that `fit` is of, or a part of them; `fit`: without the prior.
    - `prior`: of coefficients; its correlation is that of the data without misfit.
    """
    choices = [Misfit(data=factor) for factor in _OF_DATA]
    choices += [Misfit(prior=factor) for factor in _OF_PRIOR]
    scores: list[list[float]] = []
    usual = np.asarray(fit.torque_error) ** 2
    for split in _splits(network, patterns, solver, fit):
        counts = np.asarray(split.far.counts)
        some = (counts > 0.0) & (usual > 0.0)
        if not np.any(some):
            continue
        axes = _axes(split.near, prior)
        triangles = [
            (triangle[:, :-1] @ axes.vectors[list(support)], triangle[:, -1])
            for triangle, support in zip(split.far.triangles, network.support, strict=True)
        ]
        scores.append([])
        for data, of_prior in choices:
            precision = axes.share / data + (1.0 - axes.share) / of_prior
            k = (axes.of_data / data + axes.of_prior / of_prior) / precision
            errors, spreads = np.array(
                [
                    (np.sum((columns @ k - torque) ** 2), np.sum(columns**2 / precision))
                    for columns, torque in triangles
                ]
            ).T
            variance = split.residual[some] + spreads[some] / counts[some]
            variance = np.maximum(variance, _SILENT * usual[some])
            score = np.log(variance / usual[some]) + errors[some] / counts[some] / variance
            scores[-1].append(float(np.mean(score)))
    if not scores:
        return Misfit()
    return choices[_chosen(np.mean(scores, axis=0))]


def _chosen(means: Float[np.ndarray, " choices"]) -> int:
    """Return the index of a misfit by mean scores of all: first those of data, from none on.

    A wide prior lets in whatever all parts of the motion share, as the torque of a stop: each
    wider one has to gain over the one before.
    """
    best = int(np.argmin(means[: len(_OF_DATA)]))
    if means[best] >= means[0] - _GAIN:
        best = 0
    for wider in range(len(_OF_DATA), len(means)):
        if means[wider] < means[best] - _GAIN:
            best = wider
    return best


class _Split(NamedTuple):
    """Motion that is judged, and the fit of other motion.

    - `near`: the fit; `far`: factors of the judged equations.
    - `residual`: mean square errors of the judged equations under the fit of all.
    """

    near: FoldFit
    far: JointFactors
    residual: Float[np.ndarray, " joints"]


def _splits(
    network: CSLC, patterns: Patterns, solver: LeastSquares, fit: Identification
) -> Iterator[_Split]:
    """Judge motion far from the middle of positions, fast motion, and either half of the time.

    Fits of halves have the weights and the noise of the fit of all.
    """
    whole = solver.equations(network, patterns)
    weighted = WeightedEquations.of(whole, np.asarray(fit.k), solver)
    unknowns, equations = whole.unknowns, whole.times(weighted.roots)
    # A half's own residuals are smaller than its noise: it has half as many equations, and slow
    # motion has less of what the model lacks.
    variance = weighted.minimum(unknowns, equations.factors()).variance
    late = np.arange(patterns.samples) >= patterns.samples // 2
    q, speed = np.asarray(patterns.q), np.abs(np.asarray(patterns.qd))
    for far in (_outer(np.abs(q - np.median(q, axis=0))), _outer(speed), late, ~late):
        if np.all(far) or not np.any(far):
            continue
        part = weighted.minimum(unknowns, equations.selected(~far).factors())
        near = FoldFit(part.k, variance * part.inverse_gram, part.undetermined)
        if np.all(np.isfinite(near.k)) and np.all(np.isfinite(near.covariance)):
            factors = equations.selected(far).factors()
            errors = factors.root_mean_squares(unknowns, np.asarray(fit.k))
            yield _Split(near, factors, np.asarray(errors) ** 2)


def _outer(values: Float[np.ndarray, "samples joints"]) -> Bool[np.ndarray, " samples"]:
    """Return the half of the samples at which a joint is nearest to its greatest value."""
    greatest = np.max(values, axis=0)
    relative = np.max(values / np.where(greatest > 0.0, greatest, 1.0), axis=1)
    return relative > np.median(relative)


class _Axes(NamedTuple):
    """Combinations of coefficients in which the data's precision and the prior's are diagonal.

    - `vectors`: one per column; precisions of data and prior add up to one in each.
    - `share`: the data's part of the precision.
    - `of_data`, `of_prior`: right-hand sides of the normal equations.
    """

    vectors: Float[np.ndarray, "coefficients axes"]
    share: Float[np.ndarray, " axes"]
    of_data: Float[np.ndarray, " axes"]
    of_prior: Float[np.ndarray, " axes"]


def _axes(fit: FoldFit, prior: KnownRows) -> _Axes:
    """Return the axes of a fit and a prior."""
    rows = prior.rows_of(fit)
    total = rows.T @ rows + prior.matrix.T @ prior.matrix
    sizes = np.sqrt(np.diag(total))
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    values, vectors = np.linalg.eigh(total / np.outer(sizes, sizes))
    told = values > _SILENT * values[-1:]
    vectors = vectors[:, told] / np.sqrt(values[told]) / sizes[:, None]
    _, singular, turn = np.linalg.svd(rows @ vectors)
    share = np.zeros(vectors.shape[1])
    share[: len(singular)] = np.minimum(singular**2, 1.0)
    vectors = vectors @ turn.T
    return _Axes(
        vectors,
        share,
        (rows @ vectors).T @ (rows @ fit.k),
        (prior.matrix @ vectors).T @ prior.target,
    )
