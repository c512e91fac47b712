"""Regressor columns and torques of patterns, on the host.

NumPy or generated C computes them; of long recordings chunk by chunk, on all cores. Only networks
that cannot do that (`has_host_columns`) are compiled by JAX. `friction_averaged_at_rest` is the
torque of joints that stop and turn back.

A column may be a sum of terms that cancel: of joints that stand still, of parallelograms, of joints
that follow others. What is left is rounding, whose coefficient would be a torque over 1e-16:
`rounding_of` finds these columns, which count as zero.
"""

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import Any, TypeAlias, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from .._environment import array_namespace
from .._processes import over_chunks
from ..network import AbstractLinearNetwork
from ..recordings import Patterns, at_rest, directions_beside, joined_patterns


Result = TypeVar("Result")
HostColumns = tuple[Float[np.ndarray, "_ samples"], ...]

LONG = 1 << 16
"""Samples of a chunk; a recording of more is long. A Panda's columns of as many take 80 MB."""
# Fewest samples that JAX compiles a regressor for.
_FEWEST_ROWS = 4096


def computed_on_host(network: AbstractLinearNetwork, *motion: Any) -> bool:
    """Return whether a motion (samples, columns) is short and needs no compiled program."""
    return network.has_host_columns and all(len(x) <= LONG for x in motion)


def traced(tree: Any) -> bool:
    """Return whether JAX traces some of the arrays."""
    return any(isinstance(x, Tracer) for x in jax.tree.leaves(tree))


def untraced(tree: Any) -> Any:
    """Return the tree with NumPy arrays, unless JAX traces some of them."""
    return tree if traced(tree) else jax.tree.map(np.asarray, tree)


def columns_of(network: AbstractLinearNetwork, patterns: Patterns) -> HostColumns:
    """Return the regressor's columns in each joint's support, (support, samples), on the host."""
    parts = _over_chunks(network, patterns, lambda columns: columns)
    if len(parts) == 1:
        return parts[0]
    return tuple(np.concatenate(of_joint, axis=1) for of_joint in zip(*parts, strict=True))


def regressor_of(
    network: AbstractLinearNetwork, patterns: Patterns
) -> Float[Array | np.ndarray, "samples joints coefficients"]:
    """Return the whole regressor of patterns, on the host unless JAX traces them."""
    motion = (patterns.q, patterns.qd, patterns.qdd)
    if traced((network, motion)):
        return network.regressor(*motion)
    regressor = np.zeros((len(patterns.q), network.joint_count, network.size))
    columns = columns_of(network, patterns)
    for joint, (support, rows) in enumerate(zip(network.support, columns, strict=True)):
        regressor[:, joint, list(support)] = rows.T
    return regressor


def torque_of(
    network: AbstractLinearNetwork,
    patterns: Patterns,
    k: Float[Array | np.ndarray, " coefficients"],
) -> Float[np.ndarray, "samples joints"]:
    """Return the torque that coefficients predict for patterns, on the host."""
    predicted = partial(torque_by, network.support, k=np.asarray(k))
    return np.concatenate(_over_chunks(network, patterns, predicted))


def torque_by(
    support: Sequence[Sequence[int]],
    columns: Sequence[Float[Array | np.ndarray, "_ samples"]],
    k: Float[Array | np.ndarray, " coefficients"],
) -> Any:
    """Return the torque (samples, n) that coefficients predict from the columns of all joints."""
    torque = [k[np.array(some, int)] @ rows for some, rows in zip(support, columns, strict=True)]
    return array_namespace(*torque).stack(torque, axis=1)


def check_joints(network: AbstractLinearNetwork, patterns: Patterns) -> None:
    """**Raises** `ValueError` for patterns of another number of joints."""
    if patterns.joints != network.joint_count:
        raise ValueError(
            f"patterns have {patterns.joints} joints, {network.name!r} has {network.joint_count}"
        )


