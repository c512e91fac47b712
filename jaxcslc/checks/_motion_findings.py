"""Findings from how motion and torque belong together: likeliest cause first.

Hypotheses about a recording's columns (signs, order, units) are scored by their held-out errors,
see `_evidence`; recordings are compared with the first by its coefficients.
"""

import dataclasses
import json
import math
import re
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from .._rank import numerical_rank
from .._text_table import number_text
from ..least_squares import HostColumns, LeastSquares, regressor_of, reidentify, torque_by
from ..network import CSLC
from ..recordings import Patterns, Preparation, Recording, noise_level
from ._evidence import (
    ALIKE,
    LARGEST_ERROR,
    LEAST_GAIN,
    SMALLEST_ERROR,
    TINY,
    WELL,
    Cause,
    Change,
    Evidence,
    PriorFit,
    error_part,
    removes,
)
from ._findings import Finding, finding
from ._first_order import carried_masses
from ._geometry import axis_causes
from ._model_findings import file_findings, model_causes, significant_cause
from ._sample_findings import OTHER_RATE, motionless
from ._torque_lag import LEAST_LAG, TorqueLag, torque_lag_of


# Errors of more times the noise, and of more than a part of the torque, have causes in the model
# that are worth a search: it takes time, and decides by what each gains. (Heuristic.)
_BEYOND_NOISE, _UNEXPECTED = 2.0, 0.01
# Errors of less than this part of the torque leave nothing to explain by columns. (Heuristic: of
# right recordings, 90 % leave 3.6 % or less, `scripts.studies.checks.margins`.)
_SMALL = 0.03
# Errors of less than this part of the torque say less of a sign than friction's power does, and
# nothing of axes. (Heuristic: right recordings leave 6 % at most.)
_LITTLE, _NO_ERROR = 0.1, 1e-9
# Torques of this many times those of the file's masses are in another unit; factors within the
# second are alike. (Heuristic: far beyond what masses of files are wrong by.)
_OTHER_UNIT, _SAME_UNIT = 3.0, 2.0
_THOUSAND = (1000.0 / _OTHER_UNIT, 1000.0 * _OTHER_UNIT)  # times: torques in mN m or N mm
_ALONE = 30.0  # times: one joint's torque is in another unit: between gears of 10 and mN m
# What the file's masses must explain of a joint's torque that is gravity's for a large part; more
# than the third part is as good as all. (Heuristic.)
_FEW, _MOST, _ALL = 0.2, 0.4, 1.5
_CENTRES = 0.02  # [m] by which centres of gravity in files may be off; of the study's arms 1 cm
UNEXPLAINED = 0.4
"""Error beyond noise, as part of the torque, that a right model does not leave.

(Heuristic: it leaves 0.06 at most, `scripts.studies.checks.margins`; real gears may leave more.)"""
_STILL_UNEXPLAINED = 0.1  # the same once two causes are mended: as `_LITTLE`
TAME = 0.35
"""Held-out over training error, as a logarithm, of too little motion.

(Heuristic: right recordings of 12 s and more have 0.11 at most,
`scripts.studies.checks.margins`.)"""
# Positions beyond limits by less than these margins are within [part of the range; rad or m], and
# this part of the samples does not count. (Heuristic.)
_MARGIN_OF_SPAN, _MARGIN, _OUTSIDE = 0.02, 0.05, 1e-3
# Torques beyond the file's limits by less are within: gears and friction have their part.
# (Heuristic.)
_BEYOND_EFFORT = 1.1
# White noise and friction of measured torques, as parts of them, are larger; friction of as many
# joints at least. (Heuristic.)
_NOISELESS, _FRICTIONLESS, _SEVERAL = 1e-4, 0.05, 3
_ROUNDS = 3  # causes that are mended one after the other


