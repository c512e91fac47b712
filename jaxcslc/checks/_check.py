"""Entry point of the checks: `check` and its result, `DataCheck`."""

import contextlib
import dataclasses
import html
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from .._display import bar_figure, html_table
from .._text_table import text_table
from ..manipulator import UNUSED_LINKS, JointLimits
from ..network import CSLC, derive
from ..recordings import MINIMUM_SAMPLES, Recording, encoder_resolution, stale_rows
from ._channel_findings import Channels, Saturated, Unsigned
from ._evidence import Evidence, from_its_start
from ._findings import SPOILING_KINDS, Finding, finding
from ._motion_findings import agreement_findings, motion_findings, rate_findings
from ._sample_findings import (
    REPEATED,
    Outliers,
    clipping,
    clock_findings,
    repeats_row_before,
    sample_findings,
    time_unit,
)


@dataclasses.dataclass(frozen=True)
class DataCheck:
    """Result of `check`: summaries of recordings, and what looks wrong with them.

    `print` shows the page that `jaxcslc check` prints.

    **Attributes**

    - `recordings`: a summary of each.
    - `findings`: what looks wrong; of each recording, the likeliest cause first.

    >>> from jaxcslc import DataCheck, Finding
    >>> lost = Finding("gap", "", "no samples from 2 s to 5 s", "rows were lost", "record again")
    >>> print(DataCheck((), (lost,)))
    warning: gap: no samples from 2 s to 5 s. Likely cause: rows were lost. Remedy: record again
    """

    recordings: "tuple[RecordingSummary, ...]"
    findings: tuple[Finding, ...]

    def unexplained(self, warnings: Sequence[str]) -> tuple[str, ...]:
        """Return the warnings of a fit, unless a finding explains them.

        - `warnings`: about errors and coefficients of a fit to the recordings.

        >>> from jaxcslc import DataCheck, Finding
        >>> degrees = Finding("angle unit", "", "", "positions are in degrees", "")
        >>> print(*DataCheck((), (degrees,)).unexplained(["elbow: a large error"]))
        1 warning about errors and bodies is omitted: positions are in degrees; fix that first
        """
        causes = [found.cause for found in self.findings if found.kind in SPOILING_KINDS]
        if not causes or not warnings:
            return tuple(warnings)
        many = "1 warning" if len(warnings) == 1 else f"{len(warnings)} warnings"
        are = "is" if len(warnings) == 1 else "are"
        return (
            f"{many} about errors and bodies {are} omitted: {'; '.join(causes)}; fix that first",
        )

    def plot(self) -> Any:
        """Return a `plotly.graph_objects.Figure` of ranges, speeds and torques of all joints.

        **Raises** `ImportError` without plotly, with the extra that installs it.

        >>> import jaxcslc as jc
        >>> network = jc.derive(jc.examples.pendulum(), lengths="numeric")
        >>> recording = jc.examples.swing_recording(network, [0.5, 0.3, -0.1, 0.2, 0.05])
        >>> [bar.name for bar in jc.check(network, recording).plot().data]
        ['recording 1', 'recording 1', 'recording 1']
        """
        panels: dict[str, dict[str, tuple[list[float], list[float]]]] = {
            "range of position [rad or m]": {},
            "top speed [rad/s or m/s]": {},
            "largest torque [N m or N]": {},
        }
        for recording in self.recordings:
            joints = recording.joints
            none, low = [0.0] * len(joints), [joint.low for joint in joints]
            bars = (
                (low, [joint.high - joint.low for joint in joints]),
                (none, [joint.speed for joint in joints]),
                (none, [joint.largest for joint in joints]),
            )
            for panel, bar in zip(panels.values(), bars, strict=True):
                panel[recording.name] = bar
        names = [joint.name for joint in self.recordings[0].joints] if self.recordings else []
        return bar_figure(repr(self), names, panels)

    def __repr__(self) -> str:
        kinds = ", ".join(dict.fromkeys(found.kind for found in self.findings))
        return f"DataCheck(recordings: {len(self.recordings)}; {kinds or 'nothing looks wrong'})"

    def _repr_html_(self) -> str:
        """Return the findings and a table of each recording, for notebooks."""
        lines = [f"<p>⚠ {html.escape(str(found))}</p>" for found in self.findings]
        lines = lines or ["<p>nothing looks wrong</p>"]
        return "".join([*lines, *(html_table(x.title, x.columns()) for x in self.recordings)])

    def __str__(self) -> str:
        pages = [str(recording) for recording in self.recordings]
        lines = [f"warning: {found}" for found in self.findings] or ["nothing looks wrong"]
        return "\n\n".join([*pages, "\n".join(lines)])


