"""Warnings of a fit."""

from collections.abc import Iterator

import numpy as np

from ..least_squares import MEANINGLESS_CONDITION, Identification
from ..network import AbstractLinearNetwork
from ..recordings import Recording
from ._errors import ErrorTable


def fit_warnings(
    network: AbstractLinearNetwork, recording: Recording, fit: Identification, errors: ErrorTable
) -> Iterator[str]:
    """Warnings about a fit, its training recording and how it explains the recorded torque.

    **Arguments**

    - `network`: n joints.
    - `recording`: of n joints, that was fitted.
    - `fit`: to that recording.
    - `errors`: of the fit, on that recording.

    **Returns** one sentence for a meaningless condition number, and one for each joint that does
    not move, whose torque is constant, or of whose torque's variance the fit explains less than
    half, as with a wrong unit.
    """
    yield from condition_warning(fit)
    names = network.output_names
    for joint in np.flatnonzero(np.ptp(recording.position, axis=0) == 0):
        yield (
            f"{names[joint]} does not move: coefficients that only its motion shows are not"
            " determined"
        )
    deviation = np.std(recording.torque, axis=0)
    rows = zip(names, np.asarray(errors.rms[0]), deviation, network.output_units, strict=True)
    for name, rms, size, unit in rows:
        if size == 0:
            yield f"{name}: the measured torque is constant"
        elif rms > np.sqrt(0.5) * size:
            yield (
                f"{name}: training RMS {rms:.3g} {unit}, torque standard deviation"
                f" {size:.3g} {unit}: the model explains less than half of the variance; check"
                " units (rad, N m) and the signs of positions and torques"
            )


def condition_warning(fit: Identification) -> Iterator[str]:
    """A sentence about a condition number that makes every coefficient meaningless."""
    if not bool(fit.meaningful):
        yield (
            f"condition number {float(fit.condition):.2g} exceeds {MEANINGLESS_CONDITION:.0g}: no"
            " coefficient is well determined, whatever its standard error; use a motion that"
            " excites more, or fewer terms"
        )