def motion_findings(evidence: Evidence) -> tuple[list[Finding], Evidence, str]:
    """Find faults in the columns of a recording from how motion and torque belong together.

    The likeliest cause is mended before the next one is looked for.

    **Returns** the findings, the evidence of the recording without what they name, and a sentence
    about its excitation.
    """
    findings: list[Finding] = []
    recorded = evidence
    for _ in range(_ROUNDS):
        cause = _likeliest(evidence)
        if cause is None:
            break
        findings.append(cause.finding)
        mended = cause.mended()
        if mended is None:
            return findings, evidence, _excitation(evidence)[1]
        evidence = mended
    tame, excitation = _excitation(evidence)
    wrong = _wrong_robot(evidence, len(findings))
    if wrong is not None:
        # What mends one joint of another robot is chance; a common factor of torques is not.
        findings = [*(found for found in findings if found.kind == "torque unit"), wrong]
    if not findings:
        of_file = list(file_findings(evidence))
        another = any(found.kind == "wrong robot" for found in of_file)
        findings += of_file if another else significant_cause(evidence, lengths=not tame) or of_file
    # Another clock and another gravity than those of the file's masses are another robot's.
    if not findings:
        findings += _beyond_limits(evidence)
    if not findings:
        findings += _computed_torque(evidence)
    findings += _beyond_effort(evidence if wrong is None else recorded)
    return findings + tame, evidence, excitation


def _likeliest(evidence: Evidence) -> Cause | None:
    score = _objective(evidence, evidence.patterns)
    prior = evidence.prior
    causes: list[Cause] = []
    # Of tame motion, held-out errors are large without a fault. Coefficients that follow any
    # torque also follow one that is late, or of other lengths.
    tame = bool(_excitation(evidence)[0])
    errors = evidence.training_errors if tame else evidence.relative_errors
    beyond_noise = errors > np.maximum(_BEYOND_NOISE * evidence.noise, _UNEXPECTED)
    if (
        (np.max(errors) > _SMALL and (np.any(beyond_noise) or not tame))
        or _driven_joints(evidence, evidence.patterns)
        or (prior is not None and _mismatched(evidence, prior).size)
    ):
        causes += _causes_in_columns(evidence, score)
    if np.max(errors) > _LITTLE and not tame:
        causes += axis_causes(evidence, _LITTLE)
    causes = [cause for cause in causes if cause.gain > LEAST_GAIN]
    if np.any(beyond_noise):
        causes += model_causes(evidence, lengths=not tame)
    least = max(evidence.interval, LEAST_LAG)
    lag = torque_lag_of(evidence, least)
    if lag is not None and lag.beyond(least):
        late = _late(evidence, lag)
        # A lag that is there leaves no tame motion once it is mended.
        mended = late.mended() if tame else None
        causes += [late] if mended is None or not _excitation(mended)[0] else []
    best = max(causes, key=lambda cause: cause.gain, default=None)
    if best is not None:
        best = _named_with_length(best, causes)
    unit = None if prior is None else _torque_unit(evidence, prior, score)
    if unit is not None and (best is None or unit.gain > best.gain - ALIKE):
        # That of one joint is known better by the other joints than by the file's masses.
        kind, joint = unit.finding.kind, unit.finding.joint
        same = (x for x in causes if (x.finding.kind, x.finding.joint) == (kind, joint) and joint)
        return max(same, key=lambda cause: cause.gain, default=unit)
    return best


def _named_with_length(best: Cause, causes: Sequence[Cause]) -> Cause:
    """Return the best cause; one that a length of the file equals is named before it, with it."""
    alike = [cause for cause in causes if cause.gain > best.gain - ALIKE]
    lengths = [cause.finding for cause in alike if cause.finding.kind == "length"]
    others = [cause for cause in alike if cause.finding.kind in ("clock", "zero position")]
    if not lengths or not others:
        return best
    other = max(others, key=lambda cause: cause.gain)
    return dataclasses.replace(
        other, finding=other.finding.or_else(lengths[0].cause, lengths[0].remedy)
    )


class _Hypothesis(NamedTuple):
    """Fault that a recording may have: the finding, its joints from 0, and how it is undone.

    The finding is without evidence; `change` makes a right recording of the wrong one.
    """

    finding: Finding
    joints: tuple[int, ...]
    change: Change


