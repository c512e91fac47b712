"""Factors of many patterns at the speed of matrix products, behind a preconditioner.

A pivoted factor of a sample of rows makes rows nearly orthonormal, so that products of them lose
little. Read with `_factors`, whose triangles result, and `_streaming`.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float

from .._environment import array_namespace, platform_of
from ..network import AbstractLinearNetwork
from ._factors import JointFactors, factorise, joined_factors, triangle_of, weighted_rows
from ._host_kernel import HostKernel
from ._products import fused_gram_matrices, fused_kernel_of


# Squares of pivots of a sample's columns of unit length below which products do not resolve them.
_LEAST_SQUARE = 1e-13
# Added below a sample's rows, in lengths of their columns: directions that the sample lacks stay
# finite, and are resolved to 1e-8 of 1e-8.
_SHIFT = 1e-8
# What rounding of the products may change, in units of rounding and lengths of columns. Householder
# reflections change about ten.
LARGEST_ERROR = 100.0
# Columns behind a preconditioner count as zero up to this, in the same units.
_NEGLIGIBLE = 50.0


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
    def of_rows(cls, rows: Sequence[Float[np.ndarray, "_ _"]]) -> "Preconditioner":
        """Compute the preconditioner from some rows of each joint, or from a triangle of them.

        Columns of zeros are allowed.
        """
        pairs = [_inverse_and_factor(np.asarray(joint_rows)) for joint_rows in rows]
        inverses, factors = zip(*pairs, strict=True)
        return cls(inverses, factors)

    @classmethod
    def of_products(cls, grams: Sequence[Float[np.ndarray, "_ _"]]) -> "Preconditioner":
        """Compute the preconditioner from the products of some rows of each joint.

        Rows are resolved to 1e-7 of their columns' lengths, which serves as well as 1e-16 with
        condition numbers up to that, and what lies beyond takes a second pass. Decomposing tens of
        columns takes a tenth of the time of thousands of rows, for which a GPU waits.
        """
        inverses, factors = zip(*map(_inverse_and_factor_of_product, grams), strict=True)
        return cls(inverses, factors)


def _inverse_and_factor(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    lengths = np.linalg.norm(rows, axis=0)
    lengths = np.where(lengths > 0.0, lengths, 1.0)
    size = rows.shape[1]
    shifted = np.concatenate([rows / lengths, _SHIFT * np.eye(size)])
    triangle, order = scipy.linalg.qr(shifted, mode="r", pivoting=True, check_finite=False)
    triangle = triangle[:size]
    inverse, factor = np.empty((2, size, size))
    inverse[order] = scipy.linalg.solve_triangular(triangle, np.eye(size), check_finite=False)
    factor[:, order] = triangle
    return inverse / lengths[:, None], factor * lengths


def _inverse_and_factor_of_product(gram: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    size = len(gram)
    if not np.all(np.isfinite(gram)):
        return np.eye(size), np.eye(size)
    lengths = np.sqrt(np.diag(gram))
    lengths = np.where(lengths > 0.0, lengths, 1.0)
    normalized = gram / lengths[:, None] / lengths
    triangle, pivots, rank, _ = scipy.linalg.lapack.dpstrf(normalized, tol=_LEAST_SQUARE)
    order, triangle = pivots - 1, np.triu(triangle)
    # Not shifted as a whole: what depends on other columns is to vanish up to rounding.
    triangle[rank:] = np.sqrt(_LEAST_SQUARE) * np.eye(size)[rank:]
    inverse, factor = np.empty((2, size, size))
    inverse[order] = scipy.linalg.lapack.dtrtri(triangle)[0]
    factor[:, order] = triangle
    return inverse / lengths[:, None], factor * lengths


def triangles_of(
    preconditioner: Preconditioner, grams: Sequence[Float[np.ndarray, "_ _"]]
) -> tuple[tuple[Float[np.ndarray, "_ _"], ...], Float[np.ndarray, " joints"]]:
    """The triangles of rows whose products behind a preconditioner are `grams`.

    **Returns** the triangles, and for each joint a bound of their error: of the change of the
    rows, by columns, that would explain it, in units of rounding and of the columns' lengths.
    """
    pairs = [
        _triangle_and_error(factor, gram)
        for factor, gram in zip(preconditioner.factors, grams, strict=True)
    ]
    triangles, errors = zip(*pairs, strict=True)
    return triangles, np.array(errors)


def add_up(preconditioner: Preconditioner, grams: Sequence[Float[np.ndarray, "_ _"]]) -> bool:
    """Return whether triangles of such products, and of sums of them, have small errors.

    With all eigenvalues of a Gram matrix of s columns of unit length above a, the bound of
    `triangles_of` is sqrt(s) / a at most; and those of a sum are above the least of its parts. One
    decomposition tells, where the bound and the triangles take a hundred small operations.
    """
    for factor, gram in zip(preconditioner.factors, grams, strict=True):
        if not np.all(np.isfinite(gram)):
            return False
        shifted, _ = _normalized(factor, gram)
        shifted.ravel()[:: len(gram) + 1] -= np.sqrt(len(gram)) / LARGEST_ERROR
        if scipy.linalg.lapack.dpotrf(shifted, lower=1)[1]:
            return False
    return True


def _normalized(factor: np.ndarray, gram: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A Gram matrix of columns of unit length, since a factor's errors do not depend on their
    scale; and the rows of the preconditioner's factor times the lengths."""
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
        columns = np.linalg.norm(half, axis=0)
        columns = np.where(columns > 0.0, columns, 1.0)
        error = change * np.max(np.linalg.norm(directions, axis=0) / columns)
        if error < LARGEST_ERROR:
            return triangle_of(half), float(error)
    values, vectors = np.linalg.eigh(normalized)
    roots = np.sqrt(np.maximum(values, 0.0))
    directions = vectors.T @ directions
    half = roots[:, None] * directions
    # Rounding of the products changes a root by this, and the columns by its part of directions.
    unit = np.finfo(float).eps
    changes = np.minimum(unit / np.maximum(roots, unit), np.sqrt(unit))
    columns = np.linalg.norm(half, axis=0)
    changed = np.linalg.norm(changes[:, None] * directions, axis=0)
    error = np.max(changed / np.where(columns > 0.0, columns, 1.0)) / unit
    return triangle_of(half), float(error)


