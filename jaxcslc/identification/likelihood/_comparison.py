import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from .._held_out import RelativeError, Source
from ._likelihood_fit import LikelihoodFit
from .transmission import transmission_lines
from .transmission._choice import choice_line


Estimator = Literal["least-squares", "maximum-likelihood"]
"""Regression on smoothed motion, or positions and coefficients estimated together."""


@dataclasses.dataclass(frozen=True, eq=False)
class EstimatorComparison:
    """Estimators beside each other, on motion that none of them was fitted to.

    **Attributes**

    - `source`: of that motion: `"validation"`, or `"held-out stretch"`: the last part of each
      training recording, predicted by fits to what is before it.
    - `rms`: by estimator, (n,) RMS torque error of smoothed motion over judged samples [N m or N].
    - `rms_all_samples`: the same over all samples.
    - `relative`: misfits of maximum likelihood over those of least squares, what the decision rests
      on: `MaximumLikelihood.misfit`, without a smoothing.
    - `used`: whose coefficients are the report's.
    - `likelihood`: the fit without a smoothing, to all training recordings.
    - `units`: of each joint's torque.

    >>> import numpy as np, jaxcslc as jc
    >>> pendulum = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> network = jc.derive(pendulum, lengths="numeric")
    >>> t = np.arange(600)[:, None] * 0.01
    >>> q, qd, qdd = np.sin(2 * t), 2 * np.cos(2 * t), -4 * np.sin(2 * t)
    >>> torque = np.asarray(network.torque(np.array([0.5, 0.3, -0.1, 0.2, 0.05]), q, qd, qdd))
    >>> torque = torque + 0.01 * np.random.default_rng(0).normal(size=t.shape)
    >>> recording = jc.Recording(t[:, 0], q, torque)
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
        """What a report's file says of it, as plain data."""
        likelihood = self.likelihood
        unknowns = likelihood.unknowns
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
            "torque_lag": _pair(
                "torque_lag" in unknowns, likelihood.torque_lag, likelihood.torque_lag_error
            ),
            "torque_gains": _pair(
                "torque_gains" in unknowns,
                likelihood.torque_gain.tolist(),
                likelihood.torque_gain_error.tolist(),
            ),
            "selection": None if likelihood.selection is None else likelihood.selection.document(),
            "transmission": (
                None if likelihood.transmission is None else likelihood.transmission.document()
            ),
            "transmission_choice": (
                None
                if likelihood.transmission_choice is None
                else likelihood.transmission_choice.document()
            ),
            "lengths": likelihood.lengths.tolist() if likelihood.lengths.any() else None,
            "steps": self.likelihood.steps,
            "converged": self.likelihood.converged,
        }

    def __str__(self) -> str:
        return estimator_text(self.document(), self.units)


def estimator_text(document: Mapping[str, Any], units: Sequence[str]) -> str:
    """Return what a report says of estimators beside each other.

    **Arguments**

    - `document`: an `EstimatorComparison.document`.
    - `units`: of each joint's torque.
    """
    relative = RelativeError(document["change"], document["change_error"], 0)
    lines = [
        f"estimators, {document['held_out']} RMS over judged samples (over all), joint by joint:"
    ]
    for name, values in document["rms"].items():
        pairs = zip(values, document["rms_all_samples"][name], strict=True)
        lines.append(
            f"    {name}: {', '.join(f'{judged:.4g} ({every:.4g})' for judged, every in pairs)}"
        )
    lines.append(
        f"    with positions estimated, the misfit of maximum likelihood is {relative} beside that"
        f" of least squares; the coefficients are those of {document['used']}"
    )
    if document["lengths"] is not None:
        lines.append(f"    {lengths_line(document['lengths'], units)}")
    lines += [f"    {line}" for line in calibration_lines(document)]
    if document["selection"] is not None:
        lines += [f"    {line}" for line in document["selection"]["lines"]]
    return "\n".join(lines)


def calibration_lines(comparison: Mapping[str, Any]) -> list[str]:
    """Lag and gains of torque, and gears, in words; nothing of what was not asked for.

    **Arguments**

    - `comparison`: an `EstimatorComparison.document`.

    >>> entry = {"value": 0.0007, "error": 2e-6}
    >>> calibration_lines({"torque_lag": entry, "torque_gains": None})
    ['torque lag: 0.7 ms ± 0.002 ms']
    """
    lines: list[str] = []
    if lag := comparison.get("torque_lag"):
        lines.append(f"torque lag: {1e3 * lag['value']:.4g} ms ± {1e3 * lag['error']:.2g} ms")
    if gains := comparison.get("torque_gains"):
        pairs = zip(gains["value"], gains["error"], strict=True)
        values = ", ".join(f"{value:.4g} ± {error:.2g}" for value, error in pairs)
        lines.append(f"torque over what was recorded, joint by joint: {values}")
    if choice := comparison.get("transmission_choice"):
        lines.append(choice_line(choice))
    return lines + transmission_lines(comparison.get("transmission"))


def lengths_line(lengths: Sequence[float], units: Sequence[str]) -> str:
    """What friction both estimators have where it yields before it slides.

    **Arguments**

    - `lengths`: (n,) of pre-sliding [rad or m]; 0 of joints without.
    - `units`: of each joint's torque.

    >>> lengths_line([0.04, 0.0], ["N m", "N m"])
    'dry friction of both yields before it slides: joint 1 over 0.04 rad'
    """
    joints = ", ".join(
        f"joint {number} over {length:.3g} {'m' if unit == 'N' else 'rad'}"
        for number, (length, unit) in enumerate(zip(lengths, units, strict=True), start=1)
        if length > 0.0
    )
    return f"dry friction of both yields before it slides: {joints}"


def _pair(asked: bool, value: Any, error: Any) -> dict[str, Any] | None:
    return {"value": value, "error": error} if asked else None