def _hypotheses(
    kinds: str, names: Sequence[str], extent: Float[np.ndarray, " joints"]
) -> Iterator[_Hypothesis]:
    """Yield wrong signs of single joints and of all, pairs of joints that are swapped, and degrees.

    - `kinds`: of the joints, `R` or `P` each.
    - `extent`: of each joint's positions as recorded.
    """
    count = len(names)
    groups = [(joint,) for joint in range(count)]
    for joints in [*groups, tuple(range(count))] if count > 1 else groups:
        signs = np.ones(count)
        signs[[*joints]] = -1.0
        single = names[joints[0]] if len(joints) == 1 else ""
        listed = ", ".join(f"{x:g}" for x in signs.tolist())
        for what, change in (
            ("position", Change(motion_factors=signs)),
            ("torque", Change(torque_factors=signs)),
            ("position and torque", Change(motion_factors=signs, torque_factors=signs)),
        ):
            entries = (f"[{quantity}] sign = [{listed}]" for quantity in what.split(" and "))
            words = {"what": what, "joint": single, "entries": " and ".join(entries)}
            row = "sign" if single else "sign: of all joints"
            yield _Hypothesis(finding(row, "", single, **words), joints, change)
    for first, second in combinations(range(count), 2):
        order = np.arange(count)
        order[[first, second]] = second, first
        pair = f"{names[first]} and {names[second]}"
        both = f"{names[first]}, {names[second]}"
        swapped = finding(
            "swapped joints",
            "",
            both,
            what="positions and torques",
            pair=pair,
            order=_renamed(names, order.tolist()),
        )
        yield _Hypothesis(swapped, (first, second), Change(order, order))
        for what, change in (("position", Change(order)), ("torque", Change(None, order))):
            swapped = finding("swapped joints: of one quantity", "", both, what=what, pair=pair)
            yield _Hypothesis(swapped, (first, second), change)
    # Angles in degrees, of all revolute joints or of one; none that would be almost no motion.
    revolute = np.array([kind == "R" for kind in kinds])
    wide = np.flatnonzero(revolute & (extent > _LEAST_DEGREES)).tolist()
    turning = [np.flatnonzero(revolute).tolist()] if wide else []
    turning += [[joint] for joint in wide if revolute.sum() > 1]
    for joints in turning:
        factors = np.ones(count)
        factors[joints] = np.pi / 180.0
        change = Change(motion_factors=factors)
        if len(joints) == revolute.sum():
            yield _Hypothesis(finding("angle unit", ""), (), change)
        else:
            name = names[joints[0]]
            found = finding("angle unit: of one joint", "", name, joint=name)
            yield _Hypothesis(found, tuple(joints), change)


# Motion in degrees covers more than this: it would be 0.09 rad.
_LEAST_DEGREES = 5.0


def _renamed(names: Sequence[str], order: Sequence[int]) -> str:
    """Return a table of TOML: robot's joint = the recording's joint, in the recording's order.

    The order serves a recording that numbers its joints, the names one that names them.
    """
    pairs = (
        f"{_key(names[own])} = {json.dumps(name)}" for own, name in zip(order, names, strict=True)
    )
    return f"{{{', '.join(pairs)}}}"


