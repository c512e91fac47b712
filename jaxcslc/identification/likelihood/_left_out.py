import dataclasses
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Array, Float

from ...motion import Recording
from ...network import CSLC
from .._held_out import RelativeError
from .._held_out_part import FEWEST_SAMPLES, held_out_from
from ._likelihood_fit import LikelihoodFit, Misfit


# The part that is left out is judged in so many stretches, whose spread says what is chance.
_STRETCHES = 8

Trial = TypeVar("Trial", bound=Hashable)


@runtime_checkable
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


@dataclasses.dataclass(frozen=True)
class LeftOut:
    """Recordings divided into motion that is fitted, and a last part that judges the fits.

    Likelihoods of models with different spacings or spectra are not of the same data: how well
    coefficients agree with other motion is.

    **Attributes**

    - `early`, `late`: the parts of each recording.
    - `rows`: (samples,) of all recordings, which are in `early`.
    """

    early: Sequence[Recording]
    late: Sequence[Recording]
    rows: np.ndarray

    @classmethod
    def of(cls, recordings: Sequence[Recording], every: int = 1) -> "LeftOut | None":
        """None where a recording is too short to be divided.

        - `every`: rows are those of positions at every so many samples.
        """
        if min(recording.samples for recording in recordings) < FEWEST_SAMPLES:
            return None
        early: list[Recording] = []
        late: list[Recording] = []
        rows: list[np.ndarray] = []
        for recording in recordings:
            start, end = float(recording.time[0]), float(recording.time[-1])
            split = held_out_from(recording) - start
            early.append(recording.between(0.0, split))
            late.append(recording.between(split, end - start))
            rows.append(np.arange(0, recording.samples, every) < early[-1].samples)
        return cls(early, late, np.concatenate(rows))

    def relative(
        self, judge: Estimator, fits: Mapping[Trial, LikelihoodFit], base: Trial, level: Trial
    ) -> dict[Trial, RelativeError]:
        """Misfit of the late parts by coefficients of each fit, over that of `base`.

        **Arguments**

        - `judge`: how positions of the late parts are estimated.
        - `fits`: to the early parts.
        - `level`: the fit whose noise levels count.

        **Raises** as `Estimator.misfit`: too little motion is left.
        """
        levels = (
            np.sqrt(np.mean(fits[level].torque_noise ** 2, axis=0)),
            np.sqrt(np.mean(fits[level].position_noise ** 2, axis=0)),
        )
        misfits = {
            name: judge.misfit(fit.network, self.late, fit.k, *levels, fit)
            for name, fit in fits.items()
        }
        counted = np.all([misfit.mask for misfit in misfits.values()], axis=0)
        stretches = np.array_split(np.arange(len(counted)), _STRETCHES)

        def parts(values: np.ndarray) -> list[np.ndarray]:
            return [values[stretch] for stretch in stretches]

        first = parts(misfits[base].error)
        return {
            name: RelativeError.of(parts(misfit.error), first, parts(counted))
            for name, misfit in misfits.items()
        }
