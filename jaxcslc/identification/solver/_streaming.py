import os
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...motion import Patterns
from ...network import AbstractLinearNetwork
from ._factors import JointFactors, factorise


# Patterns that one compiled call takes: large enough that its overhead vanishes.
_CHUNK = 65_536


def factors_of_stream(
    network: AbstractLinearNetwork, chunks: Iterable[Patterns], workers: int | None
) -> JointFactors:
    """The factors of all patterns of a stream.

    **Raises** `ValueError` if there are none.
    """
    workers = workers or os.cpu_count() or 1
    total: JointFactors | None = None
    with ThreadPoolExecutor(workers) as pool:
        waiting: list[Future[JointFactors]] = []
        for piece in _regular(network, chunks):
            if len(waiting) >= 2 * workers:
                total = _joined(total, waiting.pop(0).result())
            waiting.append(pool.submit(_factors_of, network, piece))
        for future in waiting:
            total = _joined(total, future.result())
    if total is None:
        raise ValueError("there are no patterns in the stream")
    return total


_Piece = tuple[Float[np.ndarray, "samples _"], ...]


def _regular(network: AbstractLinearNetwork, chunks: Iterable[Patterns]) -> Iterator[_Piece]:
    """The same patterns in pieces of one size, so that one compiled function serves all.

    The last piece is filled up with patterns of weight zero.
    """
    waiting: list[_Piece] = []
    size = 0
    for chunk in chunks:
        if chunk.joints != network.joint_count:
            raise ValueError(
                f"patterns have {chunk.joints} joints, {network.name!r} has {network.joint_count}"
            )
        weight = np.asarray(chunk.mask, dtype=float)
        arrays = (chunk.q, chunk.qd, chunk.qdd, chunk.torque)
        waiting.append((*(np.asarray(x) for x in arrays), weight))
        size += len(weight)
        while size >= _CHUNK:
            joined = tuple(np.concatenate(parts) for parts in zip(*waiting, strict=True))
            yield tuple(x[:_CHUNK] for x in joined)
            waiting = [tuple(x[_CHUNK:] for x in joined)]
            size -= _CHUNK
    if size:
        joined = tuple(np.concatenate(parts) for parts in zip(*waiting, strict=True))
        yield tuple(np.pad(x, ((0, _CHUNK - size), (0, 0))) for x in joined)


def _factors_of(network: AbstractLinearNetwork, piece: _Piece) -> JointFactors:
    return jax.block_until_ready(_factorise(network, *(jnp.asarray(x) for x in piece)))


@eqx.filter_jit
def _factorise(
    network: AbstractLinearNetwork, q: Array, qd: Array, qdd: Array, torque: Array, weight: Array
):
    return factorise(network, q, qd, qdd, torque, weight)


@eqx.filter_jit
def _join(one: JointFactors, other: JointFactors) -> JointFactors:
    return one.joined(other)


def _joined(total: JointFactors | None, more: JointFactors) -> JointFactors:
    return more if total is None else _join(total, more)