def _key(name: str) -> str:
    """Return a key of TOML, in quotes where it has to be."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name)


def _causes_in_columns(evidence: Evidence, score: float) -> list[Cause]:
    """Return the likeliest hypotheses, with what they would mend."""
    network, patterns, errors = evidence.network, evidence.patterns, evidence.relative_errors
    names = network.output_names
    extent = np.ptp(evidence.recording.position, axis=0)
    hypotheses = list(_hypotheses(network.joint_kinds, names, extent))
    quick = evidence.quick_scores([h.change.patterns(patterns) for h in hypotheses])
    # The held-out error of the few that come into question.
    likely = set(np.argsort(quick, kind="stable")[:4].tolist())
    driven = set(_driven_joints(evidence, patterns))
    causes: list[Cause] = []
    for i, hypothesis in enumerate(hypotheses):
        against_friction = hypothesis.finding.kind == "sign" and driven & {*hypothesis.joints}
        if i not in likely and not against_friction:
            continue
        changed = hypothesis.change.patterns(patterns)
        gain = score - _objective(evidence, changed)
        mended = evidence.errors(changed)
        if not against_friction and not removes(errors, mended, evidence.noise):
            continue
        worst = int(np.argmax(errors / np.maximum(mended, _NO_ERROR)))
        text = (
            f"torque errors are {100 * errors[worst]:.3g} % of the torque of {names[worst]}, and"
            f" {100 * mended[worst]:.3g} % if {hypothesis.finding.cause}"
        )
        if against_friction and errors[worst] < _LITTLE:
            listed = ", ".join(names[joint] for joint in hypothesis.joints if joint in driven)
            text = f"friction of {listed} drives its motion instead of braking it"
        found = dataclasses.replace(hypothesis.finding, evidence=text)
        causes.append(Cause(found, gain, partial(hypothesis.change.mended, evidence)))
    return causes


# Friction drives a joint if it feeds this part of its torque's power into the motion (heuristic),
# and more than three standard errors: joints that move alike share friction in any proportion.
_DRIVING_POWER, _SIGNIFICANT = 0.02, 3.0
# What a joint that its own friction drives adds to the mean logarithm of errors: two causes' worth,
# as no friction does so.
_DRIVEN = 2.0 * LEAST_GAIN


def _objective(evidence: Evidence, patterns: Patterns) -> float:
    """Return the score of patterns, plus what joints add whose friction drives them."""
    columns = evidence.columns(patterns)
    count = len(_driven_joints(evidence, patterns, columns))
    return evidence.score(patterns, columns) + _DRIVEN * count


def _driven_joints(
    evidence: Evidence, patterns: Patterns, columns: HostColumns | None = None
) -> list[int]:
    """Return joints, from 0, whose friction feeds power into the motion, which no friction does."""
    network = evidence.network
    columns = evidence.columns(patterns) if columns is None else columns
    kinds = network.friction_per_joint
    qd, torque = np.asarray(patterns.qd), np.asarray(patterns.torque)
    mask = np.asarray(patterns.mask)
    # Power is linear in the coefficients, and so has a standard error.
    power_rows = np.zeros((network.joint_count, network.size))
    speed = np.where(mask, qd, 0.0)
    for joint, (support, rows) in enumerate(zip(network.support, columns, strict=True)):
        power_rows[joint, list(support)] = rows @ speed[:, joint]
    power_rows[:, network.layout.inertial] = 0.0
    size = np.sqrt(np.sum(speed**2, axis=0) * np.sum(np.where(mask, torque**2, 0.0), axis=0))
    power = power_rows @ evidence.coefficients(patterns, columns)
    suspects = [j for j in np.flatnonzero(power < -_DRIVING_POWER * size).tolist() if kinds[j]]
    if not suspects:
        return []
    fit = LeastSquares().fit(network, patterns, throw=False)
    covariance = np.asarray(fit.covariance)
    variance = np.einsum("jp,pq,jq->j", power_rows, covariance, power_rows)
    return [j for j in suspects if power[j] < -_SIGNIFICANT * np.sqrt(variance[j])]


def _late(evidence: Evidence, lag: TorqueLag) -> Cause:
    word = "late" if lag.lag > 0 else "early"
    low, high = sorted((abs(lag.low), abs(lag.high)))
    recording = evidence.recording
    torque = Preparation(torque_lag=lag.lag).aligned(recording.time, recording.torque)
    found = finding(
        "torque lag",
        f"torques fit the motion best {1e3 * abs(lag.lag):.3g} ms {word} (95 % interval"
        f" {1e3 * low:.3g} to {1e3 * high:.3g} ms; {abs(lag.lag) / evidence.interval:.2g} samples)",
        lag=lag.lag,
    )
    late = Recording(recording.time, recording.position, torque)
    return Cause(found, lag.gain, lambda: Evidence.of(evidence.network, late, evidence.valid))


def _torque_unit(evidence: Evidence, prior: PriorFit, score: float) -> Cause | None:
    """Return torques that follow those of the file's masses, many times too large or small."""
    well = prior.explained > WELL
    common = prior.common_size
    # One joint in another unit than all others: friction and motors are no such factor.
    ratio = np.abs(prior.factor) / common if well.sum() > 2 else np.ones(len(well))
    alone = np.flatnonzero(well & ((ratio > _ALONE) | (ratio < 1.0 / _ALONE)))
    if alone.size == 1 and not common < 1 / _OTHER_UNIT:
        joint, factors = int(alone[0]), np.ones(len(well))
        factors[joint] = np.abs(prior.factor[joint])
        change = Change(torque_factors=1.0 / factors)
        changed = change.patterns(evidence.patterns)
        name = evidence.network.output_names[joint]
        listed = f"{name} {factors[joint]:.3g}"
        found = finding(
            "torque scale: of some joints",
            f"torques follow those of the masses in the robot's file, but times {listed}",
            name,
            listed=listed,
        )
        gain = score - _objective(evidence, changed)
        return Cause(found, gain, partial(change.mended, evidence))
    if well.sum() < min(2, len(well)) or 1 / _OTHER_UNIT < common < _OTHER_UNIT:
        return None
    change = Change(torque_factors=1.0 / prior.factors)
    gain = score - _objective(evidence, change.patterns(evidence.patterns))
    names, factors = np.array(evidence.network.output_names)[well], prior.factor[well]
    listed = ", ".join(f"{name} {x:.3g}" for name, x in zip(names, factors, strict=True))
    alike = float(np.max(np.abs(factors)) / np.min(np.abs(factors))) < _SAME_UNIT
    scaled = alike and _THOUSAND[0] < common < _THOUSAND[1]
    found = finding(
        "torque unit: scale" if scaled else "torque unit: currents",
        f"torques follow those of the masses in the robot's file, but times {listed}",
        "" if well.all() else ", ".join(names),
    )
    return Cause(found, gain, partial(change.mended, evidence))


