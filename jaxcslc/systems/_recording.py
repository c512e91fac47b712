"""Recordings of a system: named columns, their white noise, and patterns of them."""

import dataclasses
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

from ..recordings import (
    DEFAULT_THRESHOLD_FRACTION,
    NORMAL_MEDIAN,
    Derivatives,
    Patterns,
    Preparation,
    RecordingError,
    away_from_reversals,
    check_samples,
    friction_mask,
    friction_thresholds,
    load_columns,
    sixth_differences,
    without_rounding,
)


if TYPE_CHECKING:
    from ._system import System


@dataclasses.dataclass(frozen=True, eq=False)
class SystemRecording:
    """Named columns of measurements, sampled in time.

    **Attributes**

    - `time`: instants of the samples, (samples,) [s], strictly increasing.
    - `columns`: by name, each (samples,), in SI units.

    Both are float64.

    **Raises** `RecordingError` for columns that differ in length, fewer than five samples, values
    that are not finite, or time that does not increase.

    >>> import numpy as np
    >>> from jaxcslc.systems import SystemRecording
    >>> time = np.arange(10) * 0.01
    >>> SystemRecording(time, {"level": np.sqrt(time)}).samples
    10
    """

    time: Float[np.ndarray, " samples"]
    columns: Mapping[str, Float[np.ndarray, " _"]]

    def __post_init__(self) -> None:
        time = np.asarray(self.time, float)
        columns = {name: np.asarray(values, float) for name, values in self.columns.items()}
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "columns", MappingProxyType(columns))
        for name, values in columns.items():
            if values.shape != time.shape:
                raise RecordingError(
                    f"column {name!r} has shape {values.shape}; expected that of time, {time.shape}"
                )
        check_samples({**columns, "time": time})

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.time)

    def column(self, name: str) -> Float[np.ndarray, " samples"]:
        """Return a column, or time.

        **Raises** `RecordingError` if there is none of that name.
        """
        if name == "time":
            return self.time
        if name not in self.columns:
            raise RecordingError(
                f"missing column {name!r}; the recording has {', '.join(('time', *self.columns))}"
            )
        return self.columns[name]

    def stacked(self, names: Iterable[str]) -> Float[np.ndarray, "samples columns"]:
        """Return columns side by side; **raises** as `column`."""
        return np.stack([self.column(name) for name in names], axis=1)


def load_system_recording(
    path: str | os.PathLike[str], system: "System | None" = None
) -> SystemRecording:
    """Reads a recording of named columns.

    **Arguments**

    - `path`: of a `.csv` or `.parquet` file with a column `time` [s].
    - `system`: whose columns are read; all are if omitted.

    **Returns** the recording.

    **Raises** `RecordingError` as `jaxcslc.recordings.load_columns`, also for a missing column.

    >>> import pathlib, tempfile
    >>> from jaxcslc.systems import load_system_recording
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "tank.csv"
    ...     _ = path.write_text("time,level\\n" + "".join(f"{i},{2 * i}\\n" for i in range(6)))
    ...     sorted(load_system_recording(path).columns)
    ['level']
    """
    names = None if system is None else system.column_names
    columns = load_columns(path, names)
    return SystemRecording(columns.pop("time"), columns)


# The relative standard error of the noise of a column is this over the root of its samples: 0.034
# to 0.036 of 2,400 and 0.020 to 0.023 of 6,000 white samples. (A mean square would have 1.26, but
# is spoilt by events that are rare among the differences.)
_LEVEL_ERROR = 1.76


def measurement_noise(system: "System", recording: SystemRecording) -> dict[str, float]:
    """Standard deviation of the white noise in each column of a recording.

    From `jaxcslc.recordings.sixth_differences`: the median of their modulus, which steps of an
    input and other rare events do not raise; or their root mean square where more than half are
    zero, as of an encoder at rest. (`jaxcslc.recordings.noise_level` takes values on a grid for
    readings of an encoder, which here may be an input of a few levels.)

    **Arguments**

    - `system`: whose columns are meant.
    - `recording`: of these columns.

    **Returns** by name of the column, in its unit; 0 for recordings of six samples or fewer.

    **Raises** `RecordingError` for a column that is missing.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.systems import measurement_noise
    >>> tank, exact = jc.examples.tank(samples=4000)
    >>> noise = 0.01 * np.random.default_rng(0).normal(size=4000)
    >>> columns = exact.columns | {"level": exact.columns["level"] + noise}
    >>> levels = measurement_noise(tank, jc.SystemRecording(exact.time, columns))
    >>> {name: round(float(value), 3) for name, value in levels.items()}
    {'level': 0.01, 'inflow': 0.0}
    """
    differences = sixth_differences(recording.stacked(system.column_names), recording.time)
    if not len(differences):
        return dict.fromkeys(system.column_names, 0.0)
    typical = np.median(np.abs(differences), axis=0) / NORMAL_MEDIAN
    levels = np.where(typical > 0.0, typical, np.sqrt(np.mean(differences**2, axis=0)))
    return dict(zip(system.column_names, levels.tolist(), strict=True))


