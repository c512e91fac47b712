"""Recording of a moving manipulator, and checks that every way into one passes.

Stale rows, which repeat the row before, are found and removed here.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from .._display import curve_figure, html_table
from .._text_table import counted


Samples: TypeAlias = Float[np.ndarray, " samples"]
Signals: TypeAlias = Float[np.ndarray, "samples joints"]

MINIMUM_SAMPLES = 5
"""Fewest samples a recording may hold: two central differences (Eqn 7.2-2) span five."""


LARGEST_VALUE = 1e30
"""No clock and no joint shows more, in any unit; products of such numbers do not overflow."""


class RecordingError(ValueError):
    """A recording, or the file that should hold one, that cannot be used.

    The message is one line: what is wrong, where, and what was expected.

    >>> from jaxcslc.recordings import RecordingError
    >>> issubclass(RecordingError, ValueError)
    True
    """


class Fault(NamedTuple):
    """The first thing that is wrong with a table of samples.

    `row` counts from 0; a `column` of `None` stands for the whole row.
    """

    row: int
    column: str | None
    problem: str


def first_fault(
    columns: Mapping[str, Float[np.ndarray, " rows"]],
    before: Mapping[str, float] | None = None,
) -> Fault | None:
    """Look for the earliest row that no recording may hold.

    Every way into a recording, from arrays, from a file and chunk by chunk, comes through here. A
    cell that is not finite is named before an order of times that it would make meaningless.

    - `columns`: the columns by name, `time` among them.
    - `before`: the row before the first, where the table continues another one.
    """
    time = columns["time"]
    fault: Fault | None = None
    for name, values in columns.items():
        bad = ~(np.abs(values) <= LARGEST_VALUE)
        if bad.any():
            row = int(np.argmax(bad))
            if fault is None or row < fault.row:
                expected = (
                    f"a number up to {LARGEST_VALUE:g}"
                    if np.isfinite(values[row])
                    else "a finite number"
                )
                remedy = "; leave such rows out, or interpolate" if np.isnan(values[row]) else ""
                fault = Fault(row, name, f"{values[row]} where {expected} was expected{remedy}")

    earlier, first = (time[:-1], 1) if before is None else (np.append(before["time"], time[:-1]), 0)
    with np.errstate(invalid="ignore"):
        stuck = time[first:] <= earlier
    if not stuck.any():
        return fault
    row = int(np.argmax(stuck)) + first
    if fault is not None and fault.row <= row:
        return fault

    def previous(name: str) -> float:
        if row > 0:
            return float(columns[name][row - 1])
        assert before is not None
        return before[name]

    if all(columns[name][row] == previous(name) for name in columns):
        return Fault(
            row,
            None,
            "repeats the row before it; expected a new sample in every row: delete repeated rows",
        )
    return Fault(
        row,
        "time",
        f"{float(time[row])!r} s follows {previous('time')!r} s; "
        "expected time to increase strictly",
    )


def check_samples(columns: Mapping[str, Float[np.ndarray, " rows"]]) -> None:
    """**Raises** `RecordingError` for the earliest sample that no recording may hold.

    - `columns`: by name, `time` among them; samples count from 1 in the message.
    """
    samples = len(columns["time"])
    if samples < MINIMUM_SAMPLES:
        raise RecordingError(
            f"{samples} samples; expected at least {MINIMUM_SAMPLES} for an acceleration"
        )
    if fault := first_fault(columns):
        where = "" if fault.column is None else f", {fault.column}"
        raise RecordingError(f"sample {fault.row + 1}{where}: {fault.problem}")


def check_quantities(
    time: Float[np.ndarray, " samples"],
    quantities: Mapping[str, Float[np.ndarray, "rows columns"] | None],
    joint_names: Sequence[str] | None,
) -> None:
    """Check the arrays of a recording by name, `"position"` among them.

    **Raises** `RecordingError`: shapes that disagree, names that are not one per joint, or as
    `check_samples`.
    """
    position = quantities["position"]
    assert position is not None
    samples, joints = time.size, position.shape[1]
    for name, values in quantities.items():
        if values is not None and values.shape != (samples, joints):
            raise RecordingError(
                f"{name} has shape {values.shape}; expected ({samples}, {joints}): "
                f"one row for each of the {samples} times, one column per joint of position"
            )
    if joint_names is not None and len(joint_names) != joints:
        raise RecordingError(
            f"{len(joint_names)} names of joints; expected {joints}, one for each column"
        )
    if joints == 0:
        raise RecordingError("position has no columns; expected one column per joint")
    check_samples(as_columns(time, **quantities))


def column_names(quantity: str, joints: int) -> list[str]:
    """Return `position_1` to `position_n`: how a file names the joints of one quantity."""
    return [f"{quantity}_{joint}" for joint in range(1, joints + 1)]


def as_columns(
    time: Float[np.ndarray, " samples"],
    joint_names: Sequence[str] | None = None,
    /,
    **quantities: Float[np.ndarray, "samples joints"] | None,
) -> dict[str, Float[np.ndarray, " samples"]]:
    """Return a recording's arrays as the columns of a file, numbered or called by joints' names."""
    columns = {"time": time}
    for quantity, values in quantities.items():
        if values is not None:
            labels = joint_names or range(1, values.shape[1] + 1)
            columns |= {f"{quantity}_{x}": v for x, v in zip(labels, values.T, strict=True)}
    return columns


class Recording(eqx.Module):
    """Joint positions and torques of a moving manipulator, sampled in time.

    The torque in row n is the one demanded (or measured) at `time[n]`; a drive that holds its
    demand applies it from `time[n]` to `time[n + 1]` (thesis, Section 7.4).

    **Attributes**

    - `time`: instants of the samples, shape `(samples,)` [s], strictly increasing.
    - `position`: joint positions, shape `(samples, joints)` [rad or m].
    - `torque`: joint torques or forces, shape `(samples, joints)` [N m or N].
    - `velocity`, `acceleration`: shape `(samples, joints)`, or `None` where they were not
        recorded [rad/s, rad/s² or m/s, m/s²].
    - `joint_names`: of the joints, where the recording has such.
    - `notes`: sentences about what was decided in reading it; `identify` repeats them.
    - `torque_measured`: whether torques are measurements of the samples' instants, and not demands
        that a drive holds to the next one. `choose_settings` relies on it where the recording
        itself does not show which torque belongs to a sample.
    - `fixed_motion`: joints that the robot's description takes as fixed, and how far each moves in
      the recording [rad or m].
    - `following_error`: joints that follow others by a law of the robot's description, and how far
      each is off it in the recording [rad or m].

    Those of motion are float64 arrays.

    >>> import numpy as np
    >>> from jaxcslc.recordings import Recording
    >>> time = np.linspace(0.0, 1.0, 11)
    >>> recording = Recording(time, np.sin(time)[:, None], np.zeros((11, 1)))
    >>> recording.samples, recording.joints
    (11, 1)
    """

    time: Float[np.ndarray, " samples"]
    position: Float[np.ndarray, "samples joints"]
    torque: Float[np.ndarray, "samples joints"]
    velocity: Float[np.ndarray, "samples joints"] | None
    acceleration: Float[np.ndarray, "samples joints"] | None
    joint_names: tuple[str, ...] | None = eqx.field(static=True)
    notes: tuple[str, ...] = eqx.field(static=True)
    torque_measured: bool = eqx.field(static=True)
    fixed_motion: tuple[tuple[str, float], ...] = eqx.field(static=True)
    following_error: tuple[tuple[str, float], ...] = eqx.field(static=True)

    def __init__(
        self,
        time: ArrayLike,
        position: ArrayLike,
        torque: ArrayLike,
        velocity: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        *,
        joint_names: Sequence[str] | None = None,
        notes: Sequence[str] = (),
        torque_measured: bool = False,
        fixed_motion: Sequence[tuple[str, float]] = (),
        following_error: Sequence[tuple[str, float]] = (),
    ):
        """**Arguments**

        As the attributes; anything that NumPy can turn into float64 arrays of those shapes.

        **Raises** `RecordingError`: shapes that disagree, fewer than five samples, values that are
        not finite, or time that does not strictly increase. Samples and joints count from 1 in the
        message.
        """
        self.time = as_float("time", time, 1)
        self.position = as_float("position", position, 2)
        self.torque = as_float("torque", torque, 2)
        self.velocity = None if velocity is None else as_float("velocity", velocity, 2)
        self.acceleration = (
            None if acceleration is None else as_float("acceleration", acceleration, 2)
        )
        self.joint_names = None if joint_names is None else tuple(joint_names)
        self.notes = tuple(notes)
        self.torque_measured = torque_measured
        self.fixed_motion = tuple(fixed_motion)
        self.following_error = tuple(following_error)
        # Checked here and not in `__check_init__`, so that the message is this one whether or
        # not a run-time checker of the shape annotations is at work.
        quantities = {
            "position": self.position,
            "torque": self.torque,
            "velocity": self.velocity,
            "acceleration": self.acceleration,
        }
        check_quantities(self.time, quantities, self.joint_names)

    @property
    def samples(self) -> int:
        """Number of samples that were recorded."""
        return self.position.shape[0]

    @property
    def joints(self) -> int:
        """Number of joints that were recorded."""
        return self.position.shape[1]

    def rows(self, selected: slice | Bool[np.ndarray, " samples"]) -> "Recording":
        """Return the recording of some of the samples.

        **Arguments**

        - `selected`: a slice, or True for each sample to keep, shape `(samples,)`.

        **Raises** `RecordingError`: fewer than five are left.
        """
        return self.at_times(self.time[selected], lambda values: values[selected])

    def at_times(
        self,
        time: Float[np.ndarray, " new"],
        change: Callable[[Signals], Float[np.ndarray, "new joints"]],
    ) -> "Recording":
        """Return the recording at other times: `change` is applied to each of its quantities."""
        velocity, acceleration = self.velocity, self.acceleration
        return dataclasses.replace(
            self,
            time=time,
            position=change(self.position),
            torque=change(self.torque),
            velocity=None if velocity is None else change(velocity),
            acceleration=None if acceleration is None else change(acceleration),
        )

    def plot(self) -> Any:
        """Return a `plotly.graph_objects.Figure` of positions, torques and velocities over time.

        A long recording is drawn by every so many samples: some thousand points a curve.

        **Raises** `ImportError` without plotly, with the extra that installs it.

        >>> import jaxcslc as jc
        >>> network = jc.derive(jc.examples.pendulum())
        >>> recording = jc.examples.swing_recording(network, [0.5, 0.3, -0.1, 0.2, 0.05])
        >>> [curve.name for curve in recording.plot().data]
        ['joint 1', 'joint 1']
        """
        panels = {"position [rad or m]": self.position, "torque [N m or N]": self.torque}
        if self.velocity is not None:
            panels["velocity [rad/s or m/s]"] = self.velocity
        return curve_figure(repr(self), self.time - self.time[0], panels, self._labels)

    @property
    def _labels(self) -> tuple[str, ...]:
        return self.joint_names or tuple(f"joint {i + 1}" for i in range(self.joints))

    def __repr__(self) -> str:
        duration = float(self.time[-1] - self.time[0])
        return (
            f"Recording({self.samples} samples of {counted(self.joints, 'joint')},"
            f" {duration:.4g} s, {1.0 / float(np.median(np.diff(self.time))):.4g} Hz)"
        )

    def _repr_html_(self) -> str:
        """Return a table of the joints, for notebooks."""
        columns = {
            "joint": self._labels,
            "lowest position [rad or m]": np.min(self.position, axis=0),
            "highest": np.max(self.position, axis=0),
            "RMS torque [N m or N]": np.sqrt(np.mean(self.torque**2, axis=0)),
            "largest": np.max(np.abs(self.torque), axis=0),
        }
        return html_table(repr(self), columns)

    def between(self, start: float, end: float) -> "Recording":
        """Return a segment of the recording, its times unchanged.

        **Arguments**

        - `start`, `end`: seconds since the first sample; both ends belong to the segment.

        **Raises** `RecordingError`: fewer than five samples are left.

        >>> import numpy as np
        >>> from jaxcslc.recordings import Recording
        >>> time, line = 10.0 + np.arange(100) * 0.1, np.arange(100.0)[:, None]
        >>> Recording(time, line, line).between(1.0, 2.0).time[[0, -1]].tolist()
        [11.0, 12.0]
        """
        time = self.time - self.time[0]
        return self.rows((time >= start) & (time <= end))


def without_stale_rows(recording: Recording) -> Recording:
    """Drop every sample whose values all repeat those of the sample before it.

    A recorder that polls faster than its source delivers writes such rows with a new time and
    old values. They are no measurements: left in, they look like a joint that stops and jumps.
    (Rows that repeat the *time* as well are an error when the recording is made.)

    **Arguments**

    - `recording`: as recorded.

    **Returns** the recording without its stale rows; its time is then not uniform. See `resample`
    for methods that need uniform time.

    **Raises** `RecordingError`: too few samples are left.

    >>> import numpy as np
    >>> from jaxcslc.recordings import Recording, without_stale_rows
    >>> position = np.array([0.0, 0.1, 0.1, 0.3, 0.4, 0.5])[:, None]
    >>> recording = Recording(np.arange(6) * 0.01, position, 2 * position)
    >>> without_stale_rows(recording).time
    array([0.  , 0.01, 0.03, 0.04, 0.05])
    """
    return recording.rows(~stale_rows(recording))


def fresh_rows(recording: Recording, every: int) -> Recording:
    """Keep every so many rows: those at which positions are new.

    A source that is slower than its recorder repeats its positions, while torques may change in
    every row. Of the rows to start from, that with the most changes of positions is taken.

    **Arguments**

    - `recording`: as recorded.
    - `every`: rows for each new one, from 1 to all.

    **Returns** the recording of these rows.

    **Raises**

    - `ValueError`: less than 1, or more than there are.
    - `RecordingError`: too few samples are left.

    >>> import numpy as np
    >>> from jaxcslc.recordings import Recording, fresh_rows
    >>> position = np.repeat(np.arange(10.0), 3)[1:, None]  # a new one in every third row
    >>> recording = Recording(np.arange(29) * 0.01, position, position)
    >>> fresh_rows(recording, 3).position[:4, 0].tolist()
    [1.0, 2.0, 3.0, 4.0]
    """
    if not 1 <= every <= recording.samples:
        raise ValueError(f"every is {every}; expected 1 to {recording.samples} rows")
    changes = np.any(np.diff(recording.position, axis=0) != 0.0, axis=1)
    counts = [int(changes[start::every].sum()) for start in range(every)]
    return recording.rows(slice((int(np.argmax(counts)) + 1) % every, None, every))


def stale_rows(recording: Recording) -> Bool[np.ndarray, " samples"]:
    """Mark the samples, shape `(samples,)`, whose values all repeat those of the sample before.

    >>> import numpy as np
    >>> from jaxcslc.recordings import Recording, stale_rows
    >>> position = np.array([0.0, 0.1, 0.1, 0.3, 0.4])[:, None]
    >>> stale_rows(Recording(np.arange(5) * 0.01, position, position)).tolist()
    [False, False, True, False, False]
    """
    values = _values(recording)
    return np.append(False, np.all(values[1:] == values[:-1], axis=1))


# A stretch of as many equal rows is no chance: even where every second row equals the one a period
# before, a million stretches have one.
_REPEATED_ROWS = 20


def without_repetition(recording: Recording) -> Recording:
    """Omit stretches of twenty rows or more that repeat earlier rows, one after the other.

    Logs that were put together twice, buffers that are sent again and loops of a simulation have
    them. Noise that repeats does not average out, so that they tell nothing new. (Motion that
    repeats has other noise each time, and stays.) The rows that follow move up in time.

    **Arguments**

    - `recording`: as recorded.

    **Returns** the recording itself, or one with fewer rows and a note.

    >>> import numpy as np
    >>> from jaxcslc.recordings import Recording, without_repetition
    >>> second = np.sin(np.arange(50.0))[:, None]
    >>> again = Recording(0.02 * np.arange(150), np.tile(second, (3, 1)), np.tile(second, (3, 1)))
    >>> shorter = without_repetition(again)
    >>> shorter.samples, shorter.notes
    (50, ('100 of 150 rows repeat earlier ones, all values and in the same order: omitted',))
    """
    values = _values(recording)
    # Hashes of rows: sums of their bits by odd factors, modulo 2^64.
    factors = np.random.default_rng(0).integers(2**63, size=values.shape[1], dtype=np.uint64)
    hashes = (values.view(np.uint64) * (2 * factors + 1)).sum(axis=1)
    _, first, number = np.unique(hashes, return_index=True, return_inverse=True)
    lag = np.arange(len(values)) - first[number]
    starts = np.flatnonzero(np.diff(lag, prepend=-1) != 0)
    lengths = np.diff(starts, append=len(lag))
    repeats = np.zeros(len(values), bool)
    for start in starts[(lag[starts] > 0) & (lengths >= _REPEATED_ROWS)]:
        repeats[_repetition(values, int(start), int(lag[start]))] = True
    count = int(np.sum(repeats))
    if count == 0:
        return recording
    intervals = np.diff(recording.time, prepend=recording.time[0])
    # A stretch that follows another begins a usual interval after it.
    intervals[np.diff(repeats, prepend=False)] = np.median(intervals)
    kept = recording.rows(~repeats)
    note = (
        f"{count} of {len(values)} rows repeat earlier ones, all values and in the same order:"
        " omitted"
    )
    time = recording.time[0] + np.cumsum(np.where(repeats, 0.0, intervals))[~repeats]
    return dataclasses.replace(kept, time=time, notes=(*kept.notes, note))


def _repetition(values: Float[np.ndarray, "samples columns"], row: int, lag: int) -> slice:
    """Return the rows around one that are those of `lag` rows before.

    Rows that are alike, as at rest, are among them.
    """
    if not np.array_equal(values[row], values[row - lag]):  # equal hashes by chance
        return slice(row, row)
    start, stop = row, row + 1
    while start > lag and np.array_equal(values[start - 1], values[start - 1 - lag]):
        start -= 1
    while stop < len(values) and np.array_equal(values[stop], values[stop - lag]):
        stop += 1
    return slice(start, stop)


def _values(recording: Recording) -> Float[np.ndarray, "samples columns"]:
    """Return all columns but the time."""
    parts = (recording.position, recording.torque, recording.velocity, recording.acceleration)
    return np.concatenate([part for part in parts if part is not None], axis=1)


def as_float(name: str, values: ArrayLike, dimensions: int) -> np.ndarray:
    """Return values as a float64 array of 1 axis, samples, or 2, samples and joints."""
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise RecordingError(f"{name} is not an array of real numbers: {error}") from error
    if array.ndim != dimensions:
        expected = "(samples,)" if dimensions == 1 else "(samples, joints)"
        raise RecordingError(f"{name} has shape {array.shape}; expected {expected}")
    return array
