"""Launch of the GPU kernel of `_kernel`, and the layout of its arguments and results."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..codegen import kernels_run
from ..network import CSLC, AbstractLinearNetwork
from ._kernel import GramKernel, gram_kernel, tiles_of


# Shared memory of a block that GPUs of compute capability 8.0 and 9.0 have [bytes].
_SHARED = 160_000
# Of an 8 x 4 piece of a matrix that a warp multiplies by: a row and a column for each thread.
_ROW, _COLUMN = np.arange(32) // 4, np.arange(32) % 4


def fused_kernel_of(network: AbstractLinearNetwork) -> GramKernel | None:
    """The kernel that computes and multiplies columns at once; None where it cannot run.

    It needs an NVIDIA GPU with matrix units for float64 and NVIDIA's run-time compiler, and a
    network whose numbers are known. Everything else computes columns, and then multiplies them.
    """
    if not isinstance(network, CSLC) or not network.has_host_columns or not kernels_run():
        return None
    if not network.has_column_entries:
        return None
    kernel = gram_kernel(network)
    return kernel if kernel.kernel.shared_bytes <= _SHARED else None


def fused_gram_matrices(
    kernel: GramKernel,
    inverses: Sequence[Float[Array | np.ndarray, "_ _"]],
    *motion: Float[Array, "samples _"],
) -> tuple[Float[Array, "_ _"], ...]:
    """`gram_matrices` in one kernel: columns stay in a multiprocessor's memory."""
    packed, rows = packed_inverses(kernel.sizes, [jnp.asarray(x) for x in inverses])
    blocks = kernel.resident * int(getattr(jax.devices()[0], "core_count", 108))
    result = jax.ShapeDtypeStruct((blocks, kernel.tiles, 8, 8), jnp.float64)
    count = jnp.full(1, len(motion[0]), jnp.int64)
    (partial,) = kernel.kernel(blocks, [result], *motion, packed, rows, count)
    return unpacked_products(kernel.sizes, jnp.sum(partial, axis=0))


def packed_inverses(
    sizes: Sequence[int], inverses: Sequence[Float[Array, "_ _"]]
) -> tuple[Float[Array, " packed"], Int[Array, " rows"]]:
    """Inverse triangles in the order in which warps read them, and rows in that of their pivots.

    An inverse has the rows of a triangle in another order: row c of it belongs to the column that
    was the pivot of the first entry that is not zero.
    """
    packed: list[Array] = []
    rows: list[Array] = []
    for joint, (size, inverse) in enumerate(zip(sizes, inverses, strict=True)):
        pivot = jnp.argmax(inverse != 0, axis=1)
        wide = -(-size // 8) * 8
        triangle = jnp.zeros((wide, wide)).at[pivot, :size].set(inverse)
        pieces = [(i, k) for i in range(wide // 8) for k in range(2 * i + 2)]
        row = np.array([8 * i + _ROW for i, _ in pieces])
        column = np.array([4 * k + _COLUMN for _, k in pieces])
        packed.append(triangle[column, row].ravel())
        rows.append(pivot + sum(sizes[:joint]))
    return jnp.concatenate(packed), jnp.concatenate(rows).astype(jnp.int32)


def unpacked_products(
    sizes: Sequence[int], tiles: Float[Array, "tiles 8 8"]
) -> tuple[Float[Array, "_ _"], ...]:
    """Symmetric matrices of all joints from the tiles of their lower triangles."""
    matrices: list[Array] = []
    first = 0
    for size in sizes:
        high = -(-size // 8)
        pairs = tiles_of(size)
        index = np.zeros((high, high), int)
        for number, (i, j) in enumerate(pairs):
            index[i, j] = first + number
        blocks = jnp.swapaxes(tiles[index], 1, 2).reshape(8 * high, 8 * high)
        lower = jnp.tril(blocks)
        symmetric = lower + jnp.tril(blocks, -1).T
        matrices.append(symmetric[:size, :size])
        first += len(pairs)
    return tuple(matrices)
