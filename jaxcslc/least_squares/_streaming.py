"""Factors of streams and of long recordings, whose pieces go to all cores or devices."""

import itertools
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._environment import core_count, platform_of
from ..network import AbstractLinearNetwork
from ..recordings import Patterns
from ._correction import residual_sums
from ._factors import JointFactors, joined_factors
from ._host_kernel import HostKernel, host_kernel_of
from ._preconditioned import Preconditioner, Products, factors_of, part_of, sample_of
from ._sharded import factors_of_shards, mesh_of, residual_sums_of_shards


# Patterns that one compiled call takes: large enough that its overhead vanishes.
_CPU_LENGTH, _GPU_LENGTH = 1 << 16, 1 << 21
# Pieces of a GPU's that are on their way or in work at a time, so that transfers overlap with work.
_GPU_WORKERS = 3
# Patterns on a GPU from which on products are quicker than reflections.
_FEWEST_ON_GPU = 1 << 12
# Factors that are kept before they are joined.
_MOST_PARTS = 64


class _Piece(NamedTuple):
    """Patterns that one task takes.

    - `stretches`: of chunks: q, qd, qdd, torque and the two masks of each.
    - `length`: patterns that are to come out of it, those of weight zero at the end included.
    """

    stretches: list[tuple[np.ndarray, ...]]
    length: int

    def motion(self) -> tuple[np.ndarray, ...]:
        """q, qd, qdd, torque, and which pairs count.

        Called by the threads that take pieces: sixteen of them finish one every two milliseconds,
        which is what copies of its masks take alone.
        """
        parts = zip(*self.stretches, strict=True)
        *motion, backlash, friction = (x[0] if len(x) == 1 else np.concatenate(x) for x in parts)
        missing = self.length - len(backlash)
        arrays = *motion, backlash & friction
        return tuple(np.pad(x, ((0, missing), (0, 0))) for x in arrays) if missing else arrays


class _Total:
    """Sum of the pieces that are done.

    Products behind one preconditioner are summed, where they `add_up`; they become factors when a
    piece comes behind another.
    """

    def __init__(self, network: AbstractLinearNetwork) -> None:
        self._network = network
        self._parts: list[JointFactors] = []
        self._products: Products | None = None

    def add(self, part: Products | JointFactors) -> None:
        if isinstance(part, JointFactors):
            self._parts.append(part)
            if len(self._parts) >= _MOST_PARTS:
                self._parts = [joined_factors(self._parts)]
            return
        before = self._products
        if before is not None and before.preconditioner is part.preconditioner:
            part = Products(before.numbers + part.numbers, part.preconditioner)
        elif before is not None:
            self._parts.append(before.factors(self._network))
        self._products = part

    def factors(self) -> JointFactors:
        """Return the factors of all pieces. **Raises** `ValueError` if there were none."""
        of_products = [] if self._products is None else [self._products.factors(self._network)]
        parts = [*self._parts, *of_products]
        if not parts:
            raise ValueError("there are no patterns in the stream")
        return joined_factors(parts)


def factors_of_stream(
    network: AbstractLinearNetwork, chunks: Iterable[Patterns], workers: int | None
) -> JointFactors:
    """The factors of all patterns of a stream, whose pieces go to all devices in turn.

    **Raises** `ValueError` if there are none.
    """
    devices = jax.local_devices()
    on_cpu = devices[0].platform == "cpu"
    kernel = host_kernel_of(network) if on_cpu else None
    workers = workers or (core_count() if on_cpu else _GPU_WORKERS * len(devices))
    total = _Total(network)
    preconditioner: Preconditioner | None = None
    with ThreadPoolExecutor(workers) as pool:
        waiting: deque[Future[tuple[Products | JointFactors, Preconditioner]]] = deque()
        pieces = _regular(network, chunks, _CPU_LENGTH if on_cpu else _GPU_LENGTH)
        for piece, device in zip(pieces, itertools.cycle(devices), strict=False):
            if preconditioner is None:
                motion = _numbers(piece) if kernel is None else piece.motion()
                preconditioner = sample_of(network, motion, kernel)
            if len(waiting) >= 2 * workers:
                part, preconditioner = waiting.popleft().result()
                total.add(part)
            waiting.append(pool.submit(_part_on, device, network, piece, preconditioner, kernel))
        for future in waiting:
            total.add(future.result()[0])
    return total.factors()


