"""Choice of torque alignment: what the recording shows, or else the convention."""

from collections.abc import Callable, Sequence

import numpy as np

from ..checks import TorqueLag
from ..least_squares import Settings
from ..recordings import TorqueAlignment


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
    """Settings with the torque alignment that the recording shows, or else the convention.

    **Arguments**

    - `settings`: the best by their score.
    - `alignments`: to choose among, the convention first.
    - `score`: of settings; the least wins.
    - `estimate`: computes the lag of the torque; called if scores do not decide. If it raises
      `ValueError`, the recording is too short to show anything.
    - `interval`: between samples [s].

    **Returns** the settings, with one of the alignments.
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
