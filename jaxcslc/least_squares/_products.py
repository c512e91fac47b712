"""Factors of many patterns at the speed of matrix products, and refinement of their solution.

A pivoted factor of a sample of rows makes rows nearly orthonormal, so that products of them lose
little. Kernels compute the products on a processor or on a GPU. Sums of residuals in double words
refine the solution.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float, Shaped

from ..network import AbstractLinearNetwork
from ..recordings import Patterns
from ._equations import dense_factors
from ._factors import JointFactors, Unknowns, triangle_of
from ._gpu_kernel import GramKernel, fused_kernel_of
from ._host_kernel import HostKernel, host_kernel_of
from ._minimum import Numbers, Solution


# Squares of pivots of a sample's columns of unit length below which products do not resolve them.
_LEAST_SQUARE = 1e-13
# Added below a sample's rows, in lengths of their columns: directions that the sample lacks stay
# finite, and are resolved to 1e-8 of 1e-8.
_SHIFT = 1e-8
# What rounding of the products may change, in units of rounding and lengths of columns. Householder
# reflections change about ten.
LARGEST_ERROR = 100.0
# Columns behind a preconditioner count as zero up to this, in the same units.
_NEGLIGIBLE = 0.5 * LARGEST_ERROR

Motion = tuple[Array | np.ndarray, ...]
"""q, qd, qdd (samples, m), torque and weight (samples, n), on the host or on a device."""


class Preconditioner(NamedTuple):
    """Matrices that make each joint's regressor rows nearly orthonormal.

    A pivoted factor R of a sample of rows: with pivots, rows of R are graded and the errors of a
    product with the inverse as small as those of substitution, at the speed of matrix products.

    **Attributes**

    - `inverses`: (s + 1, s + 1), what rows are multiplied by; the torque is a column like others.
    - `factors`: (s + 1, s + 1), their inverses.
    """

    inverses: tuple[Float[np.ndarray, "_ _"], ...]
    factors: tuple[Float[np.ndarray, "_ _"], ...]

    @classmethod
    def from_rows(cls, rows: Sequence[Float[np.ndarray, "_ _"]]) -> "Preconditioner":
        """Compute the preconditioner from some rows of each joint, or from a triangle of them.

        Columns of zeros are allowed.
        """
        inverses, factors = zip(*map(_inverse_and_factor, rows), strict=True)
        return cls(inverses, factors)

    @classmethod
    def from_products(cls, grams: Sequence[Float[np.ndarray, "_ _"]]) -> "Preconditioner":
        """Compute the preconditioner from the products of some rows of each joint.

        Rows are resolved to 3e-7 of their columns' lengths. What lies beyond takes a second pass.
        """
        return cls.from_rows([*map(_rows_with_products, grams)])


def _inverse_and_factor(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    lengths = _lengths(rows)
    size = rows.shape[1]
    shifted = np.concatenate([rows / lengths, _SHIFT * np.eye(size)])
    triangle, order = scipy.linalg.qr(shifted, mode="r", pivoting=True, check_finite=False)
    triangle = triangle[:size]
    inverse, factor = np.empty((2, size, size))
    # `solve_triangular` wakes a thread per core, and these slow the host: with 16 cores a fit of
    # 10⁸ patterns on a GPU took 0.13 s instead of 0.06 s (`scripts.benchmarks.solve_gpu`).
    inverse[order] = scipy.linalg.lapack.dtrtri(triangle)[0]
    factor[:, order] = triangle
    return inverse / lengths[:, None], factor * lengths


def _rows_with_products(gram: np.ndarray) -> np.ndarray:
    """Return rows that have these products: a pivoted Cholesky factor as far as they resolve it."""
    if not np.all(np.isfinite(gram)):
        return np.eye(len(gram))
    lengths = np.sqrt(np.diag(gram))
    lengths = np.where(lengths > 0.0, lengths, 1.0)
    normalized = gram / lengths[:, None] / lengths
    triangle, pivots, rank, _ = scipy.linalg.lapack.dpstrf(normalized, tol=_LEAST_SQUARE)
    rows = np.zeros_like(gram)
    rows[:rank, pivots - 1] = np.triu(triangle)[:rank]
    return rows * lengths


def _lengths(rows: np.ndarray) -> np.ndarray:
    """Return the lengths of columns to divide by, 1 of columns of zeros."""
    lengths = np.linalg.norm(rows, axis=0)
    return np.where(lengths > 0.0, lengths, 1.0)


def triangles_of(
    preconditioner: Preconditioner, grams: Sequence[Float[np.ndarray, "_ _"]]
) -> tuple[tuple[Float[np.ndarray, "_ _"], ...], Float[np.ndarray, " joints"]]:
    """Return the triangles of rows whose products behind a preconditioner are `grams`.

    **Returns** the triangles, and for each joint a bound of their error: of the change of the
    rows, by columns, that would explain it, in units of rounding and of the columns' lengths.
    """
    pairs = [
        _triangle_and_error(factor, gram)
        for factor, gram in zip(preconditioner.factors, grams, strict=True)
    ]
    triangles, errors = zip(*pairs, strict=True)
    return triangles, np.array(errors)


def _normalized(factor: np.ndarray, gram: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a Gram matrix of columns of unit length, on whose scale a factor's errors do not
    depend, and the rows of the preconditioner's factor times the lengths."""
    lengths = np.sqrt(np.diag(gram))
    divisor = np.where(lengths > 0.0, lengths, 1.0)
    normalized, directions = gram / divisor[:, None] / divisor, lengths[:, None] * factor
    # What depends on other columns is left as rounding, in any direction: none of its own.
    columns = np.sqrt(np.maximum(np.sum(directions * (normalized @ directions), axis=0), 0.0))
    negligible = np.all(np.abs(directions) <= _NEGLIGIBLE * np.finfo(float).eps * columns, axis=1)
    if np.any(negligible):
        directions[negligible] = normalized[negligible] = normalized[:, negligible] = 0.0
        normalized[negligible, negligible] = 1.0
    return normalized, directions


