"""Equations of a recording, by joint.

`Equations` are rows of regressor columns and torque, as recorded or as a parallel filter has made
them. `WeightedEquations` are linear in changes of them.
"""

import dataclasses
from collections.abc import Collection, Sequence
from functools import reduce

import numpy as np
from jaxtyping import Bool, Float, Int

from ..network import AbstractLinearNetwork
from ..recordings import (
    UNIFORM_TO,
    Patterns,
    decimated_low_pass,
    parallel_filter,
    samples_kept,
    uniform_interval,
)
from ._columns import LONG, HostColumns, columns_of, rounding_of, rows_of
from ._factors import JointFactors, Unknowns, joined_factors


# Samples that a recording has at least.
_FEWEST = 20
# Periods of its cut-off after which the zero-phase filter has forgotten to ten digits: its slowest
# pole, of a Butterworth filter of order four, decays by exp(-2 pi 0.38) in each.
_MEMORY = 10.0


@dataclasses.dataclass(frozen=True, eq=False)
class Equations:
    """Equations of a recording in the columns of each joint, and where in it they belong.

    **Attributes**

    - `unknowns`: the coefficients.
    - `rows`: for each joint (rows, s + 1), its s coefficients' columns and the torque.
    - `sample`: for each joint, the sample that each row belongs to.
    """

    unknowns: Unknowns
    rows: tuple[Float[np.ndarray, "_ _"], ...]
    sample: tuple[Int[np.ndarray, " _"], ...]

    @classmethod
    def of(
        cls,
        unknowns: Unknowns,
        regressor: Float[np.ndarray, "samples joints coefficients"],
        torque: Float[np.ndarray, "samples joints"],
        mask: Bool[np.ndarray, "samples joints"],
        *,
        time: Float[np.ndarray, " samples"],
        cutoff: float | None,
    ) -> "Equations":
        """Return the equations of a whole regressor; arguments as of `from_columns`."""
        joints = enumerate(unknowns.support)
        columns = tuple(regressor[:, joint, list(some)].T for joint, some in joints)
        return cls.from_columns(unknowns, columns, torque, mask, time=time, cutoff=cutoff)

    @classmethod
    def from_columns(
        cls,
        unknowns: Unknowns,
        columns: HostColumns,
        torque: Float[np.ndarray, "samples joints"],
        mask: Bool[np.ndarray, "samples joints"],
        *,
        time: Float[np.ndarray, " samples"],
        cutoff: float | None,
        kept: Int[np.ndarray, " kept"] | None = None,
    ) -> "Equations":
        """Return the equations of the pairs that count, or a parallel filter's of them.

        - `columns`: of the regressor, for each joint those of its support.
        - `kept`: samples that the filter keeps; by default every so many.
        """
        interval = None if cutoff is None else uniform_interval(time)
        rows: list[np.ndarray] = []
        samples: list[np.ndarray] = []
        for joint_columns, right, counts in zip(columns, torque.T, mask.T, strict=True):
            if cutoff is None or interval is None:
                sample = np.flatnonzero(counts)
                sides = np.empty((len(joint_columns) + 1, sample.size))
                # Indices that exist need no check, which takes as long as to copy the rows.
                np.take(joint_columns, sample, axis=1, out=sides[:-1], mode="clip")
                np.take(right, sample, out=sides[-1], mode="clip")
                rows.append(sides.T)
            else:
                filtered = parallel_filter(
                    joint_columns, right, counts, interval=interval, cutoff=cutoff, kept=kept
                )
                rows.append(np.column_stack([filtered.regressor, filtered.torque]))
                sample = filtered.sample
            samples.append(sample)
        return cls(unknowns, tuple(rows), tuple(samples))

    def without(self, indices: Collection[int]) -> "Equations":
        """Return the equations with the columns of the given coefficients set to zero."""
        kept = ([*(i not in indices for i in support), True] for support in self.unknowns.support)
        rows = (rows * np.array(factor) for rows, factor in zip(self.rows, kept, strict=True))
        return Equations(self.unknowns, tuple(rows), self.sample)

    def times(self, roots: Sequence[Float[np.ndarray, " _"]]) -> "Equations":
        """Return the equations multiplied by factors: per joint, one factor per equation."""
        if all(np.all(root == 1.0) for root in roots):
            return self
        rows = (rows * root[:, None] for rows, root in zip(self.rows, roots, strict=True))
        return Equations(self.unknowns, tuple(rows), self.sample)

    def errors(self, k: Float[np.ndarray, " unknowns"]) -> list[np.ndarray]:
        """Return the errors that `k` leaves in the equations, per joint."""
        return [
            rows[:, -1] - rows[:, :-1] @ k[list(support)]
            for support, rows in zip(self.unknowns.support, self.rows, strict=True)
        ]

    def counts(self) -> Float[np.ndarray, " joints"]:
        """Return the number of each joint's equations."""
        return np.array([float(len(rows)) for rows in self.rows])

    def torque_scale(self) -> Float[np.ndarray, " joints"]:
        """Return the root mean square torque of each joint's equations; 0 of none."""
        squares = [float(rows[:, -1] @ rows[:, -1]) / max(len(rows), 1) for rows in self.rows]
        return np.sqrt(squares)

    def instants(self) -> tuple[Int[np.ndarray, " instants"], list[Int[np.ndarray, " _"]]]:
        """Return the samples of all equations in ascending order, and for each joint which of them
        its equations belong to.
        """
        kept = np.unique(np.concatenate(self.sample))
        return kept, [np.searchsorted(kept, sample) for sample in self.sample]

    def followed_by(self, other: "Equations", after: int) -> "Equations":
        """Return both sets of equations, the other's recording `after` samples later."""
        return Equations(
            self.unknowns.with_larger_rounding(other.unknowns),
            tuple(np.concatenate(rows) for rows in zip(self.rows, other.rows, strict=True)),
            tuple(
                np.concatenate([mine, after + theirs])
                for mine, theirs in zip(self.sample, other.sample, strict=True)
            ),
        )

    def with_columns(self, inputs: Sequence[Float[np.ndarray, "_ _"]]) -> "Equations":
        """Equations with further unknowns behind the others.

        - `inputs`: of the further unknowns, for each joint's equations.
        """
        unknowns = self.unknowns.with_further([columns.shape[1] for columns in inputs])
        rows = (
            np.concatenate([joint_rows[:, :-1], columns, joint_rows[:, -1:]], axis=1)
            for joint_rows, columns in zip(self.rows, inputs, strict=True)
        )
        return Equations(unknowns, tuple(rows), self.sample)

    def with_torque(
        self, torque: Float[np.ndarray, "samples joints"], patterns: Patterns, cutoff: float | None
    ) -> "Equations":
        """Return equations with the same left-hand sides and other torques.

        - `patterns`, `cutoff`: that the equations were made of.
        """
        right = self.inputs([column[:, None] for column in torque.T], patterns, cutoff)
        rows = (
            np.concatenate([joint_rows[:, :-1], column], axis=1)
            for joint_rows, column in zip(self.rows, right, strict=True)
        )
        return Equations(self.unknowns, tuple(rows), self.sample)

    def inputs(
        self,
        values: Sequence[Float[np.ndarray, "samples _"]],
        patterns: Patterns,
        cutoff: float | None,
    ) -> list[Float[np.ndarray, "_ _"]]:
        """Return each joint's values, given at all samples, as they enter its equations.

        - `patterns`, `cutoff`: that the equations were made of.
        """
        pairs = zip(values, self.sample, np.asarray(patterns.mask).T, strict=True)
        if cutoff is None:
            return [columns[sample] for columns, sample, _ in pairs]
        interval = uniform_interval(np.asarray(patterns.time))
        return [
            decimated_low_pass(np.where(counts, columns.T, 0.0), sample, interval, cutoff=cutoff).T
            for columns, sample, counts in pairs
        ]

    def factors(self) -> JointFactors:
        """Return the factors of all equations."""
        return JointFactors.from_rows(self.rows, self.counts())

    def factors_of_folds(self, fold: Int[np.ndarray, " samples"], folds: int) -> JointFactors:
        """Return the factors of each fold by itself, all arrays with a leading axis of folds."""
        rows: list[np.ndarray] = []
        counts: list[np.ndarray] = []
        for all_rows, sample in zip(self.rows, self.sample, strict=True):
            of_rows = fold[sample]
            parts = [all_rows[samples_of(of_rows, number)] for number in range(folds)]
            padded = np.zeros((folds, max(map(len, parts)), all_rows.shape[1]))
            for filled, part in zip(padded, parts, strict=True):
                filled[: len(part)] = part
            rows.append(padded)
            counts.append(np.array([float(len(part)) for part in parts]))
        return JointFactors.from_rows(tuple(rows), np.stack(counts, axis=-1))

    def selected(self, mask: Bool[np.ndarray, " samples"]) -> "Equations":
        """Return the equations of some samples."""
        kept = [mask[sample] for sample in self.sample]
        return Equations(
            self.unknowns,
            tuple(rows[counts] for rows, counts in zip(self.rows, kept, strict=True)),
            tuple(sample[counts] for sample, counts in zip(self.sample, kept, strict=True)),
        )