def masked_rms(
    values: Float[np.ndarray, "samples joints"], mask: Bool[np.ndarray, "samples joints"]
) -> Float[np.ndarray, " joints"]:
    """Return the root mean square of each joint over the samples of a mask; 0 without any."""
    squares = np.sum(np.where(mask, values, 0.0) ** 2, axis=0)
    return np.sqrt(squares / np.maximum(mask.sum(axis=0), 1))


def rows_of(patterns: Patterns, rows: slice) -> Patterns:
    """Return some samples of patterns, on the host."""
    return jax.tree.map(lambda x: np.asarray(x)[rows], patterns)


def _over_chunks(
    network: AbstractLinearNetwork, patterns: Patterns, function: Callable[[HostColumns], Result]
) -> list[Result]:
    """Return the results of a function of the columns of each chunk."""
    motion = [np.asarray(x) for x in (patterns.q, patterns.qd, patterns.qdd)]

    def compute(first: int, last: int) -> Result:
        return function(_columns(network, *(x[first:last] for x in motion)))

    return over_chunks(compute, max(len(motion[0]), 1), LONG)


def _columns(network: AbstractLinearNetwork, *motion: np.ndarray) -> HostColumns:
    if network.has_host_columns:
        columns = network.columns(*(np.ascontiguousarray(x.T) for x in motion))
        return tuple(np.asarray(rows) for rows in columns)
    samples = len(motion[0])
    # Zeros behind the end, so that recordings of similar lengths share one compiled program.
    length = max(_FEWEST_ROWS, 1 << (samples - 1).bit_length())
    filled = (np.pad(x, ((0, length - samples), (0, 0))) for x in motion)
    compiled = _compiled_columns(network, *(jax.device_put(x.T) for x in filled))
    return tuple(np.asarray(rows)[:, :samples] for rows in compiled)


@eqx.filter_jit
def _compiled_columns(network: AbstractLinearNetwork, *motion: Array) -> tuple[Array, ...]:
    return tuple(jnp.asarray(rows) for rows in network.columns(*motion))


Rows = Float[Array | np.ndarray, "samples joints"]

# Of a joint at rest, as a part of its greatest speed: only the sign of it counts.
_REST_SPEED = 1e-12


Selection: TypeAlias = slice | Int[np.ndarray, " some"]
"""Of samples."""


def friction_averaged_at_rest(
    torque: Callable[[Rows, Selection], Rows], qd: Rows, *, sample_by_sample: bool = True
) -> Rows:
    """Torque along a motion; at rest with the mean of the friction before and after.

    While a joint moves, its friction has the direction of its velocity. When it stops, what is left
    of that is anything up to all of it, and before it moves on, friction is that of the new
    direction. Between these, a measured velocity has the sign of its noise, or of a controller's
    creep. So a joint that turns back has none on average, one that goes on has all, and one that
    stands still at the beginning or at the end of a recording has half. Where recordings are
    joined, a rest at the beginning of one follows the motion at the end of the one before.

    `scripts/studies/real_robots/rests.py` compares this with other rules on real arms.

    **Arguments**

    - `torque`: torques [N m or N] as a function of the velocities of some samples, and of which
      these are: indices, or all of them as a slice.
    - `qd`: (samples, n) in order of time [rad/s or m/s].
    - `sample_by_sample`: whether some samples can be computed without the others.

    **Returns** torques (samples, n); those of `torque` itself where no joint is at rest
    (`jaxcslc.recordings.at_rest`).

    >>> import numpy as np
    >>> from jaxcslc.least_squares import friction_averaged_at_rest
    >>> qd = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0])[:, None]
    >>> friction_averaged_at_rest(lambda qd, rows: 2.0 * np.sign(qd), qd)[:, 0].tolist()
    [2.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, -2.0]
    """
    everything = slice(None)
    measured, still = torque(qd, everything), at_rest(qd)
    if not traced(still) and not np.any(still):
        return measured
    xp = array_namespace(measured, qd)
    slow = _REST_SPEED * xp.max(xp.abs(qd), axis=0, keepdims=True)
    velocities = (
        xp.where(still, slow * direction, qd) for direction in directions_beside(qd, still)
    )
    some = xp.any(still, axis=1, keepdims=True)
    if xp is np and sample_by_sample:
        rows = np.flatnonzero(some)
        before, after = (torque(velocity[rows], rows) for velocity in velocities)
        averaged = np.array(measured)
        averaged[rows] = 0.5 * (before + after)
        return averaged
    before, after = (torque(velocity, everything) for velocity in velocities)
    return xp.where(some, 0.5 * (before + after), measured)