def check(
    network: CSLC,
    recordings: Recording | Sequence[Recording],
    names: Sequence[str] | None = None,
    *,
    progress: Callable[[str], None] | None = None,
) -> DataCheck:
    """Check recordings of a robot for wrong units, signs, times and samples.

    Needs no coefficients: torque is linear in them, so a recording whose columns belong together
    is one that some coefficients explain. Each hypothesis (a joint's sign, two joints swapped,
    degrees, torques that are late) is judged by the held-out error of the fit to the recording as
    it would then have been.

    **Arguments**

    - `network`: n joints; of numeric lengths, if possible: the fewer coefficients, the more a
      recording says.
    - `recordings`: one, or several of the same robot.
    - `names`: of the recordings.
    - `progress`: is called with a few words at the start of each step.

    **Returns** a `DataCheck`.

    **Raises**

    - `ValueError`: a recording of another number of joints.

    >>> import dataclasses, jaxcslc as jc
    >>> network = jc.derive(jc.examples.pendulum(), lengths="numeric")
    >>> recording = jc.examples.swing_recording(network, [0.5, 0.3, -0.1, 0.2, 0.05])
    >>> milliseconds = dataclasses.replace(recording, time=1000 * recording.time)
    >>> [finding.cause for finding in jc.check(network, milliseconds).findings]
    ['time is in milliseconds']
    """
    listed = [recordings] if isinstance(recordings, Recording) else list(recordings)
    labels = [f"recording {i}" for i in range(1, len(listed) + 1)] if names is None else list(names)
    if len(labels) != len(listed):
        raise ValueError(f"{len(labels)} names for {len(listed)} recordings; expected one each")
    step = progress or (lambda text: None)
    network = _with_fewest_coefficients(network)
    findings: list[Finding] = []
    summaries: list[RecordingSummary] = []
    usable: list[tuple[Evidence, str]] = []
    for recording, name in zip(listed, labels, strict=True):
        if recording.joints != network.joint_count:
            raise ValueError(
                f"{name}: has {recording.joints} joints, {network.robot.name!r} has"
                f" {network.joint_count}"
            )
        step(f"checking {name}")
        found, summary, evidence = _check_one(network, recording, name)
        label = name if len(listed) > 1 else ""
        findings += [dataclasses.replace(one, recording=label) for one in found]
        summaries.append(summary)
        usable += [] if evidence is None else [(evidence, name)]
    if len(listed) > 1:
        findings += rate_findings([summary.rate for summary in summaries], labels)
    if len(usable) > 1:
        step("comparing recordings")
        findings += agreement_findings(network, *zip(*usable, strict=True))
    faults = [note for note in network.robot.notes if note.endswith(UNUSED_LINKS)]
    findings += [finding("robot file", note) for note in faults]
    return DataCheck(tuple(summaries), tuple(findings))


def _with_fewest_coefficients(network: CSLC) -> CSLC:
    """Return the network with numeric lengths, where all have values, and no static friction.

    Static friction is barely determined by smoothed motion, and may then be anything in another;
    friction that follows the load takes a search, and is left out, too.
    """
    network = network.without_load()
    joints = range(1, network.joint_count + 1)
    static = "static" in network.layout.groups
    smooth = network.without_law("static", joints) if static else network
    if network.algebra.lengths == "numeric" or not network.robot.has_all_lengths:
        return smooth
    numeric = derive(smooth.robot, lengths="numeric")
    terms = (numeric.terms[0], *smooth.terms[1:])
    return CSLC(algebra=numeric.algebra, terms=terms)


# What a position that was not recorded looks like.
_WITHOUT_POSITIONS = ("wrong robot", "zero position", "length", "axis")


