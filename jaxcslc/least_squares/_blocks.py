"""Factors of any number of patterns: blocks of them, factorised by all cores or devices and joined.

Streams, long recordings, patterns on a device and patterns spread over devices differ in their
readers of blocks alone. A block's factors come from `_products`.
"""

import itertools
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float

from .._environment import core_count, platform_of
from ..network import AbstractLinearNetwork
from ..recordings import Patterns
from ._columns import LONG, check_joints
from ._equations import equations_of
from ._factors import JointFactors, joined_factors
from ._gpu_kernel import GramKernel
from ._host_kernel import HostKernel
from ._products import (
    Motion,
    Preconditioner,
    factors_of,
    kernel_of,
    residual_sums,
    sample_of,
)


# Patterns of a block: large enough that the overhead of a compiled call vanishes.
_CPU_LENGTH, _GPU_LENGTH = LONG, 1 << 21
# Blocks of a GPU's that are on their way or in work at a time, so that transfers overlap with work.
_GPU_WORKERS = 3
# Patterns on a GPU from which on products are quicker than reflections on the host.
_FEWEST_ON_GPU = 1 << 12
# Factors that are kept before they are joined.
_MOST_PARTS = 64
_AXIS = "patterns"

Block = Callable[[], Motion]
"""Gives some patterns, where they are to be computed. Threads call it, as it may copy them."""


class Blocks(NamedTuple):
    """Blocks of patterns, and how they are factorised.

    **Attributes**

    - `blocks`: read once.
    - `workers`: number of blocks that are factorised at a time.
    - `kernel`: of `kernel_of`.
    - `of_all_processes`: whether every process has read some of the blocks.
    """

    blocks: Iterable[Block]
    workers: int
    kernel: HostKernel | GramKernel | None
    of_all_processes: bool = False


def blocks_of_chunks(
    network: AbstractLinearNetwork, chunks: Iterable[Patterns], workers: int | None = None
) -> Blocks:
    """Read chunks of any size: for all cores, or for all GPUs in turn.

    - `workers`: number of blocks at a time; by default one a core, or three a GPU.
    """
    devices = jax.local_devices()
    kernel = kernel_of(network, devices[0].platform)
    on_gpu = isinstance(kernel, GramKernel)
    workers = workers or (_GPU_WORKERS * len(devices) if on_gpu else core_count())
    targets = itertools.cycle(devices if on_gpu else [None])
    pieces = _regular(network, chunks, _GPU_LENGTH if on_gpu else _CPU_LENGTH)
    blocks = (partial(_loaded, *piece, device=next(targets)) for piece in pieces)
    return Blocks(blocks, workers, kernel)


def blocks_of_patterns(network: AbstractLinearNetwork, patterns: Patterns) -> Blocks:
    """Read patterns that are in memory: of the host, of a GPU, or of several devices."""
    spread = _are_spread(patterns.q)
    if not spread and (isinstance(patterns.q, np.ndarray) or platform_of(patterns.q) == "cpu"):
        return blocks_of_chunks(network, [patterns])
    kernel = kernel_of(network, platform_of(patterns.q))
    motion: Any = (patterns.q, patterns.qd, patterns.qdd, patterns.torque, patterns.mask)
    if not spread:
        return Blocks([lambda: jax.device_put(motion)], 1, kernel)
    shards = [{x.device: x.data for x in of_all.addressable_shards} for of_all in motion]
    blocks = [partial(tuple, [x[device] for x in shards]) for device in shards[0]]
    return Blocks(blocks, len(blocks), kernel, not motion[0].is_fully_addressable)


def factors_of_blocks(network: AbstractLinearNetwork, read: Blocks) -> JointFactors:
    """Return the factors of all blocks, joined.

    A block's preconditioner is that of the latest block that is done; of the first, its own.

    **Raises** `ValueError` if there are no blocks.
    """
    parts: list[JointFactors] = []
    preconditioner: Preconditioner | None = None
    with ThreadPoolExecutor(read.workers) as pool:
        waiting: deque[Future[tuple[JointFactors, Preconditioner | None]]] = deque()
        for block in read.blocks:
            if preconditioner is None and read.kernel is not None:
                preconditioner = sample_of(block(), read.kernel)
            if len(waiting) >= 2 * read.workers:
                part, preconditioner = waiting.popleft().result()
                parts.append(part)
            if len(parts) >= _MOST_PARTS:
                parts = [joined_factors(parts)]
            factorise = lambda block, last: factors_of(network, block(), read.kernel, last)
            waiting.append(pool.submit(factorise, block, preconditioner))
        parts += [future.result()[0] for future in waiting]
    if not parts:
        raise ValueError("there are no patterns in the stream")
    return joined_factors(_of_all_processes(joined_factors(parts), read))