def _triangle_and_error(factor: np.ndarray, gram: np.ndarray) -> tuple[np.ndarray, float]:
    if not np.all(np.isfinite(gram)):
        return np.full_like(gram, np.nan), np.nan
    normalized, directions = _normalized(factor, gram)
    triangle, singular = scipy.linalg.lapack.dpotrf(normalized, lower=1)
    if not singular:
        # Rounding of the products changes the factor by no more than its inverse's norm.
        half = triangle.T @ directions
        change = np.linalg.norm(scipy.linalg.lapack.dtrtri(triangle, lower=1)[0])
        error = change * np.max(np.linalg.norm(directions, axis=0) / _lengths(half))
        if error < LARGEST_ERROR:
            return triangle_of(half), float(error)
    values, vectors = np.linalg.eigh(normalized)
    roots = np.sqrt(np.maximum(values, 0.0))
    directions = vectors.T @ directions
    half = roots[:, None] * directions
    # Rounding of the products changes a root by this, and the columns by its part of directions.
    unit = np.finfo(float).eps
    changes = np.minimum(unit / np.maximum(roots, unit), np.sqrt(unit))
    changed = np.linalg.norm(changes[:, None] * directions, axis=0)
    error = np.max(changed / _lengths(half)) / unit
    return triangle_of(half), float(error)


def kernel_of(network: AbstractLinearNetwork, platform: str) -> HostKernel | GramKernel | None:
    """Return what multiplies a network's columns: for a GPU, or else for the host; None without."""
    kernel = None if platform == "cpu" else fused_kernel_of(network)
    return kernel or host_kernel_of(network)