def samples_of(
    fold: Int[np.ndarray, " samples"], number: int
) -> slice | Int[np.ndarray, " of_fold"]:
    """Return an index of the samples of a fold: a slice, which copies nothing, where it can be."""
    samples = np.flatnonzero(fold == number)
    if samples.size and samples[-1] - samples[0] + 1 == samples.size:
        return slice(int(samples[0]), int(samples[-1]) + 1)
    return samples


def equations_of(
    network: AbstractLinearNetwork,
    patterns: Patterns,
    cutoff: float | None,
    columns: HostColumns | None = None,
    unknowns: Unknowns | None = None,
) -> Equations:
    """Return one equation per pair that counts, or those of a parallel filter; on the host.

    Recordings that follow each other at different rates are filtered one by one.
    A long recording is filtered in stretches, whose columns fit into memory: each with as much of
    its neighbours as the filter remembers to ten digits.

    - `columns`, `unknowns`: of the regressor, if they are known already.
    """
    samples = len(patterns.q)
    time, torque, mask = (np.asarray(x) for x in (patterns.time, patterns.torque, patterns.mask))
    if cutoff is not None and len(starts := _starts(time)) > 1:
        recordings: list[Equations] = []
        for rows in map(slice, starts, [*starts[1:], samples]):
            some = None if columns is None else tuple(of_joint[:, rows] for of_joint in columns)
            recordings.append(
                equations_of(network, rows_of(patterns, rows), cutoff, some, unknowns)
            )
        pairs = zip(recordings[1:], starts[1:], strict=True)
        return reduce(lambda joined, pair: joined.followed_by(*pair), pairs, recordings[0])
    if cutoff is None or columns is not None or samples <= LONG:
        columns = columns_of(network, patterns) if columns is None else columns
        if unknowns is None:
            unknowns = unknowns_of(network, patterns, columns)
        return Equations.from_columns(unknowns, columns, torque, mask, time=time, cutoff=cutoff)
    interval = uniform_interval(time)
    reach = int(np.ceil(_MEMORY / (cutoff * interval)))
    kept = samples_kept(samples, cutoff, interval)
    inside = max(LONG - 2 * reach, 2 * reach)
    joined: Equations | None = None
    for first in range(0, samples, inside):
        start, stop = max(first - reach, 0), min(first + inside + reach, samples)
        rows = rows_of(patterns, slice(start, stop))
        columns = columns_of(network, rows)
        part = Equations.from_columns(
            unknowns_of(network, rows, columns),
            columns,
            torque[start:stop],
            mask[start:stop],
            time=time[start:stop],
            cutoff=cutoff,
            kept=kept[(kept >= first) & (kept < first + inside)] - start,
        )
        joined = part if joined is None else joined.followed_by(part, start)
    assert joined is not None
    return joined