# Patterns whose factor, of a sample of them, makes the columns of all nearly orthonormal: with 30
# columns, a condition number of about 1.2.
SAMPLE = 4096
# Each factor that is not good enough is the preconditioner of the next.
_PASSES = 3
# Patterns that are expanded into regressor rows at once, and of which a product is formed: on a
# CPU what fits into a core's cache; on a GPU as many such products as keep all of it busy.
_CPU_ROWS, _CPU_PRODUCTS = 2048, 1
_GPU_ROWS, _GPU_PRODUCTS = 1024, 128

Motion = tuple[Array | np.ndarray, ...]


def factors_of(
    network: AbstractLinearNetwork,
    motion: Motion,
    preconditioner: Preconditioner | None = None,
    *,
    kernel: HostKernel | None = None,
) -> tuple[JointFactors, Preconditioner]:
    """The factors of many patterns at the speed of matrix products.

    Cholesky QR behind a preconditioner: rows are multiplied by the inverse of the factor of a
    sample of them, which makes their Gram matrix well conditioned, so that its factor has as
    small an error as Householder's. That is checked by a bound, joint by joint; what fails it is
    factorised again behind the factor that it has led to, and in the end by reflections. (Fukaya
    et al., 'Shifted Cholesky QR for computing the QR factorization of ill-conditioned matrices',
    SIAM J. Sci. Comput. 2020, doi:10.1137/18M1218212; a sample in place of the first pass as of
    Balabanov, 'Randomized Cholesky QR factorizations', 2022, arXiv:2210.09953.)

    **Arguments**

    - `motion`: q, qd, qdd (samples, m), torque and weight (samples, n), on the host or on a
      device; one program is compiled for a number of samples.
    - `preconditioner`: of other patterns like them; of a sample of these if None.
    - `kernel`: computes products of NumPy's arrays in place of JAX.

    **Returns** the factors, NumPy's, and the preconditioner that served.
    """
    if preconditioner is None:
        preconditioner = sample_of(network, motion, kernel)
    numbers = _numbers_behind(network, preconditioner, motion, kernel)
    return _factors_from(network, Products(numbers, preconditioner), motion, kernel)


class Products(NamedTuple):
    """The products of some patterns' rows, and behind what.

    **Attributes**

    - `numbers`: as of `packed_products`.
    - `preconditioner`: of all of them.
    """

    numbers: Float[np.ndarray, " numbers"]
    preconditioner: Preconditioner

    def factors(self, network: AbstractLinearNetwork) -> JointFactors:
        """Return the factors of the patterns, provided that the products `add_up`."""
        *grams, counts = unpacked(network, self.numbers)
        return JointFactors(triangles_of(self.preconditioner, grams)[0], counts)


