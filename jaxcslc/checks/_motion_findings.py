"""Findings from how motion and torque belong together: likeliest cause first."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from .._rank import numerical_rank
from ..network import CSLC
from ..recordings import Preparation, Recording, noise_level
from ._evidence import WELL, Evidence, PriorFit
from ._hypotheses import Change, Hypothesis, angle_units, driven_joints, objective, sign_and_order
from ._sample_findings import Finding, motionless
from ._torque_lag import LEAST_LAG, TorqueLag, torque_lag_of


# How much lower the mean logarithm of the joints' errors must be once a cause is mended.
_LEAST_GAIN = 0.15
# Errors of less than this part of the torque leave nothing to explain.
_SMALL = 0.03
# Torques of this many times those of the file's masses are in another unit.
_OTHER_UNIT = 3.0
# What the file's masses must explain of a joint's torque that is gravity's for the most part.
_FEW, _MOST = 0.2, 0.4
# Error beyond noise, as part of the torque, that a right model rarely leaves.
_UNEXPLAINED = 0.4
# Held-out over training error, in logarithms, from which a recording has too little motion.
_TAME = 0.35
_ROUNDS = 3


@dataclasses.dataclass(frozen=True)
class Cause:
    """A finding, the recording without what it names, and how much better that is explained."""

    finding: Finding
    recording: Recording
    gain: float


def motion_findings(evidence: Evidence) -> tuple[list[Finding], Evidence, str]:
    """Find faults in the columns of a recording from how motion and torque belong together.

    The likeliest cause is mended before the next one is looked for.

    **Arguments**

    - `evidence`: of the recording.

    **Returns** the findings, the evidence of the recording without what they name, and a sentence
    about its excitation.
    """
    findings: list[Finding] = []
    for _ in range(_ROUNDS):
        cause = _likeliest(evidence)
        if cause is None:
            break
        findings.append(cause.finding)
        evidence = Evidence.of(evidence.network, cause.recording, evidence.valid)
    wrong = _wrong_robot(evidence)
    if wrong is not None and findings:
        # What mends one joint of another robot is chance; a common factor of torques is not.
        findings = [finding for finding in findings if finding.kind == "torque unit"]
    findings += [] if wrong is None else [wrong]
    if not findings:
        findings += _beyond_limits(evidence)
    tame, excitation = _excitation(evidence)
    return findings + tame, evidence, excitation


def _likeliest(evidence: Evidence) -> Cause | None:
    patterns = evidence.patterns
    names = evidence.network.output_names
    errors = evidence.relative_errors
    score = objective(evidence, patterns)
    prior = evidence.prior
    causes: list[Cause] = []
    if (
        np.max(errors) > _SMALL
        or driven_joints(evidence, patterns)
        or (prior is not None and _mismatched(evidence, prior).size)
    ):
        causes += _by_hypothesis(evidence, score, errors, names)
    interval = float(np.median(np.diff(evidence.recording.time)))
    least = max(interval, LEAST_LAG)
    lag = torque_lag_of(evidence, least)
    if lag is not None and lag.beyond(least):
        causes.append(_late(evidence, lag, interval))
    causes = [cause for cause in causes if cause.gain > _LEAST_GAIN or "lag" in cause.finding.kind]
    best = max(causes, key=lambda cause: cause.gain, default=None)
    unit = None if prior is None else _torque_unit(evidence, prior, score, names)
    if unit is not None and (best is None or unit.gain > best.gain - 0.05):
        return unit
    return best


def _by_hypothesis(
    evidence: Evidence,
    score: float,
    errors: Float[np.ndarray, " joints"],
    names: Sequence[str],
) -> list[Cause]:
    network, patterns = evidence.network, evidence.patterns
    hypotheses = [
        *sign_and_order(network.joint_count, names),
        *angle_units(network.joint_kinds, names, np.ptp(evidence.recording.position, axis=0)),
    ]
    quick = evidence.quick_scores([h.change.patterns(patterns) for h in hypotheses])
    # The held-out error of the few that come into question.
    order = np.argsort(quick, kind="stable")[:4]
    against_friction = set(driven_joints(evidence, patterns))
    likely = {int(i) for i in order} | {
        i
        for i, hypothesis in enumerate(hypotheses)
        if hypothesis.kind == "sign" and against_friction & {*hypothesis.joints}
    }
    causes: list[Cause] = []
    for i in sorted(likely):
        hypothesis = hypotheses[i]
        mended = objective(evidence, hypothesis.change.patterns(patterns))
        causes.append(_cause(evidence, hypothesis, errors, score - mended, against_friction, names))
    return causes


def _cause(
    evidence: Evidence,
    hypothesis: Hypothesis,
    errors: Float[np.ndarray, " joints"],
    gain: float,
    against_friction: set[int],
    names: Sequence[str],
) -> Cause:
    mended = evidence.errors(hypothesis.change.patterns(evidence.patterns))
    worst = int(np.argmax(errors / np.maximum(mended, 1e-9)))
    text = (
        f"torque errors are {100 * errors[worst]:.3g} % of the torque of {names[worst]}, and"
        f" {100 * mended[worst]:.3g} % if {hypothesis.cause}"
    )
    if (
        hypothesis.kind == "sign"
        and against_friction & {*hypothesis.joints}
        and errors[worst] < 0.1
    ):
        text = f"friction of {names[hypothesis.joints[0]]} drives its motion instead of braking it"
    joints = ", ".join(names[joint] for joint in hypothesis.joints)
    finding = Finding(hypothesis.kind, joints, text, hypothesis.cause, hypothesis.remedy)
    return Cause(finding, hypothesis.change.recording(evidence.recording), gain)


def _late(evidence: Evidence, lag: TorqueLag, interval: float) -> Cause:
    word = "late" if lag.lag > 0 else "early"
    low, high = sorted((abs(lag.low), abs(lag.high)))
    recording = evidence.recording
    torque = Preparation(torque_lag=lag.lag).aligned(recording.time, recording.torque)
    finding = Finding(
        "torque lag",
        "",
        f"torques fit the motion best {1e3 * abs(lag.lag):.3g} ms {word} (95 % interval"
        f" {1e3 * low:.3g} to {1e3 * high:.3g} ms; {abs(lag.lag) / interval:.2g} samples)",
        "a filter or a delay between the two measurements",
        f"--torque-lag {lag.lag:.4g}",
    )
    return Cause(finding, Recording(recording.time, recording.position, torque), lag.gain)


def _torque_unit(
    evidence: Evidence, prior: PriorFit, score: float, names: Sequence[str]
) -> Cause | None:
    """Torques that follow those of the file's masses, but many times too large or too small."""
    well = prior.explained > WELL
    common = abs(prior.common_factor)
    if well.sum() < min(2, len(well)) or 1 / _OTHER_UNIT < common < _OTHER_UNIT:
        return None
    change = Change(torque_factors=1.0 / prior.factors)
    gain = score - objective(evidence, change.patterns(evidence.patterns))
    factors = np.abs(prior.factor[well])
    spread = float(np.max(factors) / np.min(factors))
    listed = ", ".join(
        f"{name} {factor:.3g}"
        for name, factor in zip(np.array(names)[well], prior.factor[well], strict=True)
    )
    if spread < 2.0 and 300.0 < common < 3000.0:
        cause, remedy = "torques are in mN m", '[torque] unit = "mN m" in the mapping of --columns'
    else:
        cause = "the columns of torques are motor currents, or torques before the gears"
        remedy = '[torque] unit = "A", constant = [...], gear = [...] in the mapping of --columns'
    finding = Finding(
        "torque unit",
        "" if well.all() else ", ".join(np.array(names)[well]),
        f"torques follow those of the masses in the robot's file, but times {listed}",
        cause,
        remedy,
    )
    return Cause(finding, change.recording(evidence.recording), gain)