def level_error(samples: int) -> float:
    """Relative standard error of `measurement_noise` for white noise."""
    return _LEVEL_ERROR / math.sqrt(samples)


def with_simulated_noise(
    recording: SystemRecording, noise: Mapping[str, float], draws: int, seed: int
) -> Iterator[SystemRecording]:
    """Return the recording with additional white noise on its columns, different in each draw.

    - `noise`: standard deviations, by column.
    """
    generator = np.random.default_rng(seed)
    for _ in range(draws):
        yield SystemRecording(
            recording.time,
            {
                name: values + noise[name] * generator.normal(size=recording.samples)
                if noise.get(name)
                else values
                for name, values in recording.columns.items()
            },
        )


def check_noise(system: "System", noise: Mapping[str, float]) -> None:
    """**Raises** `ValueError` for noise of no column, and for values that are no deviations."""
    for name, value in noise.items():
        if name not in system.column_names:
            raise ValueError(
                f"noise: no column {name!r}; expected some of {', '.join(system.column_names)}"
            )
        if not 0.0 <= value < math.inf:
            raise ValueError(f"noise: {name} is {value}; expected 0 or more")


def system_patterns(
    system: "System",
    recording: SystemRecording,
    preparation: Preparation | None = None,
) -> Patterns:
    """Return the patterns that a fit gets from a recording of a system.

    States are smoothed and differentiated as the positions of a robot are, inputs aligned as its
    torques are, by the same objects. Equations with the sign of a variable, as in dry friction,
    exclude the samples where it is small, by the threshold that a robot's joints have for static
    friction; where `sign(x)` is zero nothing is known of it.

    **Arguments**

    - `system`: n equations in v variables.
    - `recording`: with a column for each variable.
    - `preparation`: the defaults of `Preparation` if omitted. Its thresholds are for the arguments
      of signs: a fraction of the greatest modulus, or the value itself.

    **Returns** patterns whose motion has v columns, and whose torque has n: the known sides.

    **Raises**

    - `RecordingError`: a column that is missing.
    - `ValueError`: a recording that the smoothing cannot use, options for joints, a selection that
      leaves nothing, or known sides that are not finite.

    >>> import jaxcslc as jc
    >>> from jaxcslc.systems import system_patterns
    >>> patterns = system_patterns(*jc.examples.tank(samples=200))
    >>> patterns.q.shape, patterns.torque.shape
    ((182, 2), (182, 1))
    """
    preparation = Preparation() if preparation is None else preparation
    if preparation.backlash:
        raise ValueError("preparation: backlash applies to robots only; expected backlash=False")
    trim = preparation.trimmed_of(recording.time, max(len(system.states), 1))
    if not 0 <= trim < recording.samples / 2:
        raise ValueError(
            f"trim of {trim} samples at both ends leaves nothing of {recording.samples} samples;"
            f" expected from 0 to {(recording.samples - 1) // 2}"
        )
    inside = slice(trim, recording.samples - trim)
    q, qd, qdd = (values[inside] for values in system_derivatives(system, recording, preparation))
    separation = system.separation
    known = system.evaluate(separation.known, q, qd, qdd)
    for output, name in enumerate(system.outputs):
        regressor = system.evaluate(separation.regressor[output], q, qd, qdd)
        sides = {"its known side": known[:, output]}
        sides |= {
            f"what multiplies {coefficient}": values
            for coefficient, values in zip(separation.names, regressor.T, strict=True)
        }
        for what, values in sides.items():
            if not np.all(finite := np.isfinite(values)):
                first = int(np.argmin(finite))
                raise ValueError(
                    f"equation {name!r}, {what}: {values[first]} at sample {first + trim + 1};"
                    " expected measurements for which it is a finite number"
                )
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
        recorded = recording.stacked(system.variables[i].column_name for i in inputs)
        q[:, inputs] = preparation.aligned(time, recorded)
    if states:
        position = recording.stacked(system.variables[i].column_name for i in states)
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
        for column, i in zip(smoothed.T, states, strict=True):
            if measured[i] is not None:
                target[:, i] = column
                if target is qd:
                    qdd[:, i] = np.gradient(column, time, edge_order=2)
    return q, qd, qdd


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
    absolute = preparation.thresholds is not None
    options = preparation.thresholds if absolute else preparation.threshold_fraction
    listed = np.atleast_1d(np.asarray(DEFAULT_THRESHOLD_FRACTION if options is None else options))
    if len(listed) not in (1, count):
        raise ValueError(
            f"{len(listed)} thresholds for {count} equations; expected one, or one for each"
        )
    value = float(listed[output % len(listed)])
    return np.full(values.shape[1], value) if absolute else friction_thresholds(values, value)
