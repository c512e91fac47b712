"""Rounding of regressor columns, so that columns of nothing else count as zero.

A column may be a sum of terms that cancel: of joints that stand still, of parallelograms, of joints
that follow others. What is left is rounding, whose coefficient would be a torque over 1e-16.
"""

import dataclasses

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ..network import AbstractLinearNetwork
from ..recordings import Patterns, joined_patterns
from ._columns import HostColumns, columns_of, rows_of


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
    edges = np.unique(np.linspace(0, columns.shape[1], _STRETCHES + 1).astype(int))[:-1]
    lengths = np.diff(np.append(edges, columns.shape[1]))
    return np.sqrt(np.add.reduceat(columns**2, edges, axis=1) / lengths)
