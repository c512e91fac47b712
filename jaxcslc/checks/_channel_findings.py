"""Findings about single channels: angles that wrap, jumps, stops, unsigned and saturated torques.

Each is mended, or the samples that it spoils are left out, before motion and torque are compared.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from ..recordings import Recording, encoder_resolution, noise_level, stale_rows
from ._evidence import TINY, Evidence
from ._findings import Finding, finding


@dataclasses.dataclass(frozen=True)
class Channels:
    """Findings about single channels, and the recording without what they name.

    - `findings`: what looks wrong.
    - `recording`: with angles unwrapped.
    - `valid`: False for torques that are no measurements of the joint's.
    - `suspects`: torques that may be unsigned or saturated: motion decides.
    """

    findings: tuple[Finding, ...]
    recording: Recording
    valid: Bool[np.ndarray, "samples joints"]
    suspects: "tuple[Unsigned | Saturated, ...]" = ()

    @classmethod
    def of(cls, recording: Recording, names: Sequence[str], kinds: str) -> "Channels":
        """Look at each channel of a recording.

        - `kinds`: of the joints, `R` or `P` each.
        """
        findings: list[Finding] = []
        valid = np.ones(recording.position.shape, bool)
        if recording.samples < _FEWEST:
            return cls((), recording, valid)
        position = recording.position
        revolute = np.array([kind == "R" for kind in kinds])
        wraps = np.abs(np.abs(np.diff(position, axis=0)) - 2.0 * np.pi) < _NEAR_TURN
        wrapped = revolute & wraps.any(axis=0)
        if wrapped.any():
            position = np.where(wrapped, np.unwrap(position, axis=0), position)
            recording = dataclasses.replace(recording, position=position)
            findings += [
                finding(
                    "wrapped angle",
                    f"positions jump by a turn {int(wraps[:, joint].sum())} times",
                    names[joint],
                    joint=names[joint],
                )
                for joint in np.flatnonzero(wrapped).tolist()
            ]
        jumps = _jumps(recording)
        if jumps.size:
            moments = ", ".join(f"{recording.time[row]:.4g} s" for row in jumps[:3])
            findings.append(
                finding("jump", f"{jumps.size} times all joints jump between two rows: {moments}")
            )
            for row in jumps.tolist():
                valid[max(row - _BESIDE, 0) : row + _BESIDE] = False
        for joint, text, spoilt in _stops(recording):
            findings.append(finding("stop", text, names[joint], joint=names[joint]))
            valid[spoilt, joint] = False
        suspects = (*_unsigned(recording), *_saturated(recording, valid))
        return cls(tuple(findings), recording, valid, suspects)

    @property
    def kinds(self) -> set[str]:
        """Kinds of the findings."""
        return {found.kind for found in self.findings}


@dataclasses.dataclass(frozen=True)
class Unsigned:
    """Torques of a joint that may have lost their sign.

    - `joint`: from 0.
    - `stretch`: number of the stretch of each sample, in which its sign may be the same.
    - `rows`: the samples, all of them.
    - `text`: evidence.
    """

    joint: int
    stretch: Int[np.ndarray, " samples"]
    rows: Bool[np.ndarray, " samples"]
    text: str
    row = "unsigned torque"

    def confirmed(self, evidence: Evidence, time: Float[np.ndarray, " samples"]) -> bool:
        """Return whether motion explains the torque with signs, and not without.

        Signs of whole stretches are searched for first, then those of samples.
        """
        at = np.searchsorted(time, np.asarray(evidence.patterns.time))
        equations = _OwnEquations.of(evidence, self.joint)
        torque = np.abs(equations.torque)
        stretch = self.stretch[np.minimum(at, len(time) - 1)][equations.rows]
        parts = torque[:, None] * (stretch[:, None] == np.unique(stretch))
        left = parts - equations.fitted(parts)
        signs = _best_signs(left.T @ left)[np.searchsorted(np.unique(stretch), stretch)]
        for _ in range(_ALTERNATIONS):
            before, signs = signs, np.where(equations.fitted(signs * torque) < 0.0, -1.0, 1.0)
            if np.array_equal(before, signs):
                break
        error, size = equations.error(signs * torque), float(np.sqrt(np.mean(torque**2)))
        return error < min(_SIGNED * equations.error(torque), _FITS * size)


def _best_signs(
    squares: Float[np.ndarray, "stretches stretches"],
) -> Float[np.ndarray, " stretches"]:
    """Return signs s with a small s' A s: from several starts, while one more flip makes it less.

    >>> float(_best_signs(np.array([[1.0, 0.9], [0.9, 1.0]])).prod())
    -1.0
    """
    rng = np.random.default_rng(0)
    best, least = np.ones(len(squares)), np.inf
    for signs in rng.choice([-1.0, 1.0], (_STARTS, len(squares))):
        while True:
            falls = signs * (squares @ signs) - np.diag(squares)
            flipped = int(np.argmax(falls))
            if falls[flipped] <= 0.0:
                break
            signs[flipped] *= -1.0
        value = float(signs @ squares @ signs)
        if value < least:
            best, least = signs, value
    return best


@dataclasses.dataclass(frozen=True)
class _OwnEquations:
    """Equations of motion of one joint alone: other joints may have faults of their own.

    - `rows`: of the patterns, where the joint is measured.
    - `columns`: of the regressor and a constant, of all patterns.
    - `torque`: of the rows [N m or N].
    """

    rows: Bool[np.ndarray, " patterns"]
    columns: Float[np.ndarray, "patterns columns"]
    torque: Float[np.ndarray, " rows"]

    @classmethod
    def of(cls, evidence: Evidence, joint: int) -> "_OwnEquations":
        """Return the equations of a joint, from 0."""
        patterns = evidence.patterns
        own = evidence.columns(patterns)[joint].T
        columns = np.column_stack([own, np.ones(len(own))])
        torque, rows = (np.asarray(x)[:, joint] for x in (patterns.torque, patterns.mask))
        return cls(rows, columns, torque[rows])

    @cached_property
    def _range(self) -> Float[np.ndarray, "rows rank"]:
        """Orthonormal columns of the same span."""
        columns = self.columns[self.rows]
        scales = np.maximum(np.sqrt(np.sum(columns**2, axis=0)), TINY)
        left, values, _ = np.linalg.svd(columns / scales, full_matrices=False)
        return left[:, values > _RANK * values[0]] if values.size else left

    def fitted(self, torque: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return what the equations explain of a torque."""
        return self._range @ (self._range.T @ torque)

    def error(self, torque: Float[np.ndarray, " rows"]) -> float:
        """Return the root mean square of what they do not."""
        return float(np.sqrt(np.mean((torque - self.fitted(torque)) ** 2)))


