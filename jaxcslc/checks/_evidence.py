"""Low-passed part of a recording on which hypotheses about its columns are scored; and causes.

A cause is a finding with its gain, and a `Change` makes recordings without it.
"""

import contextlib
import dataclasses
import itertools
from collections.abc import Callable, Sequence
from functools import cached_property
from operator import itemgetter
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from ..least_squares import (
    Equations,
    HostColumns,
    Identification,
    LeastSquares,
    Unknowns,
    columns_of,
    equations_of,
    torque_by,
    torque_of,
    unknowns_of,
)
from ..network import CSLC
from ..recordings import (
    Butterworth,
    Patterns,
    Preparation,
    Recording,
    RecordingError,
    joined_patterns,
    noise_level,
    resample,
    uniform_interval,
)
from ._findings import Finding


# A joint follows the file's torque well if it explains more of the variance than it leaves.
WELL = 0.5
# Least divisor of what may be zero.
TINY = 1e-300


@dataclasses.dataclass(frozen=True)
class PriorFit:
    """Fit of recorded torques by those of the masses in the robot's file.

    Joint by joint, torque is a factor times the file's torque, plus friction and an offset.

    - `factor`: (n,) of each joint; 1 where file and recording agree.
    - `explained`: (n,) part of the variance that friction leaves and the file's torque explains.
    - `size`: (n,) root mean square of the file's torque, over that of the recorded torque.
    """

    factor: Float[np.ndarray, " joints"]
    explained: Float[np.ndarray, " joints"]
    size: Float[np.ndarray, " joints"]

    @property
    def common_factor(self) -> float:
        """Median factor of the joints that the file's torque explains well; NaN without any."""
        well = self.explained > WELL
        return float(np.median(self.factor[well])) if well.any() else np.nan

    @property
    def common_size(self) -> float:
        """`common_factor` of absolute values; NaN without any.

        >>> well = np.ones(2)
        >>> PriorFit(np.array([0.7, -0.9]), well, well).common_size
        0.8
        """
        well = self.explained > WELL
        return float(np.median(np.abs(self.factor[well]))) if well.any() else np.nan

    @property
    def factors(self) -> Float[np.ndarray, " joints"]:
        """(n,) factors of the joints that the file's torque explains well, the common one of
        the others."""
        return np.where(self.explained > WELL, self.factor, self.common_factor)


def prior_fit(network: CSLC, patterns: Patterns, columns: HostColumns) -> PriorFit | None:
    """Compare recorded torque with that of the file's masses; None if the file has none.

    - `columns`: of the regressor of the patterns' motion.
    """
    robot = network.robot
    if robot.links is None or not any(float(link.mass) for link in robot.links):
        return None
    k = np.asarray(network.coefficients_from(robot.links))
    expected = torque_by(network.support, columns, k)
    qd, mask = np.asarray(patterns.qd), np.asarray(patterns.mask)
    terms = np.stack([expected, qd, np.sign(qd), np.ones_like(qd)], axis=0)
    with_file, factor = _errors(patterns, terms, mask)
    without_file, _ = _errors(patterns, terms[1:], mask)
    sizes = [counted_rms(values, mask) for values in (expected, np.asarray(patterns.torque))]
    # Of a torque that was not recorded nothing is left to explain, and nothing is explained.
    recorded = without_file > 0.0
    explained = (
        1.0 - (np.where(recorded, with_file, 1.0) / np.where(recorded, without_file, 1.0)) ** 2
    )
    return PriorFit(factor, explained, sizes[0] / np.maximum(sizes[1], TINY))


def counted_rms(
    values: Float[np.ndarray, "samples joints"], mask: Bool[np.ndarray, "samples joints"]
) -> Float[np.ndarray, " joints"]:
    """Return the root mean square of each joint's values that count; 0 where none does."""
    return np.sqrt(np.where(mask, values**2, 0.0).sum(axis=0) / np.maximum(mask.sum(axis=0), 1))


def error_part(
    error: Float[np.ndarray, "samples joints"], patterns: Patterns
) -> Float[np.ndarray, " joints"]:
    """Return the size of each joint's torque error that counts, as a part of the torque's."""
    mask = np.asarray(patterns.mask)
    squares, size = (
        np.where(mask, x**2, 0.0).sum(axis=0) for x in (error, np.asarray(patterns.torque))
    )
    return np.sqrt(squares / np.where(size > 0, size, 1.0))