def part_of(
    network: AbstractLinearNetwork,
    motion: Motion,
    preconditioner: Preconditioner,
    *,
    kernel: HostKernel | None = None,
) -> tuple[Products | JointFactors, Preconditioner]:
    """Return the contribution of patterns to a sum: products if these may be added, else factors.

    The preconditioner that served is returned with it. Arguments are those of `factors_of`.
    """
    products = Products(_numbers_behind(network, preconditioner, motion, kernel), preconditioner)
    *grams, _ = unpacked(network, products.numbers)
    if add_up(preconditioner, grams):
        return products, preconditioner
    return _factors_from(network, products, motion, kernel)


def _numbers_behind(
    network: AbstractLinearNetwork,
    preconditioner: Preconditioner,
    motion: Motion,
    kernel: HostKernel | None,
) -> np.ndarray:
    if kernel is not None:
        motion_of_host: Any = motion
        return packed(kernel.products(preconditioner.inverses, *motion_of_host))
    return np.asarray(_products(network, packed(preconditioner.inverses), *motion))


def _factors_from(
    network: AbstractLinearNetwork, products: Products, motion: Motion, kernel: HostKernel | None
) -> tuple[JointFactors, Preconditioner]:
    """The factors of patterns whose products behind a first preconditioner are there."""

    def products_behind(preconditioner: Preconditioner) -> list[np.ndarray]:
        if preconditioner is products.preconditioner:
            return [products.numbers]
        return [_numbers_behind(network, preconditioner, motion, kernel)]

    def reflected() -> JointFactors:
        arrays = (jnp.asarray(x, float) for x in motion)
        return jax.tree.map(np.asarray, _reflected(network, *arrays))

    return refined(network, products.preconditioner, products_behind, reflected)


def refined(
    network: AbstractLinearNetwork,
    preconditioner: Preconditioner,
    products_behind: Callable[[Preconditioner], Sequence[Float[np.ndarray, " packed"]]],
    reflected: Callable[[], JointFactors],
) -> tuple[JointFactors, Preconditioner]:
    """Factors whose error is small, of one or several sets of patterns, joined.

    - `products_behind`: for each set its `packed_products` behind a preconditioner.
    - `reflected`: the factors by reflections.

    **Returns** the factors, NumPy's, and the preconditioner that served.
    """
    for _ in range(_PASSES):
        parts: list[JointFactors] = []
        largest = 0.0
        for numbers in products_behind(preconditioner):
            *grams, counts = unpacked(network, numbers)
            triangles, errors = triangles_of(preconditioner, grams)
            parts.append(JointFactors(triangles, counts))
            # Rows that are not finite, whose errors are NaN, have no better factors.
            largest = max(largest, float(np.max(np.nan_to_num(errors))))
        factors = joined_factors(parts)
        if largest < LARGEST_ERROR:
            return factors, preconditioner
        preconditioner = Preconditioner.of_rows([np.asarray(x) for x in factors.triangles])
    return reflected(), preconditioner


def sample_of(
    network: AbstractLinearNetwork, motion: Motion, kernel: HostKernel | None = None
) -> Preconditioner:
    """The preconditioner of patterns that are spread over all."""
    # Of the host's arrays the sample alone goes to the device.
    motion = tuple(_spread(x, len(x)) if isinstance(x, np.ndarray) else x for x in motion)
    if kernel is not None:
        motion_of_host: Any = motion
        identities = [np.eye(size) for size in kernel.sizes]
        *grams, _ = kernel.products(identities, *motion_of_host)
        return Preconditioner.of_products(grams)
    on_gpu = platform_of(motion[0]) != "cpu"
    numbers = np.asarray(_sample(network, *motion, on_gpu=on_gpu))
    return Preconditioner.of_products(unpacked(network, numbers))


def sample_products(
    network: AbstractLinearNetwork,
    samples: int,
    *motion: Float[Array, "patterns _"],
    on_gpu: bool,
) -> Float[Array, " packed"]:
    """The products of rows of patterns that are spread over all, packed.

    - `samples`: of all devices together.
    """
    # Behind nothing: where a kernel runs, no other program of the columns is compiled.
    identities = tuple(jnp.eye(len(support) + 1) for support in network.support)
    sample = (_spread(x, samples) for x in motion)
    return packed(gram_matrices(network, identities, *sample, on_gpu=on_gpu))


