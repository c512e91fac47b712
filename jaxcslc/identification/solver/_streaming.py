import os
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...motion import Patterns
from ...network import CSLC
from ._factors import JointFactors, factorise
from ._identification import Identification
from ._least_squares import JointWeights, fit_factors


# Patterns that one compiled call takes: large enough that its overhead vanishes.
_CHUNK = 65_536


def least_squares_stream(
    network: CSLC,
    chunks: Iterable[Patterns],
    *,
    joint_weights: JointWeights = "equal",
    rcond: float | None = None,
    throw: bool = True,
    workers: int | None = None,
) -> Identification:
    """`least_squares` over patterns that arrive in pieces, in memory that does not grow.

    Every piece is factorised and joined to the triangles of those before, so the result is
    that of all patterns at once (an orthogonal factorisation, never the normal equations).

    **Arguments**

    - `chunks`: patterns in pieces of any size, for instance from
      `jaxcslc.motion.iterate_recording`.
    - `workers`: how many pieces to factorise at a time; one a core by default. The result does
      not depend on which worker took which piece beyond rounding.
    - the others: as of `least_squares`.

    **Returns** an `Identification`, its standard errors for independent errors: correlation would
    need a second pass over what has gone by.

    **Raises** as `least_squares`; and `ValueError` if there are no patterns at all.

    >>> import jax.numpy as jnp, numpy as np, jaxcslc as jc
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(arm, lengths="numeric")
    >>> t = np.linspace(0, 5, 500)[:, None]
    >>> q, qd, qdd = np.sin(t), np.cos(t), -np.sin(t)
    >>> k = jnp.array([0.5, 0.2, 0.05])
    >>> everything = np.ones(t.shape, bool)
    >>> torque = network.torque(k, q, qd, qdd)
    >>> patterns = jc.Patterns(t[:, 0], q, qd, qdd, torque, everything, everything)
    >>> pieces = (patterns.between(start, start + 1.0) for start in np.arange(0.0, 6.0))
    >>> bool(jnp.allclose(jc.least_squares_stream(network, pieces).k, k))
    True
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
        raise ValueError("least_squares_stream: there are no patterns in the stream")
    return fit_factors(network, total, joint_weights=joint_weights, rcond=rcond, throw=throw)


_Piece = tuple[Float[np.ndarray, "samples joints"], ...]


def _regular(network: CSLC, chunks: Iterable[Patterns]) -> Iterator[_Piece]:
    """The same patterns in pieces of one size, so that one compiled function serves all.

    The last piece is filled up with patterns of weight zero.
    """
    held: list[_Piece] = []
    size = 0
    for chunk in chunks:
        if chunk.q.shape[-1] != network.joint_count:
            raise ValueError(
                f"patterns have {chunk.q.shape[-1]} joints, {network.robot.name!r} has"
                f" {network.joint_count}"
            )
        weight = np.asarray(chunk.mask, dtype=float)
        arrays = (chunk.q, chunk.qd, chunk.qdd, chunk.torque)
        held.append((*(np.asarray(x) for x in arrays), weight))
        size += len(weight)
        while size >= _CHUNK:
            joined = tuple(np.concatenate(parts) for parts in zip(*held, strict=True))
            yield tuple(x[:_CHUNK] for x in joined)
            held = [tuple(x[_CHUNK:] for x in joined)]
            size -= _CHUNK
    if size:
        joined = tuple(np.concatenate(parts) for parts in zip(*held, strict=True))
        yield tuple(np.pad(x, ((0, _CHUNK - size), (0, 0))) for x in joined)


def _factors_of(network: CSLC, piece: _Piece) -> JointFactors:
    return jax.block_until_ready(_factorise(network, *(jnp.asarray(x) for x in piece)))


@eqx.filter_jit
def _factorise(network: CSLC, q: Array, qd: Array, qdd: Array, torque: Array, weight: Array):
    return factorise(network, q, qd, qdd, torque, weight)


@eqx.filter_jit
def _join(one: JointFactors, other: JointFactors) -> JointFactors:
    return one.joined(other)


def _joined(total: JointFactors | None, more: JointFactors) -> JointFactors:
    return more if total is None else _join(total, more)