@dataclasses.dataclass(frozen=True)
class Saturated:
    """Torques of a joint that pile up at one end of their range.

    - `joint`: from 0; `sign`: of the end, 1 or -1.
    - `width`: of the noise about it [N m or N].
    - `rows`: the samples.
    - `text`: evidence.
    """

    joint: int
    sign: float
    width: float
    rows: Bool[np.ndarray, " samples"]
    text: str

    row = "clipping"

    def confirmed(self, evidence: Evidence, time: Float[np.ndarray, " samples"]) -> bool:
        """Return whether the motion takes more torque there, by a fit without these samples.

        Not by one that leaves much of the torque: something else is wrong.
        """
        at = np.searchsorted(time, np.asarray(evidence.patterns.time))
        inside = self.rows[np.minimum(at, len(time) - 1)]
        equations = _OwnEquations.of(evidence, self.joint)
        if not inside.any() or not equations.rows.any():
            return False
        column, own = np.asarray(evidence.patterns.torque)[:, self.joint], equations.columns
        fitted = np.linalg.lstsq(own[equations.rows], equations.torque, rcond=_RANK)[0]
        # The median: friction at a standstill that no model has is in few samples.
        more = float(np.median(self.sign * (own @ fitted - column)[inside]))
        size, usual = float(np.std(column)), equations.error(equations.torque)
        return usual < _FITS * size and more > max(_MORE * self.width, usual, _MATTERS * size)


_FEWEST = 200  # samples, below which nothing is said: two of them are one per cent
_NEAR_TURN = 1.0  # rad that a joint moves at most within a sample in which its angle wraps
# A jump is so many times the steps around it at this part of the joints that move, and two or more.
# (Heuristic.)
_JUMP, _AROUND, _JUMPING, _FEWEST_JUMPING = 6.0, 8, 0.5, 2.0
# It is so many encoder steps, or deviations of the noise, as no noise is in some thousand samples.
_JUMP_STEPS, _JUMP_NOISE = 3.0, 36.0
_MOVING = 0.9  # quantile of the steps, which are zero at a joint that stands still
_EVEN = 1.5  # median intervals between rows that no row is missing from
_BESIDE = 60  # rows beside a jump that filters spread it over (heuristic)