def _starts(time: Float[np.ndarray, " samples"]) -> list[int]:
    """Return the first samples of recordings of different rates that follow each other.

    0 alone where intervals vary otherwise: too often for recordings.
    """
    intervals = np.diff(time)
    changes = np.flatnonzero(np.abs(np.diff(intervals)) > UNIFORM_TO * intervals[:-1])
    starts = [0, *(changes + 1).tolist()]
    lengths = np.diff([*starts, len(time)])
    return starts if np.all(lengths >= _FEWEST) else [0]


def unknowns_of(
    network: AbstractLinearNetwork, patterns: Patterns, columns: HostColumns
) -> Unknowns:
    """Return the unknowns of a network, and what rounding of patterns makes of their columns."""
    rounding = rounding_of(network, patterns, columns)
    return dataclasses.replace(Unknowns.of(network), rounding=rounding)


def dense_factors(network: AbstractLinearNetwork, patterns: Patterns) -> JointFactors:
    """Return the factors of all pairs that count, by reflections, chunk by chunk on the host."""
    parts: list[JointFactors] = []
    for start in range(0, max(len(patterns.q), 1), LONG):
        chunk = rows_of(patterns, slice(start, start + LONG))
        parts.append(equations_of(network, chunk, None).factors())
    return joined_factors(parts)