def _spread(x: Any, samples: int) -> Any:
    return x[:: max(samples // SAMPLE, 1)][:SAMPLE]


def packed(arrays: Sequence[Any]) -> Any:
    """Numbers of several arrays as one: it is copied between host and device as fast as each."""
    return array_namespace(*arrays).concatenate([x.ravel() for x in arrays])


def unpacked(network: AbstractLinearNetwork, numbers: Any) -> list[Any]:
    """Unpack numbers: per joint a matrix (s + 1, s + 1), then the numbers after these, if any."""
    arrays: list[Any] = []
    first = 0
    for support in network.support:
        size = len(support) + 1
        arrays.append(numbers[first : first + size**2].reshape(size, size))
        first += size**2
    return arrays if first == len(numbers) else [*arrays, numbers[first:]]


def packed_products(
    network: AbstractLinearNetwork,
    inverses: Float[Array | np.ndarray, " packed"],
    *motion: Float[Array, "samples _"],
    on_gpu: bool,
) -> Float[Array, " numbers"]:
    """The matrices of `gram_matrices` and the joints' numbers of equations, packed."""
    grams = gram_matrices(network, tuple(unpacked(network, inverses)), *motion, on_gpu=on_gpu)
    counts = jnp.sum(motion[-1] != 0, axis=0).astype(motion[-1].dtype)
    return packed([*grams, counts])


def gram_matrices(
    network: AbstractLinearNetwork,
    inverses: tuple[Float[Array | np.ndarray, "_ _"], ...],
    q: Float[Array, "samples motion"],
    qd: Float[Array, "samples motion"],
    qdd: Float[Array, "samples motion"],
    torque: Float[Array, "samples joints"],
    weight: Float[Array, "samples joints"],
    *,
    on_gpu: bool,
) -> tuple[Float[Array, "_ _"], ...]:
    """Return the products of each joint's weighted rows behind a preconditioner, (s + 1, s + 1).

    Pure, and its memory beyond the arguments is one block of patterns; none where a kernel
    computes columns and their products at once.
    """
    if on_gpu and (kernel := fused_kernel_of(network)) is not None:
        return fused_gram_matrices(kernel, inverses, q, qd, qdd, torque, weight)
    rows, products = (_GPU_ROWS, _GPU_PRODUCTS) if on_gpu else (_CPU_ROWS, _CPU_PRODUCTS)
    samples = len(q)
    products = max(min(products, samples // rows), 1)
    size = products * rows

    def block_of(start: Array) -> tuple[Array, ...]:
        """Reshape (samples, columns) to (products, columns, rows)."""
        return tuple(
            jnp.swapaxes(x.reshape(products, rows, x.shape[1]), 1, 2)
            for x in block_at((q, qd, qdd, torque, weight), start, size)
        )

    def product(*block: Array) -> tuple[Array, ...]:
        return tuple(
            (transformed := transposed @ joint_rows) @ transformed.T
            for transposed, joint_rows in zip(behind, weighted_rows(network, *block), strict=True)
        )

    def step(total: tuple[Array, ...], start: Array) -> tuple[tuple[Array, ...], None]:
        block = block_of(start)
        if products == 1:
            added = product(*(x[0] for x in block))
        else:
            added = jax.tree.map(lambda x: jnp.sum(x, axis=0), jax.vmap(product)(*block))
        return jax.tree.map(jnp.add, total, added), None

    behind = [jnp.asarray(inverse).T for inverse in inverses]
    empty = tuple(jnp.zeros_like(inverse) for inverse in behind)
    return jax.lax.scan(step, empty, jnp.arange(0, max(samples, 1), size))[0]


def block_at(motion: Sequence[Array], start: Array, size: int) -> tuple[Array, ...]:
    """Return `size` patterns from `start` on; patterns behind the end have weight zero."""
    samples = len(motion[0])
    if samples < size:
        motion = [jnp.pad(x, ((0, size - samples), (0, 0))) for x in motion]
    # The last block begins within the one before: its first patterns have been there already.
    first = jnp.minimum(start, max(samples - size, 0))
    *block, weight = (jax.lax.dynamic_slice_in_dim(x, first, size) for x in motion)
    return *block, jnp.where((first + jnp.arange(size) >= start)[:, None], weight, 0.0)


def _products(
    network: AbstractLinearNetwork, inverses: np.ndarray, *motion: Array | np.ndarray
) -> Array:
    arrays = [jnp.asarray(x) for x in motion]
    # Where the patterns are: with a GPU at hand, a caller may still keep to the processor.
    on_gpu = platform_of(arrays[0]) != "cpu"
    return _compiled_products(network, inverses, *arrays, on_gpu=on_gpu)


_compiled_products = eqx.filter_jit(packed_products)
_reflected = eqx.filter_jit(factorise)


@eqx.filter_jit
def _sample(network: AbstractLinearNetwork, *motion: Any, on_gpu: bool) -> Float[Array, " packed"]:
    return sample_products(network, len(motion[0]), *motion, on_gpu=on_gpu)