def _jumps(recording: Recording) -> np.ndarray:
    """Return rows before which positions of most joints jump, in motion that goes on evenly."""
    time, position = recording.time, recording.position
    interval = np.diff(time)
    step = np.abs(np.diff(position, axis=0))
    around = scipy.ndimage.maximum_filter1d(
        np.where(_alone(step), 0.0, step), 2 * _AROUND + 1, axis=0
    )
    least = np.maximum(
        _JUMP_STEPS * encoder_resolution(position), _JUMP_NOISE * noise_level(position)
    )
    moving = np.quantile(step, _MOVING, axis=0) > 0.0
    jumping = (step > _JUMP * around) & (step > least) & moving
    even = interval < _EVEN * np.median(interval)
    enough = jumping.sum(axis=1) >= max(_FEWEST_JUMPING, _JUMPING * moving.sum())
    return np.flatnonzero(enough & even) + 1


def _alone(step: Float[np.ndarray, "steps joints"]) -> Bool[np.ndarray, "steps joints"]:
    """Mark steps that are larger than all others nearby."""
    return step >= scipy.ndimage.maximum_filter1d(step, 2 * _AROUND + 1, axis=0)


# A stop ends motion, measured over so many seconds, by so many times the usual accelerations,
# keeps the joint at the end of its range for a time [s], and does so this often. Not if many rows
# repeat the row before. (Heuristic: 72 of 72 stops of six arms are found, and none of 60 recordings
# without a stop has one: the kind "joint on a stop" of `scripts.studies.checks.spoiler`.)
_SUDDEN, _DECELERATION, _KEPT, _STOPS, _REPEATED = 0.03, 5.0, 0.1, 2, 0.005

Found = Iterator[tuple[int, str, Bool[np.ndarray, " samples"]]]


def _stops(recording: Recording) -> Found:
    """Yield joints that are suddenly stopped, again and again, at one end of their range."""
    interval = float(np.median(np.diff(recording.time)))
    reach, kept = max(2, round(_SUDDEN / interval)), round(_KEPT / interval)
    if recording.samples <= 2 * reach or np.mean(stale_rows(recording)) > _REPEATED:
        return
    tolerance = np.maximum(
        _END_STEPS * encoder_resolution(recording.position),
        _END_NOISE * noise_level(recording.position),
    )
    for joint, (column, near) in enumerate(zip(recording.position.T, tolerance, strict=True)):
        extent = float(np.ptp(column))
        if extent < _RANGE * near or extent <= TINY:
            continue
        near = max(float(near), _EXACT * extent)
        bend = column[2 * reach :] - 2.0 * column[reach:-reach] + column[: -2 * reach]
        usual = float(np.quantile(np.abs(bend), _USUAL)) / (reach * interval) ** 2
        for end, word in ((float(column.max()), "highest"), (float(column.min()), "lowest")):
            at_end = np.abs(column - end) <= near
            starts, stops = _runs(at_end)
            held = (stops - starts >= kept) & (starts > reach + 1)
            events = sum(
                _deceleration(np.abs(column[start - reach - 1 : start + 1] - end), near, interval)
                > _DECELERATION * usual
                for start in starts[held]
            )
            if events >= _STOPS or (events == 1 and np.sum(held) == 1 and at_end.mean() > _LONG):
                text = (
                    f"its motion ends suddenly at its {word} position, {end:.4g} rad or m,"
                    f" {events} times, for {100 * at_end.mean():.2g} % of the samples"
                )
                yield joint, text, scipy.ndimage.binary_dilation(at_end, iterations=kept)
                break


# A joint is at an end within two encoder steps, or six deviations of the noise. Its range
# is as many times that at least. Its usual accelerations are this quantile of all. (Heuristic.)
_END_STEPS, _END_NOISE, _RANGE, _USUAL = 2.1, 6.0, 100.0, 0.98
_EXACT = 1e-4  # of its range, where a position has neither steps nor noise
_LONG = 0.03  # part of the samples at a stop that is reached once (heuristic)
# Distances from the end, in tolerances, over which a deceleration is estimated.
_DISTANCES = np.array([4.0, 11.0, 30.0, 100.0, 300.0])