def _mismatched(evidence: Evidence, prior: PriorFit) -> np.ndarray:
    """Joints, from 0, whose torque should be that of the file's masses, and is not."""
    patterns = evidence.patterns
    size = np.maximum(np.sqrt(np.mean(np.asarray(patterns.torque) ** 2, axis=0)), 1e-300)
    recorded = np.std(evidence.gravity, axis=0) / size
    common = abs(prior.common_factor)
    expected = prior.size * (common if np.isfinite(common) else 1.0)
    return np.flatnonzero(
        (np.minimum(np.maximum(recorded, expected), 1.5) > _MOST)
        & (prior.explained < _FEW)
        & (np.ptp(np.asarray(patterns.torque), axis=0) > 0.0)
    )


def _wrong_robot(evidence: Evidence) -> Finding | None:
    names = np.array(evidence.network.output_names)
    errors = _beyond_noise(evidence)
    texts: list[str] = []
    joints: set[int] = set()
    bad = np.flatnonzero(errors > _UNEXPLAINED)
    if bad.size:
        joints |= set(bad.tolist())
        listed = ", ".join(f"{names[j]} {100 * errors[j]:.0f} %" for j in bad)
        texts.append(f"no coefficients explain the torque; beyond noise they leave {listed} of it")
    prior = evidence.prior
    if prior is not None and (off := _mismatched(evidence, prior)).size:
        joints |= set(off.tolist())
        listed = ", ".join(f"{names[j]} {100 * max(prior.explained[j], 0):.0f} %" for j in off)
        texts.append(f"the masses of the robot's file explain little of the torque: {listed}")
    if not texts:
        return None
    beyond = _beyond_limits(evidence)
    return Finding(
        "wrong robot",
        ", ".join(names[sorted(joints)]),
        "; ".join([*texts, *(finding.evidence for finding in beyond)]),
        "the recording is of another robot, tool or mounting than the file's, or the model lacks"
        " a term",
        "compare the robot's file, its base, tip and gravity with the arm",
    )