def are_many(patterns: Patterns) -> bool:
    """Return whether `factors_of_patterns` pays: products where `factorise` reflects."""
    if mesh_of(patterns.q) is not None:
        return True
    return len(patterns.q) >= (
        2 * _CPU_LENGTH if platform_of(patterns.q) == "cpu" else _FEWEST_ON_GPU
    )


def factors_of_patterns(network: AbstractLinearNetwork, patterns: Patterns) -> JointFactors:
    """The factors of patterns that are in memory: on the host, where all cores share them in
    pieces, on a device, or spread over several."""
    many_on_host = isinstance(patterns.q, np.ndarray) and len(patterns.q) > _GPU_LENGTH
    mesh = mesh_of(patterns.q)
    if many_on_host or (mesh is None and platform_of(patterns.q) == "cpu"):
        return factors_of_stream(network, [patterns], None)
    weight = jnp.asarray(patterns.mask).astype(float)
    motion = (patterns.q, patterns.qd, patterns.qdd, patterns.torque, weight)
    if mesh is not None:
        return factors_of_shards(network, tuple(map(jnp.asarray, motion)), mesh)
    return factors_of(network, jax.device_put(motion))[0]


def residual_sums_of(
    network: AbstractLinearNetwork, patterns: Patterns, k: Float[np.ndarray, " coefficients"]
) -> list[Float[np.ndarray, "2 entries"]]:
    """`residual_sums` of all patterns, where `factors_of_patterns` has factorised them."""
    mesh = mesh_of(patterns.q)
    if mesh is not None or isinstance(patterns.q, jax.Array):
        weight = jnp.asarray(patterns.mask).astype(float)
        motion = (patterns.q, patterns.qd, patterns.qdd, patterns.torque, weight)
        if mesh is not None:
            return list(residual_sums_of_shards(network, k, tuple(map(jnp.asarray, motion)), mesh))
        return [_residual_sums(network, k, jax.device_put(motion))]
    devices = jax.local_devices()
    on_cpu = devices[0].platform == "cpu"
    with ThreadPoolExecutor(core_count() if on_cpu else _GPU_WORKERS * len(devices)) as pool:

        def of_piece(piece: _Piece, device: Any) -> np.ndarray:
            return _residual_sums(network, k, jax.device_put(_numbers(piece), device))

        pieces = _regular(network, [patterns], _CPU_LENGTH if on_cpu else _GPU_LENGTH)
        return list(pool.map(of_piece, pieces, itertools.cycle(devices)))


def _residual_sums(
    network: AbstractLinearNetwork, k: np.ndarray, motion: tuple[Array, ...]
) -> np.ndarray:
    on_gpu = platform_of(motion[0]) != "cpu"
    return np.asarray(_compiled_sums(network, k, *motion, on_gpu=on_gpu))


_compiled_sums: Any = eqx.filter_jit(residual_sums)


def _part_on(
    device: Any,
    network: AbstractLinearNetwork,
    piece: _Piece,
    preconditioner: Preconditioner,
    kernel: HostKernel | None,
) -> tuple[Products | JointFactors, Preconditioner]:
    """Return the contribution of a piece to the total, and the preconditioner that served."""
    motion = piece.motion() if kernel is not None else jax.device_put(_numbers(piece), device)
    return part_of(network, motion, preconditioner, kernel=kernel)


def _numbers(piece: _Piece) -> tuple[np.ndarray, ...]:
    *motion, mask = piece.motion()
    return *motion, mask.astype(float)


def _regular(
    network: AbstractLinearNetwork, chunks: Iterable[Patterns], length: int
) -> Iterator[_Piece]:
    """Cut patterns into pieces of one length, so that one compiled function serves all.

    The last piece is filled up with patterns of weight zero.
    """
    stretches: list[tuple[np.ndarray, ...]] = []
    size = 0
    for chunk in chunks:
        if chunk.joints != network.joint_count:
            raise ValueError(
                f"patterns have {chunk.joints} joints, {network.name!r} has {network.joint_count}"
            )
        motion = (chunk.q, chunk.qd, chunk.qdd, chunk.torque)
        arrays = [np.asarray(x) for x in (*motion, chunk.backlash_mask, chunk.friction_mask)]
        start, samples = 0, len(arrays[0])
        while start < samples:
            end = min(start + length - size, samples)
            stretches.append(tuple(x[start:end] for x in arrays))
            size += end - start
            start = end
            if size == length:
                yield _Piece(stretches, length)
                stretches, size = [], 0
    if size:
        yield _Piece(stretches, length)
