"""Entry point of the checks: `check` and its result, `DataCheck`."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from ..network import CSLC, derive
from ..recordings import MINIMUM_SAMPLES, Recording, stale_rows
from ._agreement_findings import agreement_findings, rate_findings
from ._evidence import Evidence
from ._motion_findings import motion_findings
from ._sample_findings import (
    Finding,
    clipping,
    clock_findings,
    outlier_findings,
    outliers_of,
    sample_findings,
    time_unit,
    without_outliers,
)
from ._summary import RecordingSummary


# With one of these, no model explains the torque, and everything computed says so again.
_SPOILING = ("time unit", "angle unit", "torque unit", "sign", "swapped joints", "wrong robot")


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

    recordings: tuple[RecordingSummary, ...]
    findings: tuple[Finding, ...]

    def unexplained(self, warnings: Sequence[str]) -> tuple[str, ...]:
        """Return the warnings of a fit, unless a finding explains them.

        - `warnings`: about errors and coefficients of a fit to the recordings.

        >>> from jaxcslc import DataCheck, Finding
        >>> degrees = Finding("angle unit", "", "", "positions are in degrees", "")
        >>> print(*DataCheck((), (degrees,)).unexplained(["elbow: a large error"]))
        1 warning about errors and bodies is left out: positions are in degrees; mend that first
        """
        causes = [finding.cause for finding in self.findings if finding.kind in _SPOILING]
        if not causes or not warnings:
            return tuple(warnings)
        many = f"{len(warnings)} warnings" if len(warnings) > 1 else "1 warning"
        are = "are" if len(warnings) > 1 else "is"
        return (
            f"{many} about errors and bodies {are} left out: {'; '.join(causes)}; mend that first",
        )

    def __str__(self) -> str:
        pages = [str(recording) for recording in self.recordings]
        lines = [f"warning: {finding}" for finding in self.findings] or ["nothing looks wrong"]
        return "\n\n".join([*pages, "\n".join(lines)])


def check(
    network: CSLC,
    recordings: Recording | Sequence[Recording],
    names: Sequence[str] | None = None,
    *,
    progress: Callable[[str], None] | None = None,
) -> DataCheck:
    """Checks recordings of a robot for wrong units, signs, times and samples.

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

    >>> import numpy as np, jaxcslc as jc
    >>> pendulum = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> network = jc.derive(pendulum, lengths="numeric")
    >>> t = np.arange(4000)[:, None] * 0.002
    >>> q, qd, qdd = np.sin(3 * t), 3 * np.cos(3 * t), -9 * np.sin(3 * t)
    >>> torque = np.asarray(network.torque(np.array([0.5, 0.3, -0.1, 0.2, 0.05]), q, qd, qdd))
    >>> milliseconds = jc.Recording(1000 * t[:, 0], q, torque)
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
    evidence: list[Evidence | None] = []
    for recording, name in zip(listed, labels, strict=True):
        if recording.joints != network.joint_count:
            raise ValueError(
                f"{name}: has {recording.joints} joints, {network.robot.name!r} has"
                f" {network.joint_count}"
            )
        step(f"checking {name}")
        one = _Check(network, recording)
        label = name if len(listed) > 1 else ""
        findings += [dataclasses.replace(finding, recording=label) for finding in one.findings]
        summary = RecordingSummary.of(network, one.recording, name)
        summaries.append(dataclasses.replace(summary, excitation=one.excitation))
        evidence.append(one.evidence)
    if len(listed) > 1:
        findings += rate_findings([summary.rate for summary in summaries], labels)
        usable = [(e, name) for e, name in zip(evidence, labels, strict=True) if e is not None]
        if len(usable) > 1:
            step("comparing recordings")
            kept, kept_labels = zip(*usable, strict=True)
            findings += agreement_findings(network, kept, kept_labels)
    return DataCheck(tuple(summaries), tuple(findings))


def _with_fewest_coefficients(network: CSLC) -> CSLC:
    """The network with numeric lengths, where all of them have values, and no static friction.

    Static friction is hardly determined by smoothed motion, and may then be anything in another;
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


class _Check:
    """The checks of one recording, each on what those before it have mended."""

    def __init__(self, network: CSLC, recording: Recording) -> None:
        self.network = network
        self.names = network.output_names
        self.findings: list[Finding] = []
        self.evidence: Evidence | None = None
        self.excitation = ""
        factor, finding = time_unit(recording)
        if finding is not None:
            self.findings.append(finding)
            recording = _with_time(recording, factor)
        self.recording = recording
        self.findings += clock_findings(recording)
        outlying = outliers_of(recording)
        self.findings += outlier_findings(recording, outlying, self.names)
        source = network.robot.source
        fixable = source is not None and source.format != "toml"
        self.findings += sample_findings(recording, self.names, fixable=fixable)
        clipped = clipping(recording.torque)
        valid = ~clipped if clipped.mean() > 0 else None
        mended = without_outliers(recording)
        self._judge_motion(mended, valid)

    def _judge_motion(self, recording: Recording, valid: np.ndarray | None) -> None:
        fresh = ~_without_news(recording)
        if not fresh.all() and fresh.sum() > MINIMUM_SAMPLES:
            recording = recording.rows(fresh)
            valid = None if valid is None else valid[fresh]
        try:
            evidence = Evidence.of(self.network, recording, valid)
        except ValueError as error:  # too short for its smoothing, or nothing moves
            self.findings.append(
                Finding(
                    "motion",
                    "",
                    str(error),
                    "the recording is too short or hardly moves",
                    "record a longer motion of all joints",
                )
            )
            return
        findings, self.evidence, self.excitation = motion_findings(evidence)
        self.findings += findings


def _with_time(recording: Recording, factor: float) -> Recording:
    velocity, acceleration = recording.velocity, recording.acceleration
    return dataclasses.replace(
        recording,
        time=(recording.time - recording.time[0]) * factor,
        velocity=None if velocity is None else velocity / factor,
        acceleration=None if acceleration is None else acceleration / factor**2,
    )


def _without_news(recording: Recording) -> np.ndarray:
    """Rows whose positions all repeat those of the row before: of a slower source, or stale."""
    stale = stale_rows(recording)
    same = np.append(False, np.all(recording.position[1:] == recording.position[:-1], axis=1))
    return same if np.mean(same) > 0.3 else stale
