"""Regressor columns and predicted torques of patterns, by NumPy or by compiled functions.

Short recordings are computed by NumPy, which needs no compilation.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from .._environment import array_namespace
from ..network import AbstractLinearNetwork
from ..recordings import Patterns


HostColumns = tuple[Float[np.ndarray, "_ samples"], ...]
# Tracing a network takes longer than computing this many patterns with it.
_FEWEST_ROWS = 4096
_DOUBLED = 1 << 16
# Samples whose regressor NumPy computes at once.
_HOST_BLOCK = 4096
# More samples are worth a compiled program.
_HOST_SAMPLES = 1 << 16
# Entries of a regressor that are computed at once, and of how many one is split.
_ENTRIES, _MOST_ENTRIES = 1 << 23, 1 << 25


def filled_up(
    x: Float[Array | np.ndarray, "samples columns"], least: int = 0
) -> Float[Array, "rows columns"]:
    """Zero rows behind the end, to the next power of two or multiple of 65,536.

    So that recordings of similar lengths share one compiled function. Zeros are patterns of
    weight zero, or are cut off again.

    - `least`: rows.
    """
    rows = max(_FEWEST_ROWS, least, 1 << (x.shape[0] - 1).bit_length())
    if rows > _DOUBLED:  # long recordings are seldom compiled for, and doubling takes memory
        rows = -(-x.shape[0] // _DOUBLED) * _DOUBLED
    widths = ((0, rows - x.shape[0]), (0, 0))
    # NumPy's own arrays are filled up by NumPy: nothing to compile, as `jnp.asarray` would.
    return jax.device_put(np.pad(x, widths)) if isinstance(x, np.ndarray) else jnp.pad(x, widths)


def computed_on_host(network: AbstractLinearNetwork, *motion: Any) -> bool:
    """Return whether NumPy computes the regressor of a motion, arrays (samples, columns).

    Compiling a network takes seconds, in which NumPy computes some hundred thousand patterns. A
    compiled regressor of a long recording is twice as fast on one core, and runs on all of them.
    """
    on_host = all(isinstance(x, np.ndarray) and len(x) <= _HOST_SAMPLES for x in motion)
    return on_host and network.has_host_columns


def traced(tree: Any) -> bool:
    """Return whether JAX traces some of the arrays."""
    return any(isinstance(x, Tracer) for x in jax.tree.leaves(tree))


def untraced(tree: Any) -> Any:
    """Return the tree with NumPy arrays, unless JAX traces some of them."""
    return tree if traced(tree) else jax.tree.map(np.asarray, tree)


def on_host(tree: Any) -> bool:
    """Return whether all arrays are NumPy's, so that nothing needs to be compiled."""
    return array_namespace(*jax.tree.leaves(tree)) is np


def regressor_of(
    network: AbstractLinearNetwork, patterns: Patterns, least: int = 0
) -> Float[Array | np.ndarray, "samples joints coefficients"]:
    """The regressor of patterns: by NumPy, or compiled once for all recordings of similar lengths.

    - `least`: rows that are compiled for.
    """
    motion = (patterns.q, patterns.qd, patterns.qdd)
    if computed_on_host(network, *motion):
        return _host_regressor(network, *motion)
    q, qd, qdd = (filled_up(x, least) for x in motion)
    filled = _regressor(network, q, qd, qdd)
    # NumPy's slice shares the memory; JAX's is a program to compile for each number of samples.
    rows = filled if isinstance(filled, Tracer) else np.asarray(filled)
    return rows[: len(patterns.q)]


def columns_of(network: AbstractLinearNetwork, patterns: Patterns, least: int = 0) -> HostColumns:
    """The regressor of patterns without what is always zero: for each joint the columns of its
    support, (support, samples); on the host.

    - `least`: rows that are compiled for.
    """
    motion = (patterns.q, patterns.qd, patterns.qdd)
    if computed_on_host(network, *motion):
        return _host_columns(network, *motion)
    return columns_in(network.support, np.asarray(regressor_of(network, patterns, least)))


