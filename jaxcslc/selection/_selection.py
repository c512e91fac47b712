"""Choice of smoothing, masks and fit by cross-validation: `choose_settings`.

Read with `_candidates`, `_search` and `_scoring`.
"""

import contextlib
import dataclasses
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from .._environment import core_count, require, require_float64
from .._processes import SharedMap, can_fork, computed_beside
from ..checks import TorqueLag, small_torque_lag
from ..least_squares import HostColumns, Settings, columns_of, computed_on_host
from ..network import CSLC
from ..recordings import Derivatives, Patterns, Preparation, Recording, Sampling
from ._alignment import settled_alignment
from ._candidates import Candidates
from ._scoring import Scoring
from ._search import CoordinateSearch


# Of a shorter recording NumPy's operations take so little that threads wait for the interpreter.
_SAMPLES_OF_THREADS = 8192
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
        """A `pandas.DataFrame`, one row a trial: its settings in words, its score and its error of
        each joint [N m or N]."""
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
    folds: int = 8,
    gap: float | None = None,
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
      of the threshold fractions, and are further than `gap` from the ends of their stretch, where
      smoothing and filters reach across;
    - the score is the geometric mean over stretches and joints, so that neither a strong joint
      nor one odd stretch decides, and units do not matter.

    The search takes one option after the other, in large steps and then in small ones, and goes
    round again until nothing improves; then it tries the other families of smoothings, which must
    lower the score by a fifth: some forty trials instead of the full product. It is deterministic.

    Which torque belongs to a sample shows in the score only where it is small: viscous friction
    makes up for half a sample. Unless one alignment lowers the score by a tenth, the lag between
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
    - `gap`: how far inside its stretch a sample must be to be judged [s]; by default half a
      period of the lowest cut-off of all candidates, but at most an eighth of a stretch.

    **Returns** the selection, with every trial.

    **Raises**

    - `ValueError`: a recording of another number of joints, too many folds or fewer than two, a
      gap that leaves nothing to judge, or candidates that the recording cannot be treated by.

    >>> import jax.numpy as jnp, numpy as np, jaxcslc as jc
    >>> pendulum = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> network = jc.derive(pendulum, lengths="numeric")
    >>> t = np.arange(2000)[:, None] * 0.002
    >>> q, qd, qdd = np.sin(5 * t), 5 * np.cos(5 * t), -25 * np.sin(5 * t)
    >>> torque = np.asarray(network.torque(jnp.array([0.5, 0.3, -0.1, 0.2, 0.05]), q, qd, qdd))
    >>> recording = jc.Recording(t[:, 0], 1e-4 * np.round(q / 1e-4), torque)
    >>> choice = jc.choose_settings(network, recording)
    >>> choice.settings.preparation.torque_alignment
    'sample'
    """
    selection, _ = selection_with_motion(
        network, recording, candidates, backlash=backlash, folds=folds, gap=gap
    )
    return selection


def selection_with_motion(
    network: CSLC,
    recording: Recording,
    candidates: Candidates | None = None,
    *,
    backlash: bool = False,
    folds: int = 8,
    gap: float | None = None,
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
    trials = _Trials(network, recording, candidates, backlash=backlash, folds=folds, gap=gap)
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
        gap: float | None,
    ):
        self.network = network
        self.recording = recording
        self.by_settings: dict[Settings, Trial] = {}
        self.derivatives: dict[Preparation, Derivatives] = {}
        self._columns: tuple[Preparation, HostColumns] | None = None
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
            recording, np.asarray(patterns.mask), candidates.cutoffs, folds=folds, gap=gap
        )

    @contextlib.contextmanager
    def shared(self) -> Generator[Callable[[Sequence[Settings]], Iterable[Trial]]]:
        """The trials of candidates, by processes or threads where that is worth it."""
        if self._forks():
            # What all processes need of the network is prepared once, with the first columns.
            self._columns_of(self.start.preparation, self._patterns(self.start))
            with SharedMap(self._trial) as run:
                yield run
        elif self.recording.samples >= _SAMPLES_OF_THREADS:
            # The same threads throughout: what new ones allocate, the process would keep.
            with ThreadPoolExecutor(min(core_count(), _MOST_THREADS)) as pool:
                yield partial(self._in_threads, pool)
        else:
            yield partial(map, self._trial)

    @contextlib.contextmanager
    def torque_lag(self) -> Generator[Callable[[], TorqueLag]]:
        """A function that estimates the lag of the torque, or waits for a process that does.

        Beside the search it costs no time, and hardly a search does without it.
        """
        estimate = partial(small_torque_lag, self.network, self.recording)
        if self._forks():
            with computed_beside(estimate) as lag:
                yield lag
        else:
            yield estimate

    def _forks(self) -> bool:
        return can_fork() and computed_on_host(self.network, self.recording.position)

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
        columns = self._columns_of(settings.preparation, patterns)
        error = settings.solver.held_out_errors(self.network, patterns, self.scoring.fold, columns)
        if settings.preparation.torque_alignment != "mean":
            # A torque averaged over two samples has less noise: that must not speak for averaging.
            error = 0.5 * (error + np.concatenate([error[:1], error[:-1]]))
        return Trial(settings, *self.scoring.judged_errors(error))

    def _patterns(self, settings: Settings) -> Patterns:
        preparation = dataclasses.replace(settings.preparation, trim=self.trim)
        return preparation.patterns(self.recording, self._motion(preparation))

    def _columns_of(self, preparation: Preparation, patterns: Patterns) -> HostColumns:
        """The columns of a motion; kept until those of another one are computed."""
        motion, latest = motion_part(preparation), self._columns
        if latest is None or latest[0] != motion:
            del latest
            self._columns = None  # the next ones take its memory, whose pages are there
            latest = self._columns = motion, columns_of(self.network, patterns)
        return latest[1]

    def _motion(self, preparation: Preparation) -> Derivatives:
        motion = motion_part(preparation)
        if motion not in self.derivatives:
            self.derivatives[motion] = motion.derivatives(self.recording)
        return self.derivatives[motion]


def motion_part(preparation: Preparation) -> Preparation:
    """Return the settings that positions, velocities and accelerations depend on."""
    return Preparation(preparation.smoothing, preparation.velocity)
