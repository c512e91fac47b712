"""Equations of a recording, by joint, with or without a parallel filter.

Made of the columns of `_compiled`; `_factors` factorises them.
"""

from collections.abc import Collection, Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from ..network import AbstractLinearNetwork
from ..recordings import (
    FilteredEquations,
    Patterns,
    decimated_low_pass,
    decimation_for,
    parallel_filter,
    uniform_interval,
)
from ._compiled import (
    HostColumns,
    columns_in,
    columns_of,
    computed_on_host,
    filled_up,
    regressor_of,
    rows_of,
    stretches_of,
    traced,
)
from ._factors import JointFactors, Unknowns, factorise
from ._streaming import are_many, factors_of_patterns


# After so many periods of its cut-off the zero-phase filter has forgotten to ten digits.
_MEMORY = 10.0


class Equations(eqx.Module):
    """Equations of a recording in the columns of each joint, and where in it they belong.

    **Attributes**

    - `unknowns`: the coefficients.
    - `rows`: for each joint (rows, s + 1), its s coefficients' columns and the torque.
    - `sample`: for each joint, the sample that each row belongs to.
    """

    unknowns: Unknowns = eqx.field(static=True)
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
        """Return the equations of a whole regressor; arguments as of `of_columns`."""
        columns = columns_in(unknowns.support, regressor)
        return cls.of_columns(unknowns, columns, torque, mask, time=time, cutoff=cutoff)

    @classmethod
    def of_columns(
        cls,
        unknowns: Unknowns,
        columns: HostColumns,
        torque: Float[np.ndarray, "samples joints"],
        mask: Bool[np.ndarray, "samples joints"],
        *,
        time: Float[np.ndarray, " samples"],
        cutoff: float | None,
    ) -> "Equations":
        """The equations of the pairs that count, or those that a parallel filter makes of them.

        - `columns`: of the regressor, for each joint those of its support.
        """
        if cutoff is not None:
            interval = uniform_interval(time)
            filtered = [
                parallel_filter(
                    joint_columns.T[:, None],
                    right[:, None],
                    counts[:, None],
                    interval=interval,
                    cutoff=cutoff,
                )
                for joint_columns, right, counts in zip(columns, torque.T, mask.T, strict=True)
            ]
            rows = [np.concatenate([x.regressor, x.torque[:, None]], axis=1) for x in filtered]
            return cls(unknowns, tuple(rows), tuple(x.sample for x in filtered))
        samples = [np.flatnonzero(column) for column in mask.T]
        rows = []
        for joint_columns, right, kept in zip(columns, torque.T, samples, strict=True):
            sides = np.empty((len(joint_columns) + 1, kept.size))
            # Indices that exist need no check, which takes NumPy twice as long as to copy the rows.
            np.take(joint_columns, kept, axis=1, out=sides[:-1], mode="clip")
            np.take(right, kept, out=sides[-1], mode="clip")
            rows.append(sides.T)
        return cls(unknowns, tuple(rows), tuple(samples))

    @classmethod
    def of_filtered(cls, unknowns: Unknowns, filtered: FilteredEquations) -> "Equations":
        """Return the equations that a parallel filter has made of a whole regressor."""
        joints = [filtered.joint == joint for joint in range(len(unknowns.support))]
        rows = [
            np.concatenate(
                [filtered.regressor[kept][:, list(support)], filtered.torque[kept, None]], axis=1
            )
            for support, kept in zip(unknowns.support, joints, strict=True)
        ]
        return cls(unknowns, tuple(rows), tuple(filtered.sample[kept] for kept in joints))

    def without(self, indices: Collection[int]) -> "Equations":
        """Return the equations with the columns of these coefficients set to zero."""
        kept = ([*(i not in indices for i in support), True] for support in self.unknowns.support)
        rows = (rows * np.array(factor) for rows, factor in zip(self.rows, kept, strict=True))
        return Equations(self.unknowns, tuple(rows), self.sample)

    def times(self, roots: Sequence[Float[np.ndarray, " _"]]) -> "Equations":
        """Return the equations multiplied by factors: per joint, one factor per equation."""
        rows = (rows * root[:, None] for rows, root in zip(self.rows, roots, strict=True))
        return Equations(self.unknowns, tuple(rows), self.sample)

    def errors(self, k: Float[np.ndarray, " unknowns"]) -> list[np.ndarray]:
        """Return the errors that `k` leaves in the equations, per joint."""
        return [
            rows[:, -1] - rows[:, :-1] @ k[list(support)]
            for support, rows in zip(self.unknowns.support, self.rows, strict=True)
        ]

    def instants(self) -> tuple[Int[np.ndarray, " instants"], list[Int[np.ndarray, " _"]]]:
        """The samples of all equations in ascending order, and for each joint which of them its
        equations belong to."""
        kept = np.unique(np.concatenate(self.sample))
        return kept, [np.searchsorted(kept, sample) for sample in self.sample]

    def followed_by(self, other: "Equations", after: int) -> "Equations":
        """Return both sets of equations, the other's recording `after` samples later."""
        return Equations(
            self.unknowns,
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
        """The factors of all equations, as NumPy's arrays."""
        return JointFactors.of_rows(self.rows, np.array([float(len(rows)) for rows in self.rows]))

    def factors_of_folds(self, fold: Int[np.ndarray, " samples"], folds: int) -> JointFactors:
        """The factors of each fold by itself, all arrays with a leading axis of folds."""
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
        return JointFactors.of_rows(tuple(rows), np.stack(counts, axis=-1))

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
    """An index of the samples of a fold: a slice, which copies nothing, where it is a stretch."""
    samples = np.flatnonzero(fold == number)
    if samples.size and samples[-1] - samples[0] + 1 == samples.size:
        return slice(int(samples[0]), int(samples[-1]) + 1)
    return samples


def equations_of(
    network: AbstractLinearNetwork,
    patterns: Patterns,
    cutoff: float | None,
    columns: HostColumns | None = None,
) -> Equations:
    """Return one equation per pair that counts, or those of a parallel filter; on the host."""
    samples = len(patterns.q)
    stretches = stretches_of(network, samples) if columns is None else []
    if len(stretches) > 1 and cutoff is not None:
        return _filtered_in_stretches(network, patterns, cutoff, stretches[0].stop)
    if len(stretches) > 1:
        length = stretches[0].stop
        parts = [
            equations_of(network, part, None, columns_of(network, part, length))
            for part in (rows_of(patterns, rows) for rows in stretches)
        ]
        return _joined(parts, [rows.start for rows in stretches])
    return Equations.of_columns(
        Unknowns.of(network),
        columns_of(network, patterns) if columns is None else columns,
        np.asarray(patterns.torque),
        np.asarray(patterns.mask),
        time=np.asarray(patterns.time),
        cutoff=cutoff,
    )


def pattern_factors(network: AbstractLinearNetwork, patterns: Patterns) -> JointFactors:
    """The factors of all pairs that count: on the host, or of long recordings compiled."""
    motion = (patterns.q, patterns.qd, patterns.qdd)
    if computed_on_host(network, *motion, patterns.torque):
        return equations_of(network, patterns, None).factors()
    if not traced(patterns) and are_many(patterns):
        return factors_of_patterns(network, patterns)
    weight = patterns.mask.astype(float)
    return _factorise(network, *(filled_up(x) for x in (*motion, patterns.torque, weight)))


_factorise = eqx.filter_jit(factorise)


def _filtered_in_stretches(
    network: AbstractLinearNetwork, patterns: Patterns, cutoff: float, length: int
) -> Equations:
    """The equations that a parallel filter makes of a long recording, whose regressor would not fit
    into memory.

    Each stretch is filtered with as much of its neighbours as the filter remembers to ten digits.

    - `length`: of stretches with these parts of their neighbours, unless the filter reaches far.
    """
    interval, samples = uniform_interval(np.asarray(patterns.time)), len(patterns.q)
    reach = int(np.ceil(_MEMORY / (cutoff * interval)))
    decimation = decimation_for(cutoff, interval)
    kept = np.arange((samples - 1) % decimation // 2, samples, decimation)
    parts: list[Equations] = []
    starts: list[int] = []
    inside = max(length - 2 * reach, 2 * reach)
    for first in range(0, samples, inside):
        rows = slice(first, min(first + inside, samples))
        start, stop = max(rows.start - reach, 0), min(rows.stop + reach, samples)
        within = rows_of(patterns, slice(start, stop))
        inner = kept[(kept >= rows.start) & (kept < rows.stop)] - start
        filtered = parallel_filter(
            np.asarray(regressor_of(network, within, length)),
            np.asarray(within.torque),
            np.asarray(within.mask),
            interval=interval,
            cutoff=cutoff,
            kept=inner,
        )
        parts.append(Equations.of_filtered(Unknowns.of(network), filtered))
        starts.append(start)
    return _joined(parts, starts)


def _joined(parts: Sequence[Equations], starts: Sequence[int]) -> Equations:
    """Equations of parts of a recording that begin at these samples."""
    return Equations(
        parts[0].unknowns,
        tuple(np.concatenate(rows) for rows in zip(*(part.rows for part in parts), strict=True)),
        tuple(
            np.concatenate([start + sample for start, sample in zip(starts, samples, strict=True)])
            for samples in zip(*(part.sample for part in parts), strict=True)
        ),
    )