def columns_in(
    support: Sequence[Sequence[int]], regressor: Float[np.ndarray, "samples joints coefficients"]
) -> HostColumns:
    """Return the columns of a regressor in each joint's support: per joint, (support, samples)."""
    return tuple(regressor[:, joint, list(some)].T for joint, some in enumerate(support))


def torque_by(
    support: Sequence[Sequence[int]],
    columns: HostColumns,
    k: Float[np.ndarray, " coefficients"],
) -> Float[np.ndarray, "samples joints"]:
    """Return the torque that coefficients predict from the columns of all joints."""
    joints = zip(support, columns, strict=True)
    return np.stack([k[list(some)] @ rows for some, rows in joints], axis=1)


def stretch_length(network: AbstractLinearNetwork, samples: int) -> int:
    """Samples whose regressor is computed at once: all of them, or as many as are a stretch of a
    long recording."""
    row = max(network.joint_count * network.size, 1)
    if samples * row <= _MOST_ENTRIES:
        return samples
    return max(1 << (max(_ENTRIES // row, 1).bit_length() - 1), _FEWEST_ROWS)


def stretches_of(network: AbstractLinearNetwork, samples: int) -> list[slice]:
    """The stretches of a recording, all of one length but the last."""
    length = max(stretch_length(network, samples), 1)
    return [slice(start, min(start + length, samples)) for start in range(0, samples, length)]


def torque_of(
    network: AbstractLinearNetwork,
    patterns: Patterns,
    k: Float[Array | np.ndarray, " coefficients"],
) -> Float[np.ndarray, "samples joints"]:
    """Return the torque that coefficients predict for patterns; computed on the host."""
    k, samples = np.asarray(k), len(patterns.q)
    motion = (patterns.q, patterns.qd, patterns.qdd)
    if computed_on_host(network, *motion):
        return torque_by(network.support, _host_columns(network, *motion), k)
    if samples > _HOST_SAMPLES:
        starts = range(0, samples, _HOST_SAMPLES)
        pieces = (rows_of(patterns, slice(start, start + _HOST_SAMPLES)) for start in starts)
        return np.concatenate([_compiled_torque(network, k, piece) for piece in pieces])
    return _compiled_torque(network, k, patterns)


def rows_of(patterns: Patterns, rows: slice) -> Patterns:
    """Return some samples of patterns."""
    return Patterns(
        *(
            np.asarray(values)[rows]
            for values in (
                *(patterns.time, patterns.q, patterns.qd, patterns.qdd, patterns.torque),
                *(patterns.backlash_mask, patterns.friction_mask),
            )
        )
    )


def _host_columns(network: AbstractLinearNetwork, *motion: Any) -> HostColumns:
    columns = network.columns(*(np.ascontiguousarray(np.asarray(x).T) for x in motion))
    return tuple(np.asarray(rows) for rows in columns)


def _host_regressor(
    network: AbstractLinearNetwork, *motion: Any
) -> Float[np.ndarray, "samples joints coefficients"]:
    samples = len(motion[0])
    regressor = np.zeros((samples, network.joint_count, network.size))
    supports = [np.array(support, int) for support in network.support]
    # Columns are turned into rows while they are in the processor's cache.
    for start in range(0, samples, _HOST_BLOCK):
        block = slice(start, start + _HOST_BLOCK)
        columns = _host_columns(network, *(x[block] for x in motion))
        for joint, (support, rows) in enumerate(zip(supports, columns, strict=True)):
            regressor[block, joint, support] = rows.T
    return regressor


@eqx.filter_jit
def _regressor(network: AbstractLinearNetwork, q: Array, qd: Array, qdd: Array) -> Array:
    return network.regressor(q, qd, qdd)


def _compiled_torque(
    network: AbstractLinearNetwork, k: Float[np.ndarray, " coefficients"], patterns: Patterns
) -> Float[np.ndarray, "samples joints"]:
    q, qd, qdd = (filled_up(x) for x in (patterns.q, patterns.qd, patterns.qdd))
    return np.asarray(_torque(network, k, q, qd, qdd))[: len(patterns.q)]


@eqx.filter_jit
def _torque(network: AbstractLinearNetwork, k: Any, q: Array, qd: Array, qdd: Array) -> Array:
    return network.torque(k, q, qd, qdd)