def _errors(
    patterns: Patterns, terms: Float[np.ndarray, "terms samples joints"], mask: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Fit joints with coefficients of their own; return root mean square errors, and the first."""
    count, samples, joints = terms.shape
    unknowns = Unknowns(
        tuple(f"{joint} {term}" for joint in range(joints) for term in range(count)),
        tuple(tuple(range(joint * count, (joint + 1) * count)) for joint in range(joints)),
    )
    equations = Equations.from_columns(
        unknowns,
        tuple(np.moveaxis(terms, -1, 0)),
        np.asarray(patterns.torque),
        mask,
        time=np.asarray(patterns.time),
        cutoff=None,
    )
    solver = LeastSquares(errors="independent", joint_weights="equal")
    fit = solver.fit_equations(equations, samples, throw=False)
    return np.asarray(fit.torque_error), np.asarray(fit.k)[::count]


# A window of more samples tells no more about what is wrong: forty seconds at 1 kHz.
_MOST_SAMPLES = 40_000
# As many rows share one compiled regressor.
_MOST_ROWS = 4096
_FOLDS = 5  # of held-out errors: each fit has four fifths of the recording
# Fewer torques per coefficient fit any hypothesis: half a second of clean motion was called wrong.
# (Heuristic, of one simulated arm's short logs.)
_EQUATIONS = 4
# After so many periods of its cut-off, a thousandth is left of what a filter has seen.
_FADED = 3.0
# What noise may be of the accelerations' root mean square: inertias shrink by its square, 1 %.
_NOISE_PART = 0.1
# Cut-offs [Hz], and how many of them are tried. (Heuristic: motion of arms is slower, and the
# vibration of their gears is faster.)
_LOWEST, _HIGHEST, _CUTOFFS = 3.0, 12.0, 6
CUTOFF_OF_RATE = 0.2
"""Highest cut-off of smoothed positions, as part of the sampling rate: five samples a period."""
# Median intervals from which on what lies between two samples is not interpolated, a gap: one
# period of the highest cut-off.
_GAP = 1.0 / CUTOFF_OF_RATE
SLOW = 0.1
"""Part of a joint's top speed below which static friction, which no check fits, may be.
(Heuristic.)"""
# Periods of the cut-off between rows that are kept: more than half a period would lose motion.
_APART = 0.2
_SPREAD_OVER = 0.5  # periods of the cut-off on either side that filters spread a sample over
_LEAST_RANGE = 1e-12  # rad or m: a joint with less does not move
SMALLEST_ERROR, LARGEST_ERROR = 1e-6, 10.0
"""Least and largest torque errors, relative to the torque; others count as these in logarithms."""
_SOLVER = LeastSquares(errors="independent")


@dataclasses.dataclass(frozen=True)
class Evidence:
    """Low-passed part of a recording that shows whether its motion and its torque belong together.

    Positions and torques pass one low pass, which delays neither and leaves its noise in neither,
    and are thinned out to what is left of them.

    - `recording`: the part of it that is looked at, at even times.
    - `valid`: False for samples of a joint that are no measurements of it.
    - `patterns`: low-passed and thinned out.
    - `torque`: of all samples, low-passed, from `time[0]` on [N m or N].
    - `time`: of all samples [s].
    - `cutoff`: of the low pass [Hz].
    """

    network: CSLC
    recording: Recording
    valid: Bool[np.ndarray, "samples joints"]
    patterns: Patterns
    time: Float[np.ndarray, " inner"]
    torque: Float[np.ndarray, "inner joints"]
    cutoff: float

    @classmethod
    def of(
        cls,
        network: CSLC,
        recording: Recording,
        valid: Bool[np.ndarray, "samples joints"] | None = None,
        cutoff: float | None = None,
    ) -> "Evidence":
        """Low-pass and thin out a recording; **raises** `ValueError` if it is too short.

        - `recording`: its times about zero (`from_its_start`), which those of evidence count from.
        - `cutoff`: of the low pass [Hz]; by the noise of the positions if None.
        """
        valid = np.ones(recording.position.shape, bool) if valid is None else valid
        recording, valid = _window(recording, valid)
        recording, valid = _uniform(recording, valid)
        interval = float(np.median(np.diff(recording.time)))
        cutoff = _cutoff(recording, interval) if cutoff is None else cutoff
        preparation = Preparation(Butterworth(cutoff), smooth_torque=True, threshold_fraction=SLOW)
        patterns = preparation.patterns(recording)
        # A motion that does not begin and end at rest leaves errors of filters at both ends.
        ends = min(int(np.ceil(_FADED / (cutoff * interval))), recording.samples // 10)
        valid = valid.copy()
        valid[:ends] = valid[recording.samples - ends :] = False
        reach = int(np.ceil(_SPREAD_OVER / (cutoff * interval)))
        clear = _far_from_invalid(valid, reach)
        trim = preparation.trimmed(recording)
        inside = slice(trim, recording.samples - trim)
        fewest = int(np.ceil(patterns.samples / _MOST_ROWS))
        step = max(1, round(_APART / (cutoff * interval)), fewest)
        thinned = slice(None, None, step)
        return cls(
            network,
            recording,
            valid,
            Patterns(
                patterns.time[thinned],
                patterns.q[thinned],
                patterns.qd[thinned],
                patterns.qdd[thinned],
                patterns.torque[thinned],
                clear[inside][thinned],
                np.asarray(patterns.friction_mask)[thinned],
            ),
            recording.time[inside],
            np.asarray(patterns.torque),
            cutoff,
        )

    @property
    def shortage(self) -> str:
        """Return why the samples are too few to judge hypotheses by; empty if they are enough."""
        equations = int(np.asarray(self.patterns.mask).sum())
        if equations >= (expected := _EQUATIONS * self.network.size):
            return ""
        return (
            f"{self.recording.samples} samples in {float(np.ptp(self.recording.time)):.3g} s have"
            f" {equations} independent torques of moving joints; expected {expected} or more, for"
            f" {self.network.size} coefficients"
        )

    @cached_property
    def interval(self) -> float:
        """Between samples of the recording [s]."""
        return float(np.median(np.diff(self.recording.time)))

    @cached_property
    def fit(self) -> Identification:
        """The fit to all patterns."""
        equations = equations_of(self.network, self.patterns, None, self._columns)
        return _SOLVER.fit_equations(equations, self.patterns.samples, throw=False)

    @cached_property
    def prior(self) -> PriorFit | None:
        """Fit of the patterns' torques by those of the robot's file, if that has masses."""
        return prior_fit(self.network, self.patterns, self._columns)

    @cached_property
    def gravity(self) -> Float[np.ndarray, "samples joints"]:
        """Torque at rest by the fit, at the positions of the patterns [N m or N]."""
        still = np.zeros_like(np.asarray(self.patterns.q))
        at_rest = dataclasses.replace(self.patterns, qd=still, qdd=still)
        return torque_of(self.network, at_rest, np.asarray(self.fit.k))

    def columns(self, patterns: Patterns) -> HostColumns:
        """Return the regressor's columns of patterns, those of the evidence or others."""
        return self._columns if patterns is self.patterns else columns_of(self.network, patterns)

    @cached_property
    def _columns(self) -> HostColumns:
        return columns_of(self.network, self.patterns)

    @cached_property
    def _unknowns(self) -> Unknowns:
        return unknowns_of(self.network, self.patterns, self._columns)

    def coefficients(
        self, patterns: Patterns, columns: HostColumns
    ) -> Float[np.ndarray, " coefficients"]:
        """Return the coefficients fitted to patterns, as those of `fit`."""
        if patterns is self.patterns and columns is self._columns:
            return np.asarray(self.fit.k)
        return _SOLVER.coefficients(equations_of(self.network, patterns, None, columns))

    @cached_property
    def relative_errors(self) -> Float[np.ndarray, " joints"]:
        """`errors` of the patterns as they are."""
        return self.errors(self.patterns, self._columns)

    @cached_property
    def training_errors(self) -> Float[np.ndarray, " joints"]:
        """Error of each joint that `fit` leaves, as part of its torque's root mean square.

        In N m for a joint without torque.
        """
        size = counted_rms(np.asarray(self.patterns.torque), np.asarray(self.patterns.mask))
        return np.asarray(self.fit.torque_error) / np.where(size > 0.0, size, 1.0)

    @cached_property
    def noise(self) -> Float[np.ndarray, " joints"]:
        """White noise of the torques, low-passed, as part of each torque's root mean square."""
        passed = np.sqrt(min(2.0 * self.cutoff * self.interval, 1.0))
        size = np.sqrt(np.mean(np.asarray(self.patterns.torque) ** 2, axis=0))
        return noise_level(self.recording.torque) * passed / np.maximum(size, TINY)

    def errors(
        self,
        patterns: Patterns,
        columns: HostColumns | None = None,
    ) -> Float[np.ndarray, " joints"]:
        """Return the held-out error of each joint as part of its torque's root mean square.

        - `columns`: of the patterns' motion, if they are known already.
        """
        fold = np.arange(patterns.samples) * _FOLDS // patterns.samples
        known = columns is not None and columns is self._columns
        unknowns = self._unknowns if known else None
        error = _SOLVER.held_out_errors(self.network, patterns, fold, columns, unknowns)
        return error_part(error, patterns)

    def quick_scores(self, patterns: Sequence[Patterns]) -> list[float]:
        """Compute the `score` of every third row of each, to sort out hypotheses.

        The columns of as many at once as fit into the rows that a compiled function has anyway
        take a third of the time of one after the other.
        """
        third = [jax.tree.map(itemgetter(slice(None, None, 3)), some) for some in patterns]
        scores: list[float] = []
        while third:
            count = max(1, _MOST_ROWS // third[0].samples)
            batch, third = third[:count], third[count:]
            columns = columns_of(self.network, joined_patterns(batch))
            pieces = zip(*(np.split(rows, len(batch), axis=1) for rows in columns), strict=True)
            scores += [self.score(*pair) for pair in zip(batch, pieces, strict=True)]
        return scores

    def score(
        self,
        patterns: Patterns,
        columns: HostColumns | None = None,
    ) -> float:
        """Return the mean logarithm of the errors: the smaller, the better patterns fit."""
        errors = (
            self.relative_errors if patterns is self.patterns else self.errors(patterns, columns)
        )
        return float(np.mean(np.log(np.clip(errors, SMALLEST_ERROR, LARGEST_ERROR))))


def from_its_start(recording: Recording) -> Recording:
    """Return a recording with times from its start on, as `--between` counts them.

    Of seconds since 1970, a tenth of a microsecond is lost.
    """
    return dataclasses.replace(recording, time=recording.time - recording.time[0])


def _far_from_invalid(
    valid: Bool[np.ndarray, "samples joints"], reach: int
) -> Bool[np.ndarray, "samples joints"]:
    """Mark where all samples up to `reach` before and behind are valid."""
    passed = np.concatenate([np.zeros((1, valid.shape[1]), int), np.cumsum(~valid, axis=0)])
    sample = np.arange(len(valid))
    before, behind = np.maximum(sample - reach, 0), np.minimum(sample + reach + 1, len(valid))
    return passed[behind] == passed[before]


def _window(
    recording: Recording, valid: Bool[np.ndarray, "samples joints"]
) -> tuple[Recording, Bool[np.ndarray, "remaining joints"]]:
    """Return the window with the most motion of a longer recording."""
    if recording.samples <= _MOST_SAMPLES:
        return recording, valid
    change = np.abs(np.diff(recording.position, axis=0, prepend=recording.position[:1]))
    change = (change / np.maximum(np.ptp(recording.position, axis=0), _LEAST_RANGE)).sum(axis=1)
    total = np.concatenate([[0.0], np.cumsum(change)])
    start = int(np.argmax(total[_MOST_SAMPLES:] - total[:-_MOST_SAMPLES]))
    part = slice(start, start + _MOST_SAMPLES)
    return recording.rows(part), valid[part]


def _uniform(
    recording: Recording, valid: Bool[np.ndarray, "samples joints"]
) -> tuple[Recording, Bool[np.ndarray, "remaining joints"]]:
    """Bring a recording to even times, without what lies in gaps.

    Of a recording that is mostly gaps, the longest part without one.
    """
    with contextlib.suppress(ValueError):
        uniform_interval(recording.time)
        return recording, valid
    interval = float(np.median(np.diff(recording.time)))
    try:
        uniform = resample(recording, interval)
    except RecordingError:
        ends = np.flatnonzero(np.diff(recording.time) >= _GAP * interval) + 1
        parts = itertools.pairwise([0, *ends.tolist(), recording.samples])
        longest = slice(*max(parts, key=lambda part: part[1] - part[0]))
        recording, valid = recording.rows(longest), valid[longest]
        uniform = resample(recording, interval)
    nearest = np.clip(np.searchsorted(recording.time, uniform.time), 1, recording.samples - 1)
    before, after = recording.time[nearest - 1], recording.time[nearest]
    near = (after - before) < _GAP * interval
    return uniform, valid[nearest] & valid[nearest - 1] & near[:, None]


def _cutoff(recording: Recording, interval: float) -> float:
    """Return the highest cut-off that leaves little noise in the accelerations [Hz]."""
    noise = noise_level(recording.position)
    highest = min(_HIGHEST, CUTOFF_OF_RATE / interval)
    for cutoff in np.geomspace(highest, min(_LOWEST, highest), _CUTOFFS):
        _, _, qdd = Butterworth(float(cutoff)).smooth(recording.time, recording.position)
        # White noise of positions, low-passed and differentiated twice.
        omega = 2.0 * np.pi * cutoff
        acceleration = noise * omega**2 * np.sqrt(2.0 * cutoff * interval / 5.0)
        if np.median(acceleration / np.maximum(np.std(qdd, axis=0), TINY)) < _NOISE_PART:
            return float(cutoff)
    return float(min(_LOWEST, highest))


LEAST_GAIN = 0.15
"""Least fall of the mean logarithm of the joints' errors once a cause is removed, 14 %. The best
cause of a right recording has 0.01 at most (`scripts.studies.checks.margins`)."""
ALIKE = LEAST_GAIN / 3.0
"""Causes whose gains differ by a third of that are told apart by chance. (Heuristic.)"""
# A remedy must take away this part of the squares of the errors beyond noise, most of them, of
# joints with errors of this part of their torque. (Heuristic: smaller ones may be friction's that
# no model has; right recordings leave 6 % at most, `scripts.studies.checks.margins`.)
_REMOVED, _LARGE = 0.5, 0.05


@dataclasses.dataclass(frozen=True)
class Cause:
    """A finding, and the evidence without what it names.

    - `finding`: with its evidence.
    - `gain`: decrease of the mean logarithm of the errors once the cause is corrected.
    - `mended`: returns the evidence of the recording without what the finding names; None if
      nothing else can be judged with it.
    """

    finding: Finding
    gain: float
    mended: Callable[[], Evidence | None]


def removes(
    before: Float[np.ndarray, " joints"],
    after: Float[np.ndarray, " joints"],
    noise: Float[np.ndarray, " joints"],
) -> bool:
    """Return whether a remedy takes away most of the large errors beyond noise.

    >>> before, noise = np.array([0.2, 0.02]), np.array([0.01, 0.01])
    >>> removes(before, np.array([0.05, 0.02]), noise), removes(before, 0.9 * before, noise)
    (True, False)
    """
    excess, remaining = (np.maximum(errors**2 - noise**2, 0.0) for errors in (before, after))
    large = before > _LARGE
    return bool(np.sum(remaining[large]) <= (1.0 - _REMOVED) * np.sum(excess[large]))


@dataclasses.dataclass(frozen=True, eq=False)
class Change:
    """Columns of positions and torques in another order, and multiplied by factors.

    - `motion_order`, `torque_order`: (n,) which column becomes each joint's; None for the same.
    - `motion_factors`, `torque_factors`: (n,) of the columns in their new order.
    - `motion_offsets`: (n,) added to the positions last [rad or m].
    """

    motion_order: Int[np.ndarray, " joints"] | None = None
    torque_order: Int[np.ndarray, " joints"] | None = None
    motion_factors: Float[np.ndarray, " joints"] | float = 1.0
    torque_factors: Float[np.ndarray, " joints"] | float = 1.0
    motion_offsets: Float[np.ndarray, " joints"] | float = 0.0

    def patterns(self, patterns: Patterns) -> Patterns:
        """Return the patterns of the changed recording."""
        q, qd, qdd = (self._motion(x) for x in (patterns.q, patterns.qd, patterns.qdd))
        valid = np.asarray(patterns.backlash_mask)
        return Patterns(
            patterns.time,
            q + self.motion_offsets,
            qd,
            qdd,
            self._torque(patterns.torque),
            # Where both columns of a joint are measured.
            _ordered(valid, self.motion_order) & _ordered(valid, self.torque_order),
            _ordered(patterns.friction_mask, self.motion_order),
        )

    def recording(self, recording: Recording) -> Recording:
        """Return the changed recording, without velocities and accelerations."""
        position, torque = self._motion(recording.position), self._torque(recording.torque)
        return Recording(recording.time, position + self.motion_offsets, torque)

    def mended(self, evidence: Evidence) -> Evidence:
        """Return the evidence of the recording as it would be."""
        return Evidence.of(evidence.network, self.recording(evidence.recording), evidence.valid)

    def _motion(self, values: Any) -> np.ndarray:
        return _ordered(values, self.motion_order) * self.motion_factors

    def _torque(self, values: Any) -> np.ndarray:
        return _ordered(values, self.torque_order) * self.torque_factors


def _ordered(values: Any, order: Int[np.ndarray, " joints"] | None) -> np.ndarray:
    values = np.asarray(values)
    return values if order is None else values[:, order]