def residual_sums_of_blocks(
    network: AbstractLinearNetwork, read: Blocks, k: Float[np.ndarray, " coefficients"]
) -> Float[np.ndarray, "blocks 2 entries"]:
    """Return `residual_sums` of each block."""

    def of_block(block: Block) -> np.ndarray:
        motion = jax.device_put(block())
        on_gpu = platform_of(motion[0]) != "cpu"
        return np.asarray(_residual_sums(network, k, *motion, on_gpu=on_gpu))

    with ThreadPoolExecutor(read.workers) as pool:
        sums = np.stack([*pool.map(of_block, read.blocks)])
    return np.concatenate(_of_all_processes(sums, read))


def are_many(patterns: Patterns) -> bool:
    """Return whether to factorise in blocks: what is long, or on devices."""
    least = LONG + 1
    if isinstance(patterns.q, jax.Array) and platform_of(patterns.q) != "cpu":
        least = _FEWEST_ON_GPU
    return _are_spread(patterns.q) or len(patterns.q) >= least


def pattern_factors(network: AbstractLinearNetwork, patterns: Patterns) -> JointFactors:
    """Return the factors of all pairs that count, in blocks if they are many."""
    if are_many(patterns):
        return factors_of_blocks(network, blocks_of_patterns(network, patterns))
    return equations_of(network, patterns, None).factors()


def shard_patterns(patterns: Patterns) -> Patterns:
    """Spread patterns over all devices, for `LeastSquares(errors="independent").fit`.

    Each device then factorises its patterns, and their triangles are joined. Under
    `jax.distributed`, every process calls this with the patterns that it has read, as many as
    the others have, and `fit` gives every process the fit of all.

    **Arguments**

    - `patterns`: (samples, n); those of this process. Filled up with patterns outside of the
      mask to a multiple of this process's devices.

    **Returns** the same patterns, as JAX's arrays, sharded along samples.

    >>> import jaxcslc as jc
    >>> network = jc.derive(jc.examples.turntable())
    >>> patterns = jc.examples.swing(network, [0.5, 0.2, 0.05], samples=30)
    >>> sharded = jc.least_squares.shard_patterns(patterns)
    >>> sharded.q.sharding.spec[0], int(sharded.mask.sum())
    ('patterns', 30)
    """
    sharding = NamedSharding(Mesh(np.array(jax.devices()), (_AXIS,)), PartitionSpec(_AXIS))
    missing = -len(patterns.q) % jax.local_device_count()

    def spread(x: Array | np.ndarray) -> Array:
        x = np.pad(np.asarray(x), [(0, missing)] + [(0, 0)] * (x.ndim - 1))
        return jax.make_array_from_process_local_data(sharding, x)

    return jax.tree.map(spread, patterns)


def _are_spread(x: Array | np.ndarray) -> bool:
    return isinstance(x, jax.Array) and len(x.sharding.device_set) > 1


_residual_sums: Any = eqx.filter_jit(residual_sums)


def _of_all_processes(x: Any, read: Blocks) -> list[Any]:
    """Return what each process has of a tree of arrays."""
    if not read.of_all_processes:
        return [x]
    gathered = multihost_utils.process_allgather(x)
    return [jax.tree.map(lambda x, i=i: x[i], gathered) for i in range(jax.process_count())]


def _loaded(stretches: list[tuple[np.ndarray, ...]], length: int, *, device: Any) -> Motion:
    """Return the patterns of stretches: q, qd, qdd, torque, and which pairs count.

    - `stretches`: of chunks: q, qd, qdd, torque and the two masks of each.
    - `length`: patterns that are to come out of it, those that do not count included.
    - `device`: that they go to, or None.
    """
    parts = zip(*stretches, strict=True)
    *motion, backlash, friction = (x[0] if len(x) == 1 else np.concatenate(x) for x in parts)
    missing = length - len(backlash)
    arrays = *motion, backlash & friction
    if missing:
        arrays = tuple(np.pad(x, ((0, missing), (0, 0))) for x in arrays)
    return arrays if device is None else jax.device_put(arrays, device)


def _regular(
    network: AbstractLinearNetwork, chunks: Iterable[Patterns], length: int
) -> Iterator[tuple[list[tuple[np.ndarray, ...]], int]]:
    """Cut chunks into stretches of blocks of one length, so that one compiled function serves all.

    The last block is filled up with patterns that do not count.
    """
    stretches: list[tuple[np.ndarray, ...]] = []
    size = 0
    for chunk in chunks:
        check_joints(network, chunk)
        motion = (chunk.q, chunk.qd, chunk.qdd, chunk.torque)
        arrays = [np.asarray(x) for x in (*motion, chunk.backlash_mask, chunk.friction_mask)]
        start, samples = 0, len(arrays[0])
        while start < samples:
            end = min(start + length - size, samples)
            stretches.append(tuple(x[start:end] for x in arrays))
            size += end - start
            start = end
            if size == length:
                yield stretches, length
                stretches, size = [], 0
    if size:
        yield stretches, length