def _mismatched(evidence: Evidence, prior: PriorFit) -> np.ndarray:
    """Return joints, from 0, whose torque should be that of the file's masses, and is not."""
    torque = np.asarray(evidence.patterns.torque)
    size = np.maximum(np.sqrt(np.mean(torque**2, axis=0)), TINY)
    recorded = np.std(evidence.gravity, axis=0) / size
    common = prior.common_size
    expected = prior.size * (common if np.isfinite(common) else 1.0)
    # Torque of a joint that carries little is that of the centres' errors.
    gravity = float(np.linalg.norm(np.asarray(evidence.network.robot.gravity, float)))
    little = _CENTRES * gravity * carried_masses(evidence.network)
    return np.flatnonzero(
        (np.minimum(np.maximum(recorded, expected), _ALL) > _MOST)
        & (prior.explained < _FEW)
        & (np.ptp(torque, axis=0) > 0.0)
        & (size > little)
    )


def _wrong_robot(evidence: Evidence, mended: int) -> Finding | None:
    """Return what no coefficients explain, or not the file's masses if nothing was mended.

    - `mended`: how many causes were: two or more that leave errors are chance.
    """
    names, prior = np.array(evidence.network.output_names), evidence.prior
    # Errors as part of the torque, less what its white noise explains.
    # Of tame motion, coefficients explain what they were fitted to and little else.
    tame = bool(_excitation(evidence)[0])
    left = evidence.training_errors if tame else evidence.relative_errors
    errors = np.sqrt(np.maximum(left**2 - evidence.noise**2, 0.0))
    texts: list[str] = []
    bad, off = (
        np.flatnonzero(errors > (UNEXPLAINED if mended < 2 else _STILL_UNEXPLAINED)),
        np.zeros(0, int),
    )
    if bad.size:
        listed = ", ".join(f"{names[j]} {100 * errors[j]:.0f} %" for j in bad)
        texts.append(f"no coefficients explain the torque; beyond noise they leave {listed} of it")
    if not mended and prior is not None and (off := _mismatched(evidence, prior)).size:
        listed = ", ".join(f"{names[j]} {100 * max(prior.explained[j], 0):.0f} %" for j in off)
        texts.append(f"the masses of the robot's file explain little of the torque: {listed}")
    if not texts:
        return None
    texts += (found.evidence for found in _beyond_limits(evidence))
    return finding("wrong robot", "; ".join(texts), ", ".join(names[np.union1d(bad, off)]))


