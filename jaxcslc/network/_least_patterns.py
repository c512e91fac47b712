"""The number of patterns that determines all coefficients of a linear network at once.

Read with `AbstractLinearNetwork.least_patterns`, and with `jaxcslc.adaptive.network_order`, the
thesis's measure of one output alone.
"""

import bisect
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from .._rank import numerical_rank


Support = tuple[tuple[int, ...], ...]
Columns = Callable[[Any, Any, Any], Sequence[Any]]

_SEED = 42
# Random motions are tried one after the other: functions that switch, as signs do, are not zero for
# a part of them only, and the best motion counts.
_MOTIONS = 4
# rad and rad/s, or what else the columns of the motion are: far from zero, and within one turn.
_SMALLEST, _LARGEST = 0.2, 3.0
# Formulas need not be real everywhere; this many draws of patterns are made to find enough.
_DRAWS = 50


def least_patterns(columns: Columns, support: Support, motion_count: int) -> int:
    """The least number of patterns whose stacked regressor has the rank that any number has.

    The rank of N patterns is that of random ones: entries are analytic functions of the motion
    apart from switches, so that almost all motions have the highest rank. In any stretch of
    patterns, every column of the motion is as often positive as negative, so that both
    directions of switches occur.

    **Arguments**

    - `columns`: as `AbstractLinearNetwork.columns`, in float64.
    - `support`: for each output, its coefficients.
    - `motion_count`: number of columns of the motion.

    **Raises** `ValueError` for columns that are not finite at random motions.
    """
    # Each output's rank grows with every generic pattern until it is complete.
    enough = max(map(len, support), default=0)
    if not enough:
        return 0
    rng = np.random.default_rng(_SEED)
    motions = [_regressor(columns, support, motion_count, enough, rng) for _ in range(_MOTIONS)]
    rank = max(map(_rank, motions))
    counts = (
        1 + bisect.bisect_left(range(1, enough), rank, key=lambda n, rows=rows: _rank(rows[:n]))
        for rows in motions
        if _rank(rows) == rank
    )
    return min(counts)


def _rank(rows: Float[np.ndarray, "patterns outputs coefficients"]) -> int:
    """The rank of a stacked regressor."""
    return numerical_rank(rows.reshape(-1, rows.shape[-1]))


def _regressor(
    columns: Columns, support: Support, motion_count: int, count: int, rng: np.random.Generator
) -> Float[np.ndarray, "patterns outputs coefficients"]:
    """Regressors of random patterns where they are finite."""
    size = 1 + max(index for row in support for index in row)
    parts: list[Any] = []
    for _ in range(_DRAWS):
        motion = np.ascontiguousarray(_random_motion(count, motion_count, rng))
        values = columns(*motion)
        rows = np.zeros((count, len(support), size))
        for output, (entries, indices) in enumerate(zip(values, support, strict=True)):
            rows[:, output, list(indices)] = np.asarray(entries).T
        parts.append(rows[np.all(np.isfinite(rows), axis=(1, 2))])
        if sum(map(len, parts)) >= count:
            return np.concatenate(parts)[:count]
    raise ValueError("least patterns: the outputs are not finite at random motions")


def _random_motion(
    count: int, motion_count: int, rng: np.random.Generator
) -> Float[np.ndarray, "3 motion patterns"]:
    """q, qd and qdd, of opposite signs in every two patterns that follow each other."""
    shape = (3, motion_count, count)
    signs = rng.choice((-1.0, 1.0), (3, motion_count, (count + 1) // 2))
    signs = np.stack([signs, -signs], axis=-1).reshape(3, motion_count, -1)[..., :count]
    return signs * rng.uniform(_SMALLEST, _LARGEST, shape)
