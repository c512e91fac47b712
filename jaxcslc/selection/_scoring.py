"""Held-out score of settings: folds, judged pairs, and errors."""

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from ..recordings import Recording, zero_phase


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
        gap: float | None,
    ) -> "Scoring":
        """The scoring of trials on a recording.

        **Arguments**

        - `mask`: pairs that count under the strictest candidate, of the samples that all
          candidates are fitted to.
        - `cutoffs`: candidates for the parallel filter [Hz].
        - `folds`, `gap`: as of `choose_settings`.

        **Raises**

        - `ValueError`: too many folds or fewer than two, or a gap that leaves nothing to judge.
        """
        samples = len(mask)
        most = samples // (2 * _FEWEST)
        if not 2 <= folds <= most:
            raise ValueError(
                f"{folds} folds of {samples} samples; expected from 2 to {most}, so that there is"
                " something to judge in each (option folds)"
            )
        length = -(-samples // folds)
        interval = float(np.median(np.diff(recording.time)))
        filters = sorted(cutoff for cutoff in cutoffs if cutoff is not None)
        if gap is None:
            slowest = 0.5 / (filters[0] * interval) if filters else 0.0
            margin = min(int(np.ceil(slowest)), length // 8)
        else:
            margin = int(np.ceil(gap / interval)) if 0.0 <= gap < length * interval else -1
        if not 0 <= 2 * margin < length:
            raise ValueError(
                f"a gap of {gap} s at both ends of a stretch of {length * interval:.3g} s;"
                " expected at least 0 and less than half the stretch"
            )
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
        """Root mean squares of joints, and the score.

        **Arguments**

        - `error`: torque error of all samples, each under coefficients fitted without its
          stretch [N m or N].

        **Returns**

        The error of each joint, NaN where nothing is judged, and the geometric mean of the
        errors of all stretches and joints, as they are and low-passed [N m or N].
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