def factors_of(
    network: AbstractLinearNetwork,
    motion: Motion,
    kernel: HostKernel | GramKernel | None,
    preconditioner: Preconditioner | None = None,
) -> tuple[JointFactors, Preconditioner | None]:
    """Return the factors of many patterns, at the speed of matrix products.

    Cholesky QR behind a preconditioner: rows are multiplied by the inverse of the factor of a
    sample of them, which makes their Gram matrix well conditioned, so that its factor has as
    small an error as Householder's. That is checked by a bound, joint by joint; what fails it is
    factorised again behind the factor that it has led to, and in the end by reflections. (Fukaya
    et al., 'Shifted Cholesky QR for computing the QR factorization of ill-conditioned matrices',
    SIAM J. Sci. Comput. 2020, doi:10.1137/18M1218212; a sample instead of the first pass as of
    Balabanov, 'Randomized Cholesky QR factorizations', 2022, arXiv:2210.09953.)

    **Arguments**

    - `kernel`: of `kernel_of`; without one, reflections alone.
    - `preconditioner`: of other patterns like them; of a sample of these if None.

    **Returns** the factors, NumPy's, and the preconditioner that served.
    """
    if kernel is not None:
        if preconditioner is None:
            preconditioner = sample_of(motion, kernel)
        # Each factor that is not good enough is the preconditioner of the next.
        for _ in range(3):
            *grams, counts = kernel.products(preconditioner.inverses, *motion)
            triangles, errors = triangles_of(preconditioner, grams)
            # Rows that are not finite, whose errors are NaN, have no better factors.
            if np.max(np.nan_to_num(errors)) < LARGEST_ERROR:
                return JointFactors(triangles, counts), preconditioner
            preconditioner = Preconditioner.from_rows(triangles)
    q, qd, qdd, torque, weight = (np.asarray(x) for x in motion)
    time, pairs = np.arange(len(q)) * 1.0, weight != 0
    patterns = Patterns(time, q, qd, qdd, torque, pairs, pairs)
    return dense_factors(network, patterns), preconditioner


def sample_of(motion: Motion, kernel: HostKernel | GramKernel) -> Preconditioner:
    """Return the preconditioner of patterns that are spread over all."""
    identities = tuple(map(np.eye, kernel.sizes))
    *grams, _ = kernel.products(identities, *motion, sample=True)
    return Preconditioner.from_products(grams)


def block_at(motion: Sequence[Array], start: Array, size: int) -> tuple[Array, ...]:
    """Return `size` patterns from `start` on; patterns behind the end have weight zero."""
    samples = len(motion[0])
    if samples < size:
        motion = [jnp.pad(x, ((0, size - samples), (0, 0))) for x in motion]
    # The last block begins within the one before: its first patterns have been there already.
    first = jnp.minimum(start, max(samples - size, 0))
    *block, weight = (jax.lax.dynamic_slice_in_dim(x, first, size) for x in motion)
    return *block, jnp.where((first + jnp.arange(size) >= start)[:, None], weight, 0.0)


def weighted_rows(
    network: AbstractLinearNetwork,
    q: Float[Array, "motion samples"],
    qd: Float[Array, "motion samples"],
    qdd: Float[Array, "motion samples"],
    torque: Float[Array, "joints samples"],
    weight: Float[Array, "joints samples"],
) -> tuple[Float[Array, "_ samples"], ...]:
    """Return each joint's regressor columns and torque, (s + 1, samples), weighted."""
    return tuple(
        jnp.concatenate([rows, torque[j][None]]) * weight[j][None]
        for j, rows in enumerate(network.columns(q, qd, qdd))
    )


# Standard errors by which rounding may move a coefficient.
_LARGEST_ERROR = 1e-9
# Errors of factors in units of rounding, on 65,536 random states of a PUMA 560 and a Panda beside
# exact solutions: of the torque's length over the noise, and of the condition number times the root
# of the number of equations. Both are upper ends.
_OF_TORQUE, _OF_CONDITION = 8.0, 0.5
# Patterns whose products are added to sums of their own, a power of two; joined in the end.
_CPU_LANES, _GPU_LANES = 1 << 11, 1 << 17


def needs_correction(
    unknowns: Unknowns,
    factors: JointFactors,
    solution: Solution,
    weights: Float[Numbers, " joints"],
) -> bool:
    """Return whether rounding of the factors may move a coefficient by 10^-9 of its standard error.

    Triangles are those of rows that rounding has changed. That moves coefficients by the
    condition number times the part of the residual that is then along the columns, which grows
    with the root of the number of equations, while standard errors shrink.
    """
    if not solution.finite:
        return False
    torque = [w * x[:, -1] for w, x in zip(weights, factors.triangles, strict=True)]
    torque = np.linalg.norm(np.concatenate(torque))
    noise = np.sqrt(solution.variance)
    in_noise = torque / noise if noise > 0.0 else np.inf if torque > 0.0 else 0.0
    of_condition = solution.condition * np.sqrt(np.sum(factors.counts))
    unit = 0.5 * np.finfo(float).eps
    return bool(unit * (_OF_TORQUE * in_noise + _OF_CONDITION * of_condition) > _LARGEST_ERROR)


