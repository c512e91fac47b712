"""Patterns of a system from a recording: smoothed states, aligned inputs, masks."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float

from ..recordings import (
    DEFAULT_THRESHOLD_FRACTION,
    Derivatives,
    Patterns,
    Preparation,
    away_from_reversals,
    friction_mask,
    friction_thresholds,
    without_rounding,
)
from ._recording import SystemRecording


if TYPE_CHECKING:
    from ._system import System


def system_patterns(
    system: "System",
    recording: SystemRecording,
    preparation: Preparation | None = None,
    derivatives: Derivatives | None = None,
) -> Patterns:
    """Return the patterns that a fit gets from a recording of a system.

    States are smoothed and differentiated as the positions of a robot are, inputs aligned as its
    torques are, by the same objects. Equations with the sign of a variable, as in dry friction,
    leave out the samples where it is small, by the threshold that a robot's joints have for static
    friction; where `sign(x)` is zero nothing is known of it.

    **Arguments**

    - `system`: n equations in v variables.
    - `recording`: with a column for each variable.
    - `preparation`: the defaults of `Preparation` if omitted. Its thresholds are for the arguments
      of signs: a fraction of the greatest modulus, or the value itself.
    - `derivatives`: values and derivatives of the variables at all samples, if they are known
      already; by default those of `system_derivatives`.

    **Returns** patterns whose motion has v columns, and whose torque has n: the known sides.

    **Raises**

    - `RecordingError`: a column that is missing.
    - `ValueError`: a recording that the smoothing cannot use, options for joints, a selection that
      leaves nothing, or known sides that are not finite.

    >>> import numpy as np, sympy
    >>> from sympy.physics.mechanics import dynamicsymbols
    >>> from jaxcslc.systems import Constant, System, SystemRecording, Variable, system_patterns
    >>> level, inflow = dynamicsymbols("level inflow")
    >>> area = sympy.Symbol("area")
    >>> tank = System(
    ...     "tank", {"volume": sympy.Eq(inflow, area * level.diff())},
    ...     (Variable(level, "m"), Variable(inflow, "m³/s")), (Constant(area, "m²"),),
    ... )
    >>> time = np.arange(200) * 0.1
    >>> recording = SystemRecording(time, {"level": np.sin(time), "inflow": 2 * np.cos(time)})
    >>> patterns = system_patterns(tank, recording)
    >>> patterns.q.shape, patterns.torque.shape
    ((182, 2), (182, 1))
    """
    preparation = Preparation() if preparation is None else preparation
    if preparation.backlash:
        raise ValueError("preparation: possible backlash is of joints; expected backlash=False")
    if derivatives is None:
        derivatives = system_derivatives(system, recording, preparation)
    trim = preparation.trimmed_of(recording.time, max(len(system.states), 1))
    if not 0 <= trim < recording.samples / 2:
        raise ValueError(
            f"trim of {trim} samples at both ends leaves nothing of {recording.samples} samples;"
            f" expected from 0 to {(recording.samples - 1) // 2}"
        )
    inside = slice(trim, recording.samples - trim)
    q, qd, qdd = (values[inside] for values in derivatives)
    separation = system.separation
    known = system.evaluate(separation.known, q, qd, qdd)
    for name, values in zip(system.outputs, known.T, strict=True):
        _check_finite(values, f"equation {name!r}, its known side", trim)
    for name, row in zip(system.outputs, separation.regressor, strict=True):
        for coefficient, values in zip(
            separation.names, system.evaluate(row, q, qd, qdd).T, strict=True
        ):
            _check_finite(values, f"equation {name!r}, what multiplies {coefficient}", trim)
    mask = _mask(system, preparation, (q, qd, qdd))
    if not np.any(mask):
        raise ValueError(
            f"masking leaves nothing of {len(mask)} samples of {len(system.outputs)} equations;"
            " expected some above the thresholds of their signs"
        )
    return Patterns(
        recording.time[inside], q, qd, qdd, known, np.ones(known.shape, dtype=bool), mask
    )


def system_derivatives(
    system: "System", recording: SystemRecording, preparation: Preparation
) -> Derivatives:
    """Values and first and second derivatives of all variables, (samples, v) each.

    Derivatives that were measured are low-passed by the smoothing of the states; inputs are aligned
    and have none.
    """
    time, smoothing = recording.time, preparation.smoothing
    shape = (recording.samples, len(system.variables))
    q, qd, qdd = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    states, inputs = system.states, system.inputs
    if inputs:
        recorded = [recording.column(system.variables[i].column_name) for i in inputs]
        q[:, inputs] = preparation.aligned(time, np.stack(recorded, axis=1))
    if states:
        position = np.stack([recording.column(system.variables[i].column_name) for i in states], 1)
        smoothed = without_rounding(position, smoothing.smooth(time, position))
        q[:, states], qd[:, states], qdd[:, states] = smoothed
    for name, target in (("rate", qd), ("second_rate", qdd)):
        measured = {i: getattr(system.variables[i], name) for i in states}
        if not any(measured.values()):
            continue
        # All states at once: a smoothing may have a width for each. Unmeasured ones stand in.
        recorded = [
            q[:, i] if column is None else recording.column(column)
            for i, column in measured.items()
        ]
        smoothed = smoothing.low_pass(time, np.stack(recorded, axis=1))
        for column, (i, present) in zip(smoothed.T, measured.items(), strict=True):
            if present is not None:
                target[:, i] = column
                if target is qd:
                    qdd[:, i] = np.gradient(column, time, edge_order=2)
    return q, qd, qdd


def _check_finite(values: Float[np.ndarray, " samples"], what: str, trim: int) -> None:
    """**Raises** `ValueError` naming the first sample that is not finite, counted from 1."""
    finite = np.isfinite(values)
    if not np.all(finite):
        first = int(np.argmin(finite))
        raise ValueError(
            f"{what}: {values[first]} at sample {first + trim + 1}; expected measurements for which"
            " it is a finite number"
        )


def _mask(
    system: "System", preparation: Preparation, motion: Derivatives
) -> Bool[np.ndarray, "samples outputs"]:
    """False where an equation contains the sign of something that is nearly zero."""
    masks: list[np.ndarray] = []
    for output in range(len(system.outputs)):
        arguments = system.signs[output]
        mask = np.ones(len(motion[0]), dtype=bool)
        if arguments:
            values = system.evaluate(arguments, *motion)
            thresholds = _thresholds(preparation, values, output, len(system.outputs))
            slow = friction_mask(values, thresholds)
            slow &= away_from_reversals(values, preparation.reversal_margin)
            mask = np.all(slow, axis=1)
        masks.append(mask)
    return np.stack(masks, axis=1)


def _thresholds(
    preparation: Preparation, values: Float[np.ndarray, "samples signs"], output: int, count: int
) -> Float[np.ndarray, " signs"]:
    """Return the thresholds of the arguments of the signs in one equation."""

    def of_output(options: float | int | Sequence[float | int]) -> float:
        listed = np.atleast_1d(np.asarray(options, float))
        if len(listed) not in (1, count):
            raise ValueError(
                f"{len(listed)} thresholds for {count} equations; expected one, or one for each"
            )
        return float(listed[output if len(listed) > 1 else 0])

    if preparation.thresholds is not None:
        return np.full(values.shape[1], of_output(preparation.thresholds))
    fraction: Any = preparation.threshold_fraction
    fraction = DEFAULT_THRESHOLD_FRACTION if fraction is None else fraction
    return friction_thresholds(values, of_output(fraction))