def _beyond_limits(evidence: Evidence) -> list[Finding]:
    network, recording = evidence.network, evidence.recording
    texts: dict[str, str] = {}
    lows, highs = np.quantile(recording.position, [_OUTSIDE, 1.0 - _OUTSIDE], axis=0)
    of_joints = zip(network.output_names, network.joint_limits, lows, highs, strict=True)
    for name, limits, low, high in of_joints:
        span = limits.high - limits.low
        margin = _MARGIN_OF_SPAN * span if np.isfinite(span) else _MARGIN
        if low < limits.low - margin or high > limits.high + margin:
            texts[name] = (
                f"{name} goes from {low:.3g} to {high:.3g}, and its limits are {limits.low:.3g}"
                f" and {limits.high:.3g}"
            )
    return [finding("limits", "; ".join(texts.values()), ", ".join(texts))] if texts else []


def _beyond_effort(evidence: Evidence) -> list[Finding]:
    """Find torques that the file says the joints do not have."""
    network, recording = evidence.network, evidence.recording
    tops = np.quantile(np.abs(recording.torque), 1.0 - _OUTSIDE, axis=0)
    beyond = {
        name: f"{name} has torques up to {top:.3g}, and its limit is {limits.torque:.3g}"
        for name, limits, top in zip(
            network.output_names, network.joint_limits, tops.tolist(), strict=True
        )
        if 0.0 < limits.torque < top / _BEYOND_EFFORT
    }
    if not beyond:
        return []
    return [finding("torque limit", "; ".join(beyond.values()), ", ".join(beyond))]


def _computed_torque(evidence: Evidence) -> list[Finding]:
    """Find torques without noise and without friction, as a controller computes them."""
    network, recording = evidence.network, evidence.recording
    kinds = network.friction_per_joint
    size = np.sqrt(np.mean(recording.torque**2, axis=0))
    moved = np.flatnonzero((size > 0.0) & np.array([bool(kind) for kind in kinds]))
    if moved.size < _SEVERAL or np.any(
        noise_level(recording.torque)[moved] > _NOISELESS * size[moved]
    ):
        return []
    friction = np.zeros(network.size)
    friction[network.layout.friction] = np.asarray(evidence.fit.k)[network.layout.friction]
    torque = torque_by(network.support, evidence.columns(evidence.patterns), friction)
    part = np.sqrt(np.mean(torque**2, axis=0))[moved] / size[moved]
    # Of a joint with little torque, friction may be any.
    usual = float(np.median(part))
    if usual > _FRICTIONLESS:
        return []
    return [
        finding(
            "model torque",
            f"the torque has no noise, and friction is {100 * usual:.2g} % of it",
        )
    ]


def _excitation(evidence: Evidence) -> tuple[list[Finding], str]:
    """Check whether the motion is enough for the coefficients, and describe it in a sentence."""
    network, patterns, fit = evidence.network, evidence.patterns, evidence.fit
    training = np.clip(evidence.training_errors, SMALLEST_ERROR, LARGEST_ERROR)
    gap = evidence.score(patterns) - float(np.mean(np.log(training)))
    rank, duration = int(fit.rank), float(evidence.time[-1] - evidence.time[0])
    text = (
        f"excitation: {duration:.3g} s determine {rank} of {network.size} coefficients, condition"
        f" {number_text(float(fit.condition) if rank else math.inf, 3)}"
    )
    # Coefficients of a joint that stands still are undetermined, which is said elsewhere.
    whole = rank == _determinable(network)
    if (whole or motionless(evidence.recording).any()) and gap < TAME:
        return [], text
    held_out = (
        f"without prior knowledge, held-out errors are {np.exp(gap):.3g} times the training errors"
    )
    return [finding("tame motion", f"{text}; {held_out}")], text


def _determinable(network: CSLC) -> int:
    """Return the number of coefficients that some motion determines.

    All, except for joints that follow others: some of what these carry shows only if they move by
    themselves.
    """
    joints = network.joint_count
    if joints == network.robot.joint_count:
        return network.size
    motion = np.random.default_rng(0).uniform(-2.0, 2.0, (3, 8 * network.size, joints))
    regressor = np.asarray(network.regressor(*motion))
    return numerical_rank(regressor.reshape(-1, network.size))


