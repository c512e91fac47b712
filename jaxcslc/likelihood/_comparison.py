"""Least squares and maximum likelihood next to each other, and the motion that judges them."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float

from ..recordings import Recording
from ..uncertainty import FEWEST_SAMPLES, RelativeError, Source, held_out_from
from ._likelihood_fit import LikelihoodFit


Estimator = Literal["least-squares", "maximum-likelihood"]
"""Regression on smoothed motion, or positions and coefficients estimated together."""


@dataclasses.dataclass(frozen=True, eq=False)
class EstimatorComparison:
    """Estimators beside each other, on motion that none of them was fitted to.

    **Attributes**

    - `source`: of that motion: `"held-out stretch"`, the last part of each training recording,
      predicted by fits to what is before it.
    - `rms`: by estimator, (n,) RMS torque error of smoothed motion over judged samples [N m or N].
    - `rms_all_samples`: the same over all samples.
    - `relative`: misfits of maximum likelihood over those of least squares, what the decision rests
      on: `MaximumLikelihood.misfit`, without a smoothing.
    - `used`: whose coefficients are the report's.
    - `likelihood`: the fit without a smoothing, to all training recordings.
    - `units`: of each joint's torque.

    >>> import jaxcslc as jc
    >>> network = jc.derive(jc.examples.pendulum(), lengths="numeric")
    >>> k = [0.5, 0.3, -0.1, 0.2, 0.05]
    >>> motion = jc.examples.swing(network, k, samples=600, torque_noise=0.01)
    >>> recording = jc.Recording(motion.time, motion.q, motion.torque)
    >>> report = jc.identify(
    ...     network, recording, settings=jc.Settings(), estimator="maximum-likelihood"
    ... )
    >>> report.estimators.used, tuple(report.estimators.rms)
    ('maximum-likelihood', ('least-squares', 'maximum-likelihood'))
    """

    source: Source
    rms: Mapping[Estimator, Float[np.ndarray, " joints"]]
    rms_all_samples: Mapping[Estimator, Float[np.ndarray, " joints"]]
    relative: RelativeError
    used: Estimator
    likelihood: LikelihoodFit
    units: tuple[str, ...]

    def document(self) -> dict[str, Any]:
        """Return what a report's file says of it, as plain data."""
        likelihood = self.likelihood
        return {
            "used": self.used,
            "held_out": self.source,
            "rms": {name: values.tolist() for name, values in self.rms.items()},
            "rms_all_samples": {
                name: values.tolist() for name, values in self.rms_all_samples.items()
            },
            "change": self.relative.change,
            "change_error": self.relative.change_error,
            "torque_noise": self.likelihood.torque_noise.tolist(),
            "position_noise": self.likelihood.position_noise.tolist(),
            "spacing": None if likelihood.spacing is None else likelihood.spacing.document(),
            "lengths": likelihood.presliding_distance.tolist()
            if likelihood.presliding_distance.any()
            else None,
            "steps": self.likelihood.steps,
            "converged": self.likelihood.converged,
        }

    def __str__(self) -> str:
        return estimator_text(self.document(), self.units)


def estimator_text(document: Mapping[str, Any], units: Sequence[str]) -> str:
    """Return what a report says of estimators beside each other.

    - `document`: an `EstimatorComparison.document`.
    - `units`: of each joint's torque.
    """
    relative = RelativeError(document["change"], document["change_error"], 0)
    lines = [f"estimators, {document['held_out']} RMS over unmasked samples (over all), per joint:"]
    for name, values in document["rms"].items():
        pairs = zip(values, document["rms_all_samples"][name], strict=True)
        lines.append(
            f"    {name}: {', '.join(f'{judged:.4g} ({every:.4g})' for judged, every in pairs)}"
        )
    lines.append(
        f"    likelihood misfit, positions estimated: maximum likelihood {relative} relative to"
        f" least squares; coefficients used: {document['used']}"
    )
    if document["lengths"] is not None:
        lines.append(f"    {presliding_line(document['lengths'], units)}")
    if document["spacing"] is not None:
        lines += [f"    {line}" for line in document["spacing"]["lines"]]
    return "\n".join(lines)


def presliding_line(presliding_distance: Sequence[float], units: Sequence[str]) -> str:
    """Return the pre-sliding distances of both estimators as a sentence.

    - `presliding_distance`: (n,) [rad or m]; 0 of joints without.
    - `units`: of each joint's torque.

    >>> presliding_line([0.04, 0.0], ["N m", "N m"])
    'pre-sliding friction of both estimators, distance: joint 1 0.04 rad'
    """
    joints = ", ".join(
        f"joint {number} {length:.3g} {'m' if unit == 'N' else 'rad'}"
        for number, (length, unit) in enumerate(
            zip(presliding_distance, units, strict=True), start=1
        )
        if length > 0.0
    )
    return f"pre-sliding friction of both estimators, distance: {joints}"


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