def _deceleration(distance: Float[np.ndarray, " samples"], near: float, interval: float) -> float:
    """Return the constant deceleration that explains how soon a joint came to rest at an end.

    From distance d, it lasts √(2 d / a). Friction ends motion by the decelerations of the other
    motion. A stop ends it sooner, whatever the distance that is looked at.

    - `distance`: from the end, at the samples before it is reached, the last within `near`.
    - `near`: distance that counts as the end.
    - `interval`: between samples [s].
    """
    away = np.maximum.accumulate(distance[::-1])
    far = _DISTANCES[_DISTANCES * near <= away[-1]]
    if far.size == 0:
        return 0.0
    times = interval * np.interp(near * np.append(1.0, far), away, np.arange(away.size))
    lasted = np.maximum(times[1:] - times[0], TINY)
    return float(np.max(2.0 * near * ((np.sqrt(far) - 1.0) / lasted) ** 2))


def _runs(marked: Bool[np.ndarray, " samples"]) -> tuple[np.ndarray, np.ndarray]:
    """Return where runs of marked samples begin, and where they have ended."""
    edges = np.diff(np.concatenate([[0], marked.astype(int), [0]]))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)


# A torque that is never negative is unsigned if it turns back at zero so often: within this part of
# its greatest value, and by this part on both sides. (Heuristic: the motion must confirm it.)
_TURNS, _NEAR_ZERO, _AWAY = 3, 0.02, 0.15
_SIGNED = 0.7  # of the error without signs is left with them: half of its squares
_STARTS = 20  # of the search for signs of stretches
_ALTERNATIONS = 50  # fits of coefficients to signs, and of signs to coefficients


def _unsigned(recording: Recording) -> Iterator[Unsigned]:
    """Yield joints whose torque is never negative, and turns back at zero."""
    for joint, column in enumerate(recording.torque.T):
        top = float(np.max(column))
        if np.min(column) < 0.0 or top <= 0.0:
            continue
        starts, stops = _runs(column > _AWAY * top)
        lowest = [
            start + int(np.argmin(column[start:stop]))
            for start, stop in zip(stops[:-1], starts[1:], strict=True)
        ]
        turns = int(np.sum(column[lowest] < _NEAR_ZERO * top))
        if turns >= _TURNS:
            text = (
                "its torque is never negative, and motion explains it with signs that change where"
                f" it is small; it reaches zero {turns} times"
            )
            stretch = np.zeros(column.shape, int)
            stretch[lowest] = 1
            yield Unsigned(joint, np.cumsum(stretch), np.ones(column.shape, bool), text)


# Saturated torques lie within so many standard deviations of the noise; as a part of all samples;
# and are so many times as many as those in each of the three bands of the same width below. A
# smooth peak is in its highest band 1 / (√2 - 1) = 2.4 times as long as in the next.
_BAND, _SATURATED, _PILED = 6.0, 0.01, 3.0
# Joints move from this part of a quantile of their steps on; the noise is less than this part of
# the torque's range; of the highest values, this part may be noise alone.
_MOVES, _FASTEST, _NARROW, _BY_NOISE = 0.1, 0.99, 0.1, 0.2
_RANK = 1e-6  # of singular values that count
# Widths of the noise, and the part of the torque, by which the motion takes more torque than
# saturated ones; and the part of it that a fit to all others leaves at most. (Heuristic.)
_MORE, _MATTERS, _FITS = 1.0, 0.02, 0.2


def _saturated(recording: Recording, valid: np.ndarray) -> Iterator[Saturated]:
    """Yield joints in motion whose torque piles up at one value, noise apart."""
    moved = np.abs(np.gradient(recording.position, axis=0))
    for joint, column in enumerate(recording.torque.T):
        moving = (moved[:, joint] > _MOVES * np.quantile(moved[:, joint], _FASTEST)) & valid[
            :, joint
        ]
        noise = float(noise_level(column[:, None])[0])
        width, extent = _BAND * noise, float(np.ptp(column))
        if moving.sum() < _FEWEST or not TINY < width < _NARROW * extent:
            continue
        for sign, word in ((1.0, "highest"), (-1.0, "lowest")):
            values = sign * column[moving]
            # The highest values except for those that noise alone brings there.
            top = float(np.quantile(values, 1.0 - _BY_NOISE * _SATURATED)) + _BY_NOISE * width
            counts = [
                int(np.sum((values <= top - i * width) & (values > top - (i + 1) * width)))
                for i in range(4)
            ]
            piled = counts[0] > _PILED * max(counts[1], counts[2], counts[3], 1)
            if piled and counts[0] > _SATURATED * values.size:
                spoilt = sign * column > top - width
                text = (
                    f"{100 * counts[0] / values.size:.2g} % of its torques in motion lie within"
                    f" {width:.2g} of the {word}, {sign * (top - 0.5 * width):.4g}"
                )
                yield Saturated(joint, sign, width, spoilt, text)
                break