def _check_one(
    network: CSLC, recording: Recording, name: str
) -> "tuple[list[Finding], RecordingSummary, Evidence | None]":
    """Check a recording, each time with what was found before mended."""
    joints = network.output_names
    recording = from_its_start(recording)
    factor, wrong_unit = time_unit(recording)
    findings = [] if wrong_unit is None else [wrong_unit]
    if wrong_unit is not None:
        velocity, acceleration = recording.velocity, recording.acceleration
        recording = dataclasses.replace(
            recording,
            time=recording.time * factor,
            velocity=None if velocity is None else velocity / factor,
            acceleration=None if acceleration is None else acceleration / factor**2,
        )
    findings += clock_findings(recording)
    channels = Channels.of(recording, joints, network.joint_kinds)
    findings += channels.findings
    recording = channels.recording
    outliers = Outliers.of(recording)
    source = network.robot.source
    fixable = source is not None and source.format != "toml"
    findings += sample_findings(recording, joints, fixable=fixable)
    mended = outliers.mended(recording)
    valid = channels.valid & ~clipping(recording.torque)
    clipped = {found.joint for found in findings if found.kind == "clipping"}
    confirmed = _confirmed(network, mended, channels)
    for one in confirmed:
        name_of = joints[one.joint]
        if one.row != "clipping" or name_of not in clipped:
            findings.append(finding(one.row, one.text, name_of, joint=name_of))
        valid[one.rows, one.joint] = False
    # The corners of a torque without its sign are no outliers.
    if not {found.kind for found in findings} & {"unsigned torque", "jump"}:
        findings += outliers.findings(recording, joints)
    # Rows whose positions all repeat those of the row before: of a slower source, or stale.
    same = repeats_row_before(mended.position)
    fresh = ~(same if np.mean(same) > _SLOW_SOURCE else stale_rows(mended))
    if MINIMUM_SAMPLES < fresh.sum() < fresh.size:
        mended, valid = mended.rows(fresh), valid[fresh]
    evidence, excitation = None, ""
    # Filters spread jumps over the rows beside them; and no torque says nothing.
    if "jump" in channels.kinds or not valid.any():
        return findings, RecordingSummary.of(network, recording, name, excitation), None
    try:
        evidence = Evidence.of(network, mended, valid)
    except ValueError as error:  # too short for its smoothing, or nothing moves
        findings.append(finding("motion", str(error)))
    if evidence is not None and (shortage := evidence.shortage):
        findings.append(finding("motion", shortage))
        evidence = None
    if evidence is not None:
        before = evidence
        found, evidence, excitation = motion_findings(before)
        another = any(one.kind == "wrong robot" for one in found)
        explained = {
            joints[one.joint]
            for one in confirmed
            if one.row == "clipping"
            and (another or _is_explained(one, before, evidence, recording.time))
        }
        findings = [
            x for x in findings if x.kind != "clipping" or x.joint not in explained - clipped
        ]
        # Next to a torque that was not recorded, those of the other joints have no scale.
        if any(one.kind == "constant torque" for one in findings):
            found = [one for one in found if one.kind == "tame motion"]
        # Nor a position that was not.
        still = ", ".join(one.joint for one in findings if one.kind == "motionless joint")
        stuck = f"the position of {still} was not recorded: it does not change"
        findings += [
            one.or_else(stuck) if still and one.kind in _WITHOUT_POSITIONS else one for one in found
        ]
    return findings, RecordingSummary.of(network, recording, name, excitation), evidence


def _confirmed(
    network: CSLC, recording: Recording, channels: Channels
) -> list[Unsigned | Saturated]:
    """Return the suspects among the torques that the motion confirms."""
    valid = channels.valid.copy()
    for one in channels.suspects:
        if not one.rows.all():
            valid[one.rows, one.joint] = False
    with contextlib.suppress(ValueError):
        if channels.suspects:
            evidence = Evidence.of(network, recording, valid)
            return [x for x in channels.suspects if x.confirmed(evidence, recording.time)]
    return []


def _is_explained(
    one: Unsigned | Saturated, before: Evidence, mended: Evidence, time: np.ndarray
) -> bool:
    """Return whether motion takes no more than the torque once other faults are mended.

    Of motion that is wrong, or by another robot's file, a fit to the other samples predicts any
    torque.

    - `time`: of the samples that are looked at [s].
    """
    same = mended is not before and all(
        np.array_equal(x, y)
        for x, y in (
            (before.recording.time, mended.recording.time),
            (before.recording.torque[:, one.joint], mended.recording.torque[:, one.joint]),
        )
    )
    return same and not one.confirmed(mended, time)


_SLOW_SOURCE = REPEATED  # part of rows that repeat positions from which their source is slower
_REST = 0.01  # part of a joint's greatest speed below which it is at rest, in the summary alone
_MOMENT = 0.02  # [s] in which encoder steps and outliers do not show
_TOP = 0.999  # part of the samples that top speed is not exceeded by


