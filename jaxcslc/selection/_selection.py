"""Choice of smoothing, masks and fit by cross-validation: `choose_settings`.

`Scoring` says which samples are judged and how; `settled_alignment` decides on the torque
alignment. Of a long recording, `section_of` is the part whose equations fit into memory.
"""

import contextlib
import dataclasses
import itertools
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from .._environment import core_count, require, require_float64
from .._processes import can_fork, computed_beside
from .._text_table import counted
from ..checks import TorqueLag, small_torque_lag
from ..least_squares import (
    HostColumns,
    Settings,
    Unknowns,
    columns_of,
    computed_on_host,
    unknowns_of,
)
from ..network import CSLC
from ..recordings import (
    Derivatives,
    Patterns,
    Preparation,
    Recording,
    Sampling,
    TorqueAlignment,
    resting_range,
    zero_phase,
)
from ..uncertainty import FOLDS
from ._candidates import Candidates, CoordinateSearch


# Copies of a regressor that choosing settings and judging fits hold at a time, JAX's included.
_COPIES = 12
# Sections that the best is selected from.
_SECTIONS = 32
_LEAST_SAMPLES = 4096
# A longer distance between samples, in sampling intervals, is a gap.
_GAP = 2.5


class Segment(NamedTuple):
    """The part of a long recording that settings are chosen on and fits are judged on.

    - `recording`: of consecutive samples.
    - `description`: where it is, in words.
    """

    recording: Recording
    description: str


def section_of(
    network: CSLC, recording: Recording, memory: float, *, streamed: bool = True
) -> Segment | None:
    """Return the part of a recording whose regressor fits into memory [GB], or None if all of it
    does.

    Of sections of equal length without gaps that start at even distances, that in which joints
    cover the most: the greatest sum of logarithms of the standard deviations of positions and of
    their differences. (Sections apart from each other would have gaps between them, which no
    filter may pass.)

    - `streamed`: whether coefficients are fitted to all of the recording nevertheless.
    """
    if not 0.0 < memory < np.inf:
        raise ValueError(f"memory: expected more than 0 GB, got {memory:g}")
    row = 8 * network.joint_count * network.size
    most = max(int(1e9 * memory / (_COPIES * row)), _LEAST_SAMPLES)
    if recording.samples <= most:
        return None
    starts = np.linspace(0, recording.samples - most, _SECTIONS).astype(int)
    steps = np.diff(recording.time)
    gaps = np.flatnonzero(steps > _GAP * np.median(steps))
    whole = [start for start in starts if not np.any((gaps >= start) & (gaps < start + most))]
    start = max(whole or starts, key=lambda start: _motion(recording, slice(start, start + most)))
    part = recording.rows(slice(start, start + most))
    from_start = part.time - recording.time[0]
    what = "settings, held-out errors, systematic errors and physical consistency are tested on"
    return Segment(
        part,
        f"{what if streamed else 'of this recording are used'} {most} of {recording.samples}"
        f" samples, from {from_start[0]:.4g} s to {from_start[-1]:.4g} s, where joints move most:"
        f" the regressor of all would take more than {memory:g} GB (--memory)"
        + ("; coefficients are fitted to all samples" if streamed else ""),
    )


def sections_of(
    network: CSLC, recordings: Mapping[str, Recording], memory: float
) -> tuple[dict[str, Recording], list[str]]:
    """Cut several recordings to what is fitted together in a memory, shared by their lengths.

    Equations of all are kept until the recordings are compared, so that they are not streamed.
    **Returns** the recordings, and a sentence about each that was cut.
    """
    total = sum(recording.samples for recording in recordings.values())
    sections = {
        name: section_of(network, recording, memory * recording.samples / total, streamed=False)
        for name, recording in recordings.items()
    }
    return (
        {
            name: recordings[name] if section is None else section.recording
            for name, section in sections.items()
        },
        [f"{name}: {part.description}" for name, part in sections.items() if part is not None],
    )