# A column that is nowhere smaller than this part of the largest is more than rounding: only others
# are looked into.
_SUSPICIOUS = 1e-9
# Stretches that are looked at: a joint may stand still in some of them.
_STRETCHES = 8
# Samples that rounding is measured at, and by how many units of it motion is changed there.
_SAMPLES, _UNITS = 64, 4.0
_EPSILON = float(np.finfo(float).eps)

Rounding = tuple[tuple[float, ...], ...]
"""For each joint, the root mean square change of each column of its support by rounding."""


def rounding_of(
    network: AbstractLinearNetwork, patterns: Patterns, columns: HostColumns
) -> Rounding | None:
    """Return what rounding of a motion changes columns by; None where all are clearly more.

    Measured: columns of a motion that differs by units of rounding. Positions by those of 1 rad or
    1 m at least, as terms are of that size; velocities and accelerations by what rounding of
    positions makes of them.

    - `columns`: of the patterns.
    """
    if not _any_suspicious(columns):
        return None
    samples = patterns.samples
    some = rows_of(patterns, slice(None, None, max(samples // _SAMPLES, 1)))
    q, qd, qdd = motion = [np.asarray(x) for x in (some.q, some.qd, some.qdd)]
    interval = float(np.median(np.diff(np.asarray(patterns.time)))) if samples > 1 else 1.0
    step = _UNITS * _EPSILON * np.maximum(np.max(np.abs(q), axis=0), 1.0)
    rng = np.random.default_rng(0)  # any signs do, and always the same ones
    changed: list[np.ndarray] = []
    for values, size in ((q, step), (qd, step / interval), (qdd, step / interval**2)):
        # A velocity keeps its sign, which is a column of its own.
        most = np.inf if values is q else 0.5 * np.abs(values)
        changed.append(values + np.minimum(size, most) * rng.choice([-1.0, 1.0], q.shape))
    # Both at once: the time that columns of few samples take does not depend on their number.
    joined = (np.concatenate(pair) for pair in zip(motion, changed, strict=True))
    both = joined_patterns([some, some])
    both = dataclasses.replace(both, **dict(zip(("q", "qd", "qdd"), joined, strict=True)))
    terms = tuple(term.at_any_motion for term in network.terms)
    if any(term is not before for term, before in zip(terms, network.terms, strict=True)):
        network = eqx.tree_at(lambda whole: whole.terms, network, terms)
    halves = (np.split(of_joint, 2, axis=1) for of_joint in columns_of(network, both))
    return tuple(
        tuple(np.sqrt(np.mean((before - after) ** 2, axis=1)).tolist()) for before, after in halves
    )


def _any_suspicious(columns: HostColumns) -> bool:
    """Return whether some column is next to zero somewhere, and not exactly so."""
    sizes = [_sizes(of_joint) for of_joint in columns if of_joint.size]
    largest = max((float(np.max(some)) for some in sizes), default=0.0)
    return any(np.any((some > 0.0) & (some < _SUSPICIOUS * largest)) for some in sizes)


def _sizes(columns: Float[np.ndarray, "support samples"]) -> Float[np.ndarray, "support _"]:
    """Return the root mean square of each column in each stretch."""
    edges = np.unique(np.linspace(0, columns.shape[1], _STRETCHES + 1).astype(int)).tolist()
    parts = (columns[:, first:last] for first, last in pairwise(edges))
    squares = [np.einsum("st,st->s", part, part) / part.shape[1] for part in parts]
    return np.sqrt(np.stack(squares, axis=1))
