from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from jaxtyping import Array, Float

from ...motion import Recording
from ...network import CSLC
from .._held_out import RelativeError
from .._held_out_part import FEWEST_SAMPLES, held_out_from
from ._likelihood_fit import LikelihoodFit, Misfit
from ._problem import Problem
from .search import Minimum
from .selection import SpacingTrial


# Spacings that are tried beside 1: each takes its part of the time.
_SPACINGS = (2, 3, 6)
# Positions with more than so many times the noise of readings move as rigid links do not.
EXCESS = 1.3
# Spacings are judged on the part of each recording that is held out, in so many stretches.
_STRETCHES = 8


class Estimator(Protocol):
    """What is asked of `MaximumLikelihood`, with its options but for the spacing."""

    def fit(
        self,
        network: CSLC,
        recording: Sequence[Recording],
        start: LikelihoodFit | None,
        progress: Callable[[str], None],
    ) -> LikelihoodFit:
        """The most likely coefficients of recordings together."""
        ...

    def misfit(
        self,
        network: CSLC,
        recording: Sequence[Recording],
        k: Float[Array | np.ndarray, " coefficients"],
        torque_noise: Float[np.ndarray, " joints"],
        position_noise: Float[np.ndarray, " joints"],
        calibration: LikelihoodFit | None,
    ) -> Misfit:
        """How well coefficients agree with recordings."""
        ...


def excess_noise(problem: Problem, minimum: Minimum) -> Float[np.ndarray, " joints"]:
    """(n,) estimated noise of positions over that of encoders' steps, or over what readings
    without steps scatter by; the greatest of several recordings.

    Above 1, joints move as the equations of rigid links do not.
    """
    steps = problem.encoder_step > 0.0
    expected = np.where(steps, problem.least_position_noise, problem.scatter)
    return np.max(minimum.position_noise / np.maximum(expected, 1e-300), axis=0)


def spacing_trials(
    estimator: Callable[[int], Estimator],
    network: CSLC,
    recordings: Sequence[Recording],
    plain: LikelihoodFit,
    progress: Callable[[str], None],
) -> tuple[SpacingTrial, ...]:
    """Spacings of positions, judged on motion that was not fitted.

    Likelihoods of different spacings are of different data. So coefficients from the first three
    quarters of recordings, for each spacing, are judged by how well they agree with the last
    quarter when its positions are estimated: all at the largest spacing, which suits rigid links
    best.

    **Arguments**

    - `estimator`: with a spacing.
    - `plain`: a fit to everything with positions at every sample.
    - `progress`: is called with a few words at each step.

    **Returns** a trial for each spacing above 1; none where a recording is too short to be divided,
    or one of its parts has too little motion.
    """
    if min(recording.samples for recording in recordings) < FEWEST_SAMPLES:
        return ()
    early: list[Recording] = []
    late: list[Recording] = []
    rows: list[np.ndarray] = []
    for recording in recordings:
        start, end = float(recording.time[0]), float(recording.time[-1])
        split = held_out_from(recording) - start
        early.append(recording.between(0.0, split))
        late.append(recording.between(split, end - start))
        rows.append(np.arange(recording.samples) < early[-1].samples)
    near = plain.at(np.concatenate(rows))
    fits: dict[int, LikelihoodFit] = {}
    for every in (1, *_SPACINGS):
        words = f"maximum likelihood: trying every {every}"
        start = near if every == 1 else None
        # Where too little motion is left, or rounding ends a search, there is no fit to be judged.
        try:
            fits[every] = estimator(every).fit(
                network, early, start, lambda _, words=words: progress(words)
            )
        except (ValueError, RuntimeError):
            continue
    if 1 not in fits:
        return ()
    largest = max(fits)
    levels = (
        np.sqrt(np.mean(fits[largest].torque_noise ** 2, axis=0)),
        np.sqrt(np.mean(fits[largest].position_noise ** 2, axis=0)),
    )
    judge = estimator(largest)
    try:
        misfits = {
            every: judge.misfit(fit.network, late, fit.k, *levels, fit)
            for every, fit in fits.items()
        }
    except (ValueError, RuntimeError):
        return ()
    counted = np.all([misfit.mask for misfit in misfits.values()], axis=0)
    stretches = np.array_split(np.arange(len(counted)), _STRETCHES)

    def parts(values: np.ndarray) -> list[np.ndarray]:
        return [values[stretch] for stretch in stretches]

    return tuple(
        SpacingTrial(
            every,
            RelativeError.of(parts(misfit.error), parts(misfits[1].error), parts(counted)),
        )
        for every, misfit in misfits.items()
        if every > 1
    )
