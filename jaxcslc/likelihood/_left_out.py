"""Recordings divided into motion that is fitted, and a last part that judges the fits."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool

from ..recordings import Recording
from ..uncertainty import FEWEST_SAMPLES, held_out_from


@dataclasses.dataclass(frozen=True)
class LeftOut:
    """Recordings without a last part, which judges the fits.

    **Attributes**

    - `early`: what is before that part of each.
    - `rows`: (samples,) of all recordings, which are in `early`.
    """

    early: Sequence[Recording]
    rows: Bool[np.ndarray, " samples"]

    @classmethod
    def of(cls, recordings: Sequence[Recording], every: int = 1) -> "LeftOut | None":
        """Divide recordings; None where one is too short.

        - `every`: rows are those of positions at every so many samples.
        """
        if min(recording.samples for recording in recordings) < FEWEST_SAMPLES:
            return None
        early: list[Recording] = []
        rows: list[np.ndarray] = []
        for recording in recordings:
            split = held_out_from(recording) - float(recording.time[0])
            early.append(recording.between(0.0, split))
            rows.append(np.arange(0, recording.samples, every) < early[-1].samples)
        return cls(early, np.concatenate(rows))