def _beyond_noise(evidence: Evidence) -> Float[np.ndarray, " joints"]:
    """Error of each joint as part of its torque, less what white noise of the torque explains."""
    recording, patterns = evidence.recording, evidence.patterns
    errors = evidence.relative_errors
    interval = float(np.median(np.diff(recording.time)))
    passed = np.sqrt(min(2.0 * evidence.cutoff * interval, 1.0))
    size = np.sqrt(np.mean(np.asarray(patterns.torque) ** 2, axis=0))
    noise = noise_level(recording.torque) * passed / np.maximum(size, 1e-300)
    return np.sqrt(np.maximum(errors**2 - noise**2, 0.0))


def _beyond_limits(evidence: Evidence) -> list[Finding]:
    network, recording = evidence.network, evidence.recording
    texts: list[str] = []
    joints: list[str] = []
    for j, (name, limits) in enumerate(
        zip(network.output_names, network.joint_limits, strict=True)
    ):
        low, high = np.quantile(recording.position[:, j], [0.001, 0.999])
        span = limits.high - limits.low
        margin = 0.02 * span if np.isfinite(span) else 0.05
        if low < limits.low - margin or high > limits.high + margin:
            texts.append(
                f"{name} goes from {low:.3g} to {high:.3g}, and its limits are {limits.low:.3g}"
                f" and {limits.high:.3g}"
            )
            joints.append(name)
    if not texts:
        return []
    return [
        Finding(
            "limits",
            ", ".join(joints),
            "; ".join(texts),
            "another robot, another zero position, or another unit",
            "compare the robot's file with the arm, and units and zero positions with the recorder",
        )
    ]


def _excitation(evidence: Evidence) -> tuple[list[Finding], str]:
    """Check whether the motion is enough for the coefficients, and describe it in a sentence."""
    network, patterns = evidence.network, evidence.patterns
    held_out = evidence.score(patterns)
    fit = evidence.fit
    mask, torque = np.asarray(patterns.mask), np.asarray(patterns.torque)
    counts = np.maximum(mask.sum(axis=0), 1)
    size = np.maximum(np.sqrt(np.where(mask, torque**2, 0.0).sum(axis=0) / counts), 1e-300)
    training = np.clip(np.asarray(fit.torque_error) / size, 1e-6, 10.0)
    gap = held_out - float(np.mean(np.log(training)))
    rank, duration = int(fit.rank), float(evidence.time[-1] - evidence.time[0])
    text = (
        f"excitation: {duration:.3g} s determine {rank} of {network.size} coefficients, condition"
        f" {float(fit.condition):.3g}"
    )
    # Coefficients of a joint that stands still are undetermined, which is said elsewhere.
    whole = rank == _determinable(network)
    if (whole or motionless(evidence.recording).any()) and gap < _TAME:
        return [], text
    evidence_text = (
        f"{text}; errors on data left out of the fit are {np.exp(gap):.3g} times those of the fit"
    )
    finding = Finding(
        "tame motion",
        "",
        evidence_text,
        "the motion is too short or too uniform for so many coefficients",
        "record a longer motion of all joints at several speeds; --folds 3 lets short recordings"
        " choose settings",
    )
    return [finding], text


def _determinable(network: CSLC) -> int:
    """Return the number of coefficients that some motion determines.

    All, but for joints that follow others: some of what these carry shows only if they move by
    themselves.
    """
    joints = network.joint_count
    if joints == network.robot.joint_count:
        return network.size
    motion = np.random.default_rng(0).uniform(-2.0, 2.0, (3, 8 * network.size, joints))
    regressor = np.asarray(network.regressor(*motion))
    return numerical_rank(regressor.reshape(-1, network.size))