@dataclasses.dataclass(frozen=True)
class JointSummary:
    """Summary of one joint in a recording.

    - `name`: of the joint.
    - `low`, `high`: of its position [rad or m].
    - `speed`: that 99.9 % of its samples do not exceed [rad/s or m/s].
    - `torque`: root mean square [N m or N]; `largest`: greatest absolute value.
    - `resolution`: step of its encoder; 0 where readings show no steps [rad or m].
    - `resting_share`: part of the samples at which it barely moves.
    - `limits`: of the robot's file, or None.
    """

    name: str
    low: float
    high: float
    speed: float
    torque: float
    largest: float
    resolution: float
    resting_share: float
    limits: JointLimits | None


@dataclasses.dataclass(frozen=True)
class RecordingSummary:
    """Summary of a recording.

    - `name`: of the recording.
    - `samples`, `duration`, `rate`: how many there are, and how fast [s, Hz].
    - `joints`: one `JointSummary` each.
    - `prismatic`: whether the robot has prismatic joints.
    - `excitation`: in words; empty where it was not computed.
    """

    name: str
    samples: int
    duration: float
    rate: float
    joints: tuple[JointSummary, ...]
    prismatic: bool = False
    excitation: str = ""

    @classmethod
    def of(
        cls, network: CSLC, recording: Recording, name: str, excitation: str
    ) -> "RecordingSummary":
        """Summarise a recording of a robot, times in seconds."""
        time, position, torque = recording.time, recording.position, recording.torque
        interval = float(np.median(np.diff(time)))
        reach = max(1, min(round(_MOMENT / interval), recording.samples // 4))
        passed = (time[2 * reach :] - time[: -2 * reach])[:, None]
        speed = np.abs(position[2 * reach :] - position[: -2 * reach]) / passed
        top = np.quantile(speed, _TOP, axis=0)
        columns = (
            np.min(position, axis=0),
            np.max(position, axis=0),
            top,
            np.sqrt(np.mean(torque**2, axis=0)),
            np.max(np.abs(torque), axis=0),
            encoder_resolution(position),
            np.mean(speed <= _REST * top, axis=0),
        )
        values = zip(*(column.tolist() for column in columns), strict=True)
        joints = tuple(
            JointSummary(joint, *of_joint, limits=limits)
            for joint, of_joint, limits in zip(
                network.output_names, values, network.joint_limits, strict=True
            )
        )
        duration, prismatic = float(time[-1] - time[0]), "P" in network.joint_kinds
        rate = 1.0 / interval
        return cls(name, recording.samples, duration, rate, joints, prismatic, excitation)

    @property
    def title(self) -> str:
        """The name, the number of samples and the units of `columns`, in words."""
        return (
            f"{self.name}: {self.samples} samples in {self.duration:.4g} s,"
            f" {self.rate:.4g} a second; positions in rad, speeds in rad/s, torques in N m"
            + (" (of prismatic joints m, m/s and N)" if self.prismatic else "")
        )

    def columns(self) -> dict[str, list[str]]:
        """Return the columns of a table with one row for each joint, as texts."""
        shown: dict[str, Callable[[JointSummary], str]] = {
            "joint": lambda joint: joint.name,
            "from": lambda joint: f"{joint.low:.3g}",
            "to": lambda joint: f"{joint.high:.3g}",
            "top speed": lambda joint: f"{joint.speed:.3g}",
            "(limit)": lambda joint: _limit(joint.limits and joint.limits.speed),
            "torque RMS": lambda joint: f"{joint.torque:.3g}",
            "largest": lambda joint: f"{joint.largest:.3g}",
            "limit": lambda joint: _limit(joint.limits and joint.limits.torque),
            "encoder step": lambda joint: f"{joint.resolution:.2g}" if joint.resolution else "none",
            "at rest": lambda joint: f"{100 * joint.resting_share:.0f} %",
        }
        return {name: [text(joint) for joint in self.joints] for name, text in shown.items()}

    def __str__(self) -> str:
        columns = self.columns()
        table = text_table(list(columns), list(zip(*columns.values(), strict=True)), left=["joint"])
        return "\n".join([self.title, table, *([self.excitation] if self.excitation else [])])


def _limit(value: float | None) -> str:
    return "" if value is None or not np.isfinite(value) else f"{value:.3g}"