def corrected(
    unknowns: Unknowns,
    solution: Solution,
    weights: Float[Numbers, " joints"],
    sums: Float[np.ndarray, "blocks 2 entries"],
) -> Solution:
    """Return the solution after one step of iterative refinement.

    What is left of the equations by the first solution is computed from the rows themselves, its
    products with the columns are summed in twice the precision, and the factors need then be good
    to some digits only: 'corrected seminormal equations' (Björck, 'Stability analysis of the method
    of seminormal equations for linear least squares problems', Linear Algebra and its Applications
    1987, doi:10.1016/0024-3795(87)90101-7), with double-word sums instead of single ones, since
    a sum of 10^8 products is rounded by more than the columns are.

    - `sums`: of `residual_sums`, for the solution's coefficients; of one or several sets of
      patterns.
    """
    # Joints cancel each other at the minimum.
    total = np.zeros(unknowns.size, np.longdouble)
    number = np.sum(np.asarray(sums, np.longdouble), axis=(0, 1))
    first = 0
    for support, weight in zip(unknowns.support, weights, strict=True):
        of_joint = number[first : first + len(support)]
        total[list(support)] += np.longdouble(weight) ** 2 * of_joint
        first += len(support)
    change = solution.inverse_gram @ total.astype(float)
    return solution._replace(k=solution.k + change)


def residual_sums(
    network: AbstractLinearNetwork,
    k: Float[Array, " coefficients"],
    *motion: Shaped[Array, "samples _"],
    on_gpu: bool,
) -> Float[Array, "2 entries"]:
    """Compute column times residual of `k`, per joint and coefficient of its support.

    Sums of exact products in double words (Ogita, Rump and Oishi, 'Accurate sum and dot product',
    SIAM J. Sci. Comput. 2005, doi:10.1137/030601818).

    **Returns** sums, and what rounding has taken off them.
    """
    lanes = _GPU_LANES if on_gpu else _CPU_LANES
    while lanes >= 2 * max(len(motion[0]), 1):
        lanes //= 2
    joint = np.repeat(np.arange(len(network.support)), [len(row) for row in network.support])

    def step(sums: tuple[Array, Array], start: Array) -> tuple[tuple[Array, Array], None]:
        rows = weighted_rows(network, *(x.T for x in block_at(motion, start, lanes)))
        residuals = [
            of_joint[-1] - k[np.array(support, dtype=int)] @ of_joint[:-1]
            for support, of_joint in zip(network.support, rows, strict=True)
        ]
        columns = jnp.concatenate([of_joint[:-1] for of_joint in rows])
        upper, lower = _product(columns, jnp.stack(residuals)[joint])
        total, rounded = _sum(sums[0], upper)
        return (total, sums[1] + (rounded + lower)), None

    empty = jnp.zeros((len(joint), lanes))
    starts = jnp.arange(0, max(len(motion[0]), 1), lanes)
    (total, small), _ = jax.lax.scan(step, (empty, empty), starts)
    while lanes > 1:
        lanes //= 2
        total, rounded = _sum(total[:, :lanes], total[:, lanes:])
        small = small[:, :lanes] + small[:, lanes:] + rounded
    return jnp.stack([total[:, 0], small[:, 0]])


def _product(x: Array, y: Array) -> tuple[Array, Array]:
    """A product as two numbers: that of the upper halves, which is exact, and what remains.

    By bits: a compiler may join the multiplications and additions of Dekker's splitting.
    """
    upper_x, upper_y = _upper_half(x), _upper_half(y)
    return upper_x * upper_y, upper_x * (y - upper_y) + (x - upper_x) * y


def _upper_half(x: Array) -> Array:
    bits = jax.lax.bitcast_convert_type(x, jnp.int64)
    # Of a float64's 52 bits the upper half: products of such numbers are exact.
    return jax.lax.bitcast_convert_type(bits & -(1 << 27), jnp.float64)


def _sum(x: Array, y: Array) -> tuple[Array, Array]:
    """A sum and its rounding error (Knuth)."""
    total = x + y
    part = total - x
    return total, (x - (total - part)) + (y - part)