# Root mean square of a joint's error under another recording's coefficients over that under its own
# from which recordings disagree; less than this part of its torque is no matter. (Heuristic: of 90
# pairs of one arm, none disagrees; all of 105 others do, `scripts.studies.agreement.study`.)
_WORSE, _NEGLIGIBLE = 1.5, 0.03
# A cause explains a disagreement that it takes most of away. (Heuristic, by the same study.)
_EXPLAINED = 0.6


def rate_findings(rates: Sequence[float], names: Sequence[str]) -> Iterator[Finding]:
    """Find recordings that were sampled at another rate [Hz] than the first."""
    for rate, name in zip(rates[1:], names[1:], strict=True):
        if not 1 / OTHER_RATE < rate / rates[0] < OTHER_RATE:
            yield finding(
                "rate: others",
                f"{rate:.4g} samples a second, {rates[0]:.4g} in {names[0]}: settings chosen for"
                " one smooth the other differently",
                recording=name,
                faster=name if rate > rates[0] else names[0],
                every=round(max(rate, rates[0]) / min(rate, rates[0])),
            )


def agreement_findings(
    network: CSLC, evidence: Sequence[Evidence], names: Sequence[str]
) -> Iterator[Finding]:
    """Find recordings whose torque the coefficients of the first do not predict, and the cause."""
    first = LeastSquares().fit(network, evidence[0].patterns, throw=False)
    k = np.asarray(first.k)
    for other, name in zip(evidence[1:], names[1:], strict=True):
        alone = other.errors(other.patterns)
        carried = _errors(network, k, other.patterns)
        worse = carried > np.maximum(_WORSE * alone, alone + _NEGLIGIBLE)
        if not worse.any():
            continue
        joints = [network.output_names[j] for j in np.flatnonzero(worse)]
        errors = zip(joints, carried[worse], alone[worse], strict=True)
        listed = (
            f"{j} {100 * other:.2g} % instead of {100 * own:.2g} %" for j, other, own in errors
        )
        kind, explanation, groups = _disagreement(network, k, other.patterns, carried, alone)
        yield finding(
            kind,
            f"the coefficients of {names[0]} leave more of its torque unexplained than its own:"
            f" {'; '.join(listed)}; {explanation}",
            ", ".join(joints),
            recording=name,
            first=names[0],
            groups=",".join(groups),
        )


def _disagreement(
    network: CSLC,
    k: Float[np.ndarray, " coefficients"],
    patterns: Patterns,
    carried: Float[np.ndarray, " joints"],
    alone: Float[np.ndarray, " joints"],
) -> tuple[str, str, list[str]]:
    """Return the kind of a disagreement, what explains it, and the groups of friction."""
    excess = np.maximum(carried**2 - alone**2, 0.0)

    def explained(network: CSLC, k: Any) -> float:
        errors = _errors(network, np.asarray(k), patterns)
        remaining = np.maximum(errors**2 - alone**2, 0.0)
        return 1.0 - float(np.sum(remaining) / np.sum(excess))

    solver = LeastSquares(errors="independent")
    groups = [group for group in ("viscous", "dry", "offset") if group in network.layout.groups]
    friction = 0.0
    if groups:
        fit = reidentify(network, patterns, k, groups=groups, solver=solver)
        friction = explained(network, fit.k)
    loaded = network.with_payload()
    fit = reidentify(loaded, patterns, k, groups=("payload",), solver=solver)
    payload = explained(loaded, fit.k)
    if max(friction, payload) <= _EXPLAINED:
        return "disagreement", "neither a payload nor friction explains the difference", groups
    if friction >= payload:
        share = f"other friction explains {100 * friction:.0f} % of the difference"
        return "friction", share, groups
    (index,) = loaded.layout.indices("pm")
    mass = f" ({float(fit.k[index]):+.2g} kg)" if bool(fit.determined[index]) else ""
    share = f"a body at the last link explains {100 * payload:.0f} % of the difference{mass}"
    return "payload", share, groups


def _errors(
    network: CSLC, k: Float[np.ndarray, " coefficients"], patterns: Patterns
) -> Float[np.ndarray, " joints"]:
    """Return the error of each joint as part of its torque's root mean square."""
    predicted = np.asarray(regressor_of(network, patterns)) @ k
    return error_part(np.asarray(patterns.torque) - predicted, patterns)