def _motion(recording: Recording, rows: slice) -> float:
    """Return a measure of how much the joints move in a part of a recording."""
    position = recording.position[rows]
    spread = np.std(position, axis=0) * np.std(np.diff(position, axis=0), axis=0)
    return float(np.sum(np.log(np.maximum(spread, 1e-30))))


# Fewer judged samples of a joint in one fold say little.
_FEWEST = 20


@dataclasses.dataclass(frozen=True)
class Scoring:
    """Scoring that all trials of a selection share: folds, and which pairs are judged and how.

    **Attributes**

    - `folds`: how many stretches the recording is cut into.
    - `fold`: the stretch of each sample.
    - `mask`: pairs that count under the strictest candidate.
    - `judged`: those of them that are judged.
    - `interval`: between samples [s].
    - `low_pass`: cut-off of the second, low-passed part of the score [Hz]; or None.
    """

    folds: int
    fold: Int[np.ndarray, " samples"]
    mask: Bool[np.ndarray, "samples joints"]
    judged: Bool[np.ndarray, "samples joints"]
    interval: float
    low_pass: float | None

    @classmethod
    def of(
        cls,
        recording: Recording,
        mask: Bool[np.ndarray, "samples joints"],
        cutoffs: Sequence[float | None],
        *,
        folds: int,
    ) -> "Scoring":
        """Return the scoring of trials on a recording.

        - `mask`: pairs that count under the strictest candidate, of samples that all are fitted to.
        - `cutoffs`: candidates for the parallel filter [Hz]; the others: as of `choose_settings`.

        **Raises** `ValueError`: too many folds, or nothing to judge.
        """
        samples = len(mask)
        most = samples // (2 * _FEWEST)
        if not 2 <= folds <= most:
            if most < 2:
                raise ValueError(
                    f"the recording is too short: {counted(samples, 'sample')} left after"
                    f" smoothing; expected {4 * _FEWEST} or more to choose settings, and several"
                    " seconds of motion of all joints"
                )
            raise ValueError(
                f"{folds} folds of {samples} samples; expected 2 to {most} (folds, --folds), of at"
                f" least {2 * _FEWEST} samples each"
            )
        length = -(-samples // folds)
        interval = float(np.median(np.diff(recording.time)))
        filters = sorted(cutoff for cutoff in cutoffs if cutoff is not None)
        # Smoothing and filters reach across the ends of stretches: half a period of the lowest
        # cut-off, at most an eighth of a stretch, is not judged.
        slowest = 0.5 / (filters[0] * interval) if filters else 0.0
        margin = min(int(np.ceil(slowest)), length // 8)
        fold, within = np.divmod(np.arange(samples), length)
        inside = (within >= margin) & (within < length - margin)
        judged = mask & inside[:, None]
        enough = _by_fold(judged, fold, folds) >= _FEWEST
        if not np.any(enough):
            raise ValueError(
                f"no joint counts in {_FEWEST} samples of any of {folds} stretches; expected more"
                " motion, fewer folds or lower threshold fractions"
            )
        return cls(
            folds=folds,
            fold=fold,
            mask=mask,
            judged=judged & enough[fold],
            interval=interval,
            low_pass=filters[(len(filters) - 1) // 2] if filters else None,
        )

    def judged_errors(
        self, error: Float[np.ndarray, "samples joints"]
    ) -> tuple[Float[np.ndarray, " joints"], float]:
        """Return RMS errors of joints, NaN where nothing is judged, and the score [N m or N].

        - `error`: of all samples, each under coefficients fitted without its stretch.
        """
        whole, cells = self._root_mean_squares(error)
        score = float(np.mean(np.log(cells)))
        if self.low_pass is not None:
            slow = zero_phase(np.where(self.mask, error, 0.0), self.interval, cutoff=self.low_pass)
            _, slow_cells = self._root_mean_squares(slow)
            score = 0.5 * (score + float(np.mean(np.log(slow_cells))))
        return whole, float(np.exp(score)) if np.isfinite(score) else np.inf

    def _root_mean_squares(
        self, error: Float[np.ndarray, "samples joints"]
    ) -> tuple[Float[np.ndarray, " joints"], Float[np.ndarray, " cells"]]:
        """Return the RMS error of each joint, and of each joint in each fold where it is judged."""
        squares = _by_fold(np.where(self.judged, error**2, 0.0), self.fold, self.folds)
        number = _by_fold(self.judged, self.fold, self.folds)
        some = number > 0
        total = np.where(some.any(axis=0), number.sum(axis=0), np.nan)
        whole = np.sqrt(squares.sum(axis=0) / total)
        cells = np.sqrt(squares[some] / number[some])
        # A fold that is met exactly, as without any noise, must not outweigh all others.
        return whole, np.maximum(cells, 1e-9 * np.max(cells))


def _by_fold(
    values: Float[np.ndarray, "samples joints"] | Bool[np.ndarray, "samples joints"],
    fold: Int[np.ndarray, " samples"],
    folds: int,
) -> Float[np.ndarray, "folds joints"]:
    """Sums over the samples of each fold, which follow each other."""
    ends = np.searchsorted(fold, np.arange(folds + 1))
    parts = (values[start:end] for start, end in itertools.pairwise(ends))
    return np.stack([part.sum(axis=0, dtype=float) for part in parts])


# An alignment that lowers the score by a tenth is the right one. On simulated arms with encoder
# noise alone the right one lowered it by 14 to 60 %; with friction, backlash and compliance that no
# term describes, it lowered it by 0.3 to 6 %, and a wrong one by up to 0.5 %.
_CLEAR = 0.1
# How many times likelier than under the convention the estimated lag is to be.
_DECISIVE = 10.0
# How early the torque of a recording is under each alignment [samples].
_EARLY: dict[TorqueAlignment, float] = {"sample": 0.0, "mean": 0.5, "previous": 1.0}


def settled_alignment(
    settings: Settings,
    alignments: Sequence[TorqueAlignment],
    score: Callable[[Settings], float],
    estimate: Callable[[], TorqueLag],
    interval: float,
) -> Settings:
    """Return settings with the torque alignment that the recording shows, or else the convention.

    - `alignments`: to choose among, the convention first; `score`: of settings, the least wins.
    - `estimate`: computes the lag of the torque; called if scores do not decide. If it raises
      `ValueError`, the recording is too short to show anything. `interval`: between samples [s].
    """
    if len(alignments) == 1:
        return settings
    candidates = [settings.with_options(torque_alignment=alignment) for alignment in alignments]
    scores = np.array([score(candidate) for candidate in candidates])
    best, second = np.argsort(scores)[:2]
    if scores[best] < (1.0 - _CLEAR) * scores[second]:
        return candidates[best]
    try:
        lag = estimate()
    except ValueError:
        return candidates[0]
    error = 0.25 * (lag.high - lag.low)  # the interval is about two of them either way
    if not 0.0 < error < np.inf:
        return candidates[0]
    expected = settings.preparation.torque_lag - interval * np.array(
        [_EARLY[alignment] for alignment in alignments]
    )
    logarithms = -0.5 * ((lag.lag - expected) / error) ** 2
    likeliest = int(np.argmax(logarithms))
    decided = logarithms[likeliest] - logarithms[0] > np.log(_DECISIVE)
    return candidates[likeliest if decided else 0]


# Of a shorter recording NumPy's operations take so little that threads wait for the interpreter.
SAMPLES_OF_THREADS = 8192
_MOST_THREADS = 4  # each holds the columns and the equations of a candidate


@dataclasses.dataclass(frozen=True)
class Trial:
    """Candidate, and its errors on samples that it was not fitted to.

    **Attributes**

    - `settings`: the candidate.
    - `error`: (n,) root mean square of the held-out torque error of each joint [N m or N]; NaN
      for a joint that was nowhere judged.
    - `score`: geometric mean of the errors of all folds and joints, as they are and low-passed
      [N m or N]. The smallest wins.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.selection import Trial
    >>> trial = Trial(jc.Settings(jc.Preparation(jc.Butterworth(8.0))), np.array([0.3, 0.2]), 0.24)
    >>> trial.settings.preparation.smoothing.description, trial.score
    ('Butterworth at 8 Hz', 0.24)
    """

    settings: Settings
    error: Float[np.ndarray, " joints"]
    score: float


@dataclasses.dataclass(frozen=True)
class Selection:
    """The settings that cross-validation selects, and all trials.

    **Attributes**

    - `settings`: those of the best trial.
    - `trials`: in the order in which they were made.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.selection import Trial
    >>> narrow, wide = (jc.Settings(jc.Preparation(jc.AveragedSplines(j))) for j in (9, 17))
    >>> trials = (Trial(narrow, np.array([0.3]), 0.3), Trial(wide, np.array([0.2]), 0.2))
    >>> jc.Selection(wide, trials).best.score
    0.2
    >>> jc.Selection(wide, trials).to_pandas()["score"].tolist()
    [0.3, 0.2]
    """

    settings: Settings
    trials: tuple[Trial, ...]

    @property
    def best(self) -> Trial:
        """The trial of the selected settings."""
        return next(trial for trial in self.trials if trial.settings == self.settings)

    def to_pandas(self) -> Any:
        """Return a `pandas.DataFrame`, one row per trial: its settings in words, its score and its
        error of each joint [N m or N].
        """
        pandas = require("pandas", "tables")

        return pandas.DataFrame(
            [
                {
                    "settings": str(trial.settings),
                    "score": trial.score,
                    **{f"error_{j + 1}": float(error) for j, error in enumerate(trial.error)},
                }
                for trial in self.trials
            ]
        )

    def __str__(self) -> str:
        return (
            f"{self.settings} (held-out score {self.best.score:.3g}, out of"
            f" {len(self.trials)} trials)"
        )


def choose_settings(
    network: CSLC,
    recording: Recording,
    candidates: Candidates | None = None,
    *,
    backlash: bool = False,
    folds: int = FOLDS,
) -> Selection:
    """Chooses smoothing, masks and fit by cross-validation on one recording.

    The recording is cut into `folds` stretches of equal length. Each candidate is fitted to all
    but one of them and predicts the torque of that one from its own smoothed motion, for each in
    turn: noise that a smoothing leaves in the accelerations and motion that it takes out of them
    both show as torque error. To make the errors of different candidates comparable,

    - they are errors of the torque as recorded, averaged over two neighbouring samples as the
      alignment 'mean' does by itself, so the torque's own noise is the same in all of them. They
      count once as they are, where noise in the accelerations shows, and once through a low pass
      (the middle one of the candidates for `cutoff`), where wrong coefficients show that torque
      noise would hide;
    - they are taken over the same pairs of joint and sample: those that count under the greatest
      of the threshold fractions, and are further from the ends of their stretch than
      half a period of the lowest cut-off, where smoothing and filters reach across;
    - the score is the geometric mean over stretches and joints, so that neither a strong joint
      nor one odd stretch decides, and units do not matter.

    The search takes one option after the other, in large steps and then in small ones, and goes
    round again until nothing improves; then it tries the other families of smoothings, which must
    lower the score by a fifth: some forty trials instead of the full product. It is deterministic.

    Which torque belongs to a sample shows in the score only where it is small: viscous friction
    absorbs half a sample. Unless one alignment lowers the score by a tenth, the lag between
    motion and torque is estimated with its interval (`estimate_torque_lag`), and an alignment that
    explains it ten times as well as the recording's convention replaces that.

    (On the simulated PUMA 560, with 12 training recordings that differ by their encoders' phases,
    what it chose came within 11 % of the error that static friction leaves to the true
    coefficients, judged on another trajectory.)

    **Arguments**

    - `network`: n joints, p coefficients.
    - `recording`: of n joints.
    - `candidates`: what to choose among; by default `Candidates.suited_to(recording, network)`.
    - `backlash`: leave out the pairs that may be in backlash, in fits and in judging.
    - `folds`: how many stretches.

    **Returns** the selection, with every trial.

    **Raises**

    - `ValueError`: a recording of another number of joints, too many folds or fewer than two, or
      candidates that the recording cannot be treated by.

    >>> import numpy as np, jaxcslc as jc
    >>> network = jc.derive(jc.examples.pendulum())
    >>> exact = jc.examples.swing_recording(network, [0.5, 0.3, -0.1, 0.2, 0.05], samples=2000)
    >>> position = 1e-4 * np.round(exact.position / 1e-4)
    >>> recording = jc.Recording(exact.time, position, exact.torque)
    >>> jc.choose_settings(network, recording).settings.preparation.torque_alignment
    'sample'
    """
    selection, _ = selection_with_motion(
        network, recording, candidates, backlash=backlash, folds=folds
    )
    return selection


def selection_with_motion(
    network: CSLC,
    recording: Recording,
    candidates: Candidates | None = None,
    *,
    backlash: bool = False,
    folds: int = FOLDS,
) -> tuple[Selection, Derivatives | None]:
    """Run `choose_settings`, and return the derivatives under the best settings as well.

    They are None unless they were computed in this process.
    """
    # What friction of the load follows is not known yet, and smoothing does not depend on it.
    network = network.without_load()
    if recording.joints != network.joint_count:
        raise ValueError(
            f"the recording has {recording.joints} joints, {network.robot.name!r} has"
            f" {network.joint_count}"
        )
    require_float64(recording.position, recording.torque)
    if candidates is None:
        candidates = Candidates.suited_to(recording, network)
    trials = _Trials(network, recording, candidates, backlash=backlash, folds=folds)
    with trials.shared() as run, trials.torque_lag() as lag:
        search = CoordinateSearch(partial(trials.scores, run))
        best = search.run(trials.start, candidates.families(), candidates.options())
        best = settled_alignment(
            best,
            candidates.torque_alignments,
            trials.score_of,
            lag,
            trials.scoring.interval,
        )
    chosen_on = Sampling.of(recording)
    selection = Selection(
        dataclasses.replace(best, chosen_on=chosen_on), tuple(trials.by_settings.values())
    )
    return selection, trials.derivatives.get(motion_part(best.preparation))


class _Trials:
    """Fits and judges candidates on one recording; smooths once for each smoothing."""

    def __init__(
        self,
        network: CSLC,
        recording: Recording,
        candidates: Candidates,
        *,
        backlash: bool,
        folds: int,
    ):
        self.network = network
        self.recording = recording
        self.by_settings: dict[Settings, Trial] = {}
        self.derivatives: dict[Preparation, Derivatives] = {}
        self._ranges = resting_range(recording.position)
        self._columns: tuple[Preparation, HostColumns, Unknowns] | None = None
        self.start = candidates.start().with_options(backlash=backlash)
        # The same ends are cut off for all, so that all are fitted and judged on the same samples.
        self.trim = max(
            Preparation(smoothing, torque_lag=lag).trimmed(recording)
            for smoothing in candidates.smoothings
            for lag in candidates.torque_lags
        )
        strictest = dataclasses.replace(
            self.start.preparation,
            torque_alignment="sample",
            torque_lag=0.0,
            threshold_fraction=max(candidates.threshold_fractions, key=np.mean),
            trim=self.trim,
        )
        patterns = strictest.patterns(recording, self._motion(strictest))
        self.scoring = Scoring.of(
            recording, np.asarray(patterns.mask), candidates.cutoffs, folds=folds
        )

    @contextlib.contextmanager
    def shared(self) -> Generator[Callable[[Sequence[Settings]], Iterable[Trial]]]:
        """The trials of candidates, by threads where that is worth it."""
        if self.recording.samples < SAMPLES_OF_THREADS:
            yield partial(map, self._trial)
            return
        # The same threads throughout: what new ones allocate, the process would keep.
        with ThreadPoolExecutor(min(core_count(), _MOST_THREADS)) as pool:
            yield partial(self._in_threads, pool)

    @contextlib.contextmanager
    def torque_lag(self) -> Generator[Callable[[], TorqueLag]]:
        """A function that estimates the lag of the torque, or waits for a process that does.

        Next to the search it costs no time, and nearly every search needs it.
        """
        estimate = partial(small_torque_lag, self.network, self.recording)
        if can_fork() and computed_on_host(self.network, self.recording.position):
            with computed_beside(estimate) as lag:
                yield lag
        else:
            yield estimate

    def score_of(self, settings: Settings) -> float:
        """The score of settings, computed once."""
        trial = self.by_settings.get(settings)
        return (
            self.scores(partial(map, self._trial), [settings])[0] if trial is None else trial.score
        )

    def scores(
        self, run: Callable[[Sequence[Settings]], Iterable[Trial]], candidates: Sequence[Settings]
    ) -> list[float]:
        """The scores of candidates that have no trial yet.

        - `run`: as of `shared`.
        """
        trials = list(run(candidates))
        self.by_settings |= {trial.settings: trial for trial in trials}
        return [trial.score for trial in trials]

    def _in_threads(
        self, pool: ThreadPoolExecutor, candidates: Sequence[Settings]
    ) -> Iterable[Trial]:
        by_motion = {motion_part(settings.preparation): settings for settings in candidates}
        if len(by_motion) < len(candidates):  # threads would repeat what candidates share
            for settings in by_motion.values():
                self._columns_of(settings.preparation, self._patterns(settings))
        return pool.map(self._trial, candidates)

    def _trial(self, settings: Settings) -> Trial:
        """Fits settings to all stretches but one, for each, and judges them there."""
        patterns = self._patterns(settings)
        columns, unknowns = self._columns_of(settings.preparation, patterns)
        error = settings.solver.held_out_errors(
            self.network, patterns, self.scoring.fold, columns, unknowns
        )
        if settings.preparation.torque_alignment != "mean":
            # A torque averaged over two samples has less noise: that must not speak for averaging.
            error = 0.5 * (error + np.concatenate([error[:1], error[:-1]]))
        return Trial(settings, *self.scoring.judged_errors(error))

    def _patterns(self, settings: Settings) -> Patterns:
        preparation = dataclasses.replace(settings.preparation, trim=self.trim)
        return preparation.patterns(self.recording, self._motion(preparation))

    def _columns_of(
        self, preparation: Preparation, patterns: Patterns
    ) -> tuple[HostColumns, Unknowns]:
        """The columns of a motion; kept until those of another one are computed."""
        motion, latest = motion_part(preparation), self._columns
        if latest is None or latest[0] != motion:
            del latest
            self._columns = None  # the next ones take its memory, whose pages are there
            columns = columns_of(self.network, patterns)
            unknowns = unknowns_of(self.network, patterns, columns)
            latest = self._columns = motion, columns, unknowns
        return latest[1:]

    def _motion(self, preparation: Preparation) -> Derivatives:
        motion = motion_part(preparation)
        if motion not in self.derivatives:
            self.derivatives[motion] = motion.derivatives(self.recording, self._ranges)
        return self.derivatives[motion]


def motion_part(preparation: Preparation) -> Preparation:
    """Return the settings that positions, velocities and accelerations depend on."""
    return Preparation(preparation.smoothing, preparation.velocity)
