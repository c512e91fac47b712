"""Causes that change the torque's model: scales, zeros, mounting, lengths, clock, and changes.

Each cause adds columns to the regressor (`_first_order`). The best few are refined, as the columns
hold for small faults only, and judged by the held-out errors of the recording as it would then
have been. The masses of the robot's file tell apart what the recording alone does not.
"""

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from ..least_squares import HostColumns, columns_of, torque_by, torque_of
from ..network import CSLC, derive
from ..recordings import Patterns, Recording
from ._evidence import LEAST_GAIN, TINY, Cause, Change, Evidence, counted_rms, removes
from ._findings import Finding, finding
from ._first_order import BLOCKS, Columns, FirstOrder, Score, gravity_columns
from ._geometry import geometry_errors


# Smallest faults that are named: parts, and angles [rad]. (Heuristic: sensors and files are right
# within them; what reports allow for unnamed is `Tolerances` of `jaxcslc.uncertainty`.)
_SCALE, _ZERO, _TILT, _CLOCK, _STRETCH = 0.05, 0.02, 0.03, 0.02, 0.03
_OTHER_MASSES = 2.0  # factor of the file's gravity beyond which it is no clock. (Heuristic.)
_LENGTH = 0.01  # m; an angle between axes is as `_TILT`
_LENGTH_ROUNDS = 3  # each takes another derivation
# As many causes are refined; of those whose gain of first order, a bound for small faults, is this
# part of what a cause must take away. (Heuristic: larger faults have larger gains once refined.)
_REFINED, _PROMISING = 5, 0.5
# A cause also counts if it takes away this part of the squares of one joint's error, which halves
# it, and that is a part of the torque that matters. (Heuristic.)
_OF_ONE_JOINT, _MATTERS = 0.75, 0.01
# Rounds of a refinement; the step that ends it, a tenth of the smallest fault; the largest factor,
# offset [rad or m] and stretch of one step, beyond which nothing is of first order.
_ROUNDS, _SMALL_STEP, _LARGEST_STEP, _LARGEST_OFFSET, _LARGEST_STRETCH = 10, 2e-3, 4.0, 0.5, 2.0
_LAST = 0.2  # of the smallest fault: the step of a direction or a length that is the last one
# Shares of gravity in the torque, over that of motion, that are tried; halved about the best.
_SHARES = (-1.5, -1.0, -0.7, 0.0, 0.1, 0.2, 0.35, 0.5, 0.7, 0.85, 1.2, 1.5, 2.0, 3.0, 5.0)
# Shares of gravity below which it was taken out, even without masses in the file. (Heuristic: a
# clock that makes such a share is nearly four times too slow.)
_NO_SHARE = 0.07
# The file's gravity is there from this factor on, and with the other sign, it acts the other way.
# (Heuristic: masses of files are wrong by 20 %, `_USUAL`; twice as much is not usual.)
_PRESENT = 0.6
TOUCHED = 4.0
"""Error of a block over the median of all from which something may touch the arm.

(Heuristic: 40 of 120 right recordings have such a block, `scripts.studies.checks.margins`. What its
removal gains decides.)"""
# Most blocks that are touched: the others are the rule; and rounds of trimmed least squares.
_MOST_TOUCHED, _TRIMS = 0.4, 4


def model_causes(evidence: Evidence, *, lengths: bool = True) -> list[Cause]:
    """Return causes in the model whose remedies take away most of the unexplained torque.

    - `lengths`: whether those of the robot's file are tried.
    """
    first = FirstOrder.of(evidence)
    before = first.score()
    options = possible_causes(first, lengths=lengths)
    gains = first_order_gains(first, options)
    order = [i for i in np.argsort(gains)[::-1] if gains[i] > _PROMISING * LEAST_GAIN]
    causes: list[Cause] = []
    # Lengths are many: they have a place of their own.
    tried = [options[i] for i in order if options[i][0] != "length"][:_REFINED]
    tried += [options[i] for i in order if options[i][0] == "length"][:1]
    factor = _file_factor(evidence)
    if (
        np.isfinite(factor)
        and factor < _PRESENT
        and all(kind != "share of gravity" for kind, *_ in tried)
    ):
        tried.append(next(option for option in options if option[0] == "share of gravity"))
    for kind, which, columns in tried:
        causes += _REFINE[kind](_Trial(evidence, first, before, kind, which, columns, factor))
    causes += _contact(evidence, first, before)
    return causes


Option: TypeAlias = tuple[str, int, Columns]
"""Kind of a cause, the joint, block or length that it is of, and the columns that it adds."""


def possible_causes(first: FirstOrder, *, lengths: bool = True) -> list[Option]:
    """Return the causes in the model that are tried.

    - `lengths`: whether those of the robot's file are.
    """
    joints = range(first.network.joint_count)
    options: list[Option] = [
        *(("scale of torque", joint, first.gains(joint)) for joint in joints),
        *(("zero", joint, first.group("zero", joint)) for joint in joints),
        *(("scale of position", joint, first.group("scale", joint)) for joint in joints),
        ("scales of torques", 0, first.gains(*joints)),
        ("share of gravity", 0, first.group("motion")),
        ("drift", 0, first.growing_friction()),
        *(("tool", block, first.payload_from(block)) for block in range(2, BLOCKS - 1)),
    ]
    if "gravity" in first.groups:
        options.append(("mounting", 0, first.group("gravity")))
    return options + (_lengths(first) if lengths else [])


def first_order_gains(first: FirstOrder, options: Sequence[Option]) -> list[float]:
    """Return the fall of the mean logarithm of errors of a fit with the columns of each cause."""
    whole = first.quick()
    return [whole - first.quick(columns) for _, _, columns in options]


def _lengths(first: FirstOrder) -> list[Option]:
    """Return options of lengths and angles of the robot's file."""
    if "length" not in first.groups:
        return []
    errors = geometry_errors(first.network)
    return [("length", i, first.group("length", i)) for i in range(len(errors))]


CLEAR = 5.0
"""Size of a fault in standard errors from which it may be named by its size alone.

Errors of twenty blocks are Student's with 19 degrees of freedom. In 1 % of right recordings, one of
the 28 faults of a six-joint arm exceeds 4.3 by chance. (Heuristic beyond that: what the model lacks
is no normal noise. 3 of 120 right recordings exceed 5, `scripts.studies.checks.margins`; the tests
below must find them.)"""
# Standard errors of what is left of a fault once it is mended: less than noise has in 1 % of
# recordings, by Student's distribution.
_GONE = 3.0
_HALF = 0.5  # of the least fault of its kind may be left as well
# A fault has one size, whatever the low pass. What noise of the accelerations passes for shrinks to
# less than half if the cut-off is halved. (Heuristic: a third is between the two.)
_COARSER, _CHANGED = 0.5, 1.0 / 3.0
_SAME = 0.97  # of the largest size in standard errors: causes that add the same torque
# Zeros that are off by more [rad or m] are no fault of first order: the second is a quarter of it.
_FIRST_ORDER = 0.5


# Least sizes of faults that are named by their size: that of a clock is in the torque of motion,
# which is as its square. Lengths are many, and other errors pass for small ones of them.
_LEAST: Mapping[str, float] = MappingProxyType(
    {
        "clock": 2.0 * _CLOCK,
        "zero": _ZERO,
        "scale of torque": _SCALE,
        "length": 2.0 * max(_LENGTH, _TILT),
    }
)


class SizedFault(NamedTuple):
    """Estimated size of a fault: a part, or m or rad.

    - `size`, `error`: and its standard error.
    - `kind`, `which`: as of an `Option`.
    """

    size: float
    error: float
    kind: str
    which: int

    @property
    def significance(self) -> float:
        """Size in standard errors."""
        return abs(self.size) / max(self.error, TINY)


def sized_faults(evidence: Evidence, *, lengths: bool = True) -> list[SizedFault]:
    """Return the faults whose sizes matter and are possible, however certain they are.

    - `lengths`: whether those of the robot's file are among them.
    """
    first, robot = FirstOrder.of(evidence), evidence.network.robot
    errors = geometry_errors(evidence.network)
    faults: list[SizedFault] = []
    for kind, which, columns in _sized_options(first, lengths):
        size, error = first.estimate(columns)
        possible = abs(size) > _LEAST[kind]
        if kind == "zero":
            possible &= abs(size) < _FIRST_ORDER
        elif kind == "length":
            possible &= errors[which].is_plausible(robot, size)
        faults += [SizedFault(size, error, kind, which)] if possible else []
    return faults


def _sized_options(first: FirstOrder, lengths: bool) -> list[Option]:
    joints = range(first.network.joint_count)
    return [
        ("clock", 0, first.group("motion")),
        *(("zero", joint, first.group("zero", joint)) for joint in joints),
        *(("scale of torque", joint, first.gains(joint)) for joint in joints),
        *(_lengths(first) if lengths else []),
    ]


def significant_cause(evidence: Evidence, *, lengths: bool = True) -> list[Finding]:
    """Return the fault that is there beyond doubt: a clock, zero, torque scale or length.

    Errors beside it may be so large that its remedy takes away little of them. It is named if its
    size is many standard errors, and if few are left of it once it is mended.

    - `lengths`: whether those of the robot's file are tried.

    **Returns** one finding at most.
    """
    faults = sized_faults(evidence, lengths=lengths)
    found = [fault for fault in faults if fault.significance > CLEAR]
    if not found:
        return []
    # Of causes that add the same torque, the one of recordings comes first.
    most = _SAME * max(fault.significance for fault in found)
    size, error, kind, which = next(fault for fault in found if fault.significance > most)
    network, joints = evidence.network, range(evidence.network.joint_count)

    def estimated(others: Evidence) -> tuple[float, float]:
        first = FirstOrder.of(others)
        options = _sized_options(first, lengths)
        return first.estimate(next(x for *at, x in options if at == [kind, which]))

    coarser = Evidence.of(network, evidence.recording, evidence.valid, _COARSER * evidence.cutoff)
    same, doubt = estimated(coarser)
    if abs(same - size) > max(_CHANGED * abs(size), _GONE * doubt):
        return []
    name, factors = network.output_names[which % len(joints)], np.ones(len(joints))
    recording, certain = evidence.recording, f"{abs(size) / error:.0f} standard errors"
    if kind == "clock":
        # Torque of motion is as the square of the rate; see `_gravity_share`.
        if size <= -1.0:
            return []
        factor = float(np.sqrt(1.0 + size))
        mended = Recording(recording.time / factor, recording.position, recording.torque)
        text = f"torques of inertia and gravity go together if time is divided by {factor:.3g}"
        result = finding("clock", f"{text}; {certain}", factor=f"{factor:.3g}")
    elif kind == "zero":
        offsets = np.where(np.arange(len(joints)) == which, size, 0.0)
        mended = Change(motion_offsets=offsets).recording(recording)
        revolute = evidence.network.joint_kinds[which] == "R"
        shown = f"{np.degrees(-size):.3g}°" if revolute else f"{-size:.3g} m"
        text = f"the torque fits best if {shown} is subtracted from positions; {certain}"
        result = finding("zero position", text, name, joint=name, offset=shown)
    elif kind == "length":
        network, what = _network_with_length(evidence.network, which, size)
        mended = recording
        result = finding("length", f"the torque fits best if {what}; {certain}", what=what)
    else:
        if size <= -1.0:
            return []
        factors[which] = 1.0 + size
        mended = Change(torque_factors=1.0 / factors).recording(recording)
        text = f"torque is {_times(1.0 + size)} times what goes with those of the others"
        listed = f"{name} {1.0 + size:.3g}"
        result = finding("torque scale: of some joints", f"{text}; {certain}", name, listed=listed)
    rest, error = estimated(Evidence.of(network, mended, evidence.valid))
    if abs(rest) >= max(_HALF * _LEAST[kind], _GONE * error):
        return []
    # A length of the file may add the same torque.
    others = [fault for fault in found if fault.kind == "length" and kind != "length"]
    alike = [fault for fault in others if fault.significance > most]
    if alike:
        _, what = _network_with_length(evidence.network, alike[0].which, alike[0].size)
        other = finding("length", "", what=what)
        result = result.or_else(other.cause, other.remedy)
    return [result]


@dataclasses.dataclass(frozen=True)
class _Trial:
    """A cause that is tried: its columns, and what they are compared with.

    - `before`: the errors without a cause.
    - `which`: the joint, or the block of time, from 0.
    - `factor`: of the file's gravity in the recording; NaN without masses.
    """

    evidence: Evidence
    first: FirstOrder
    before: Score
    kind: str
    which: int
    columns: Columns
    factor: float

    @property
    def name(self) -> str:
        """Name of the joint."""
        return self.evidence.network.output_names[self.which]

    def cause(
        self,
        row: str,
        joint: str,
        after: Score,
        text: str,
        mended: Callable[[], Evidence | None],
        /,
        **values: Any,
    ) -> Iterator[Cause]:
        """Yield the cause if its remedy takes away the evidence."""
        before, noise = self.before, self.evidence.noise
        gain = before.mean - after.mean
        halved = after.errors**2 < (1.0 - _OF_ONE_JOINT) * before.errors**2
        if gain < LEAST_GAIN and not np.any(halved & (before.errors > _MATTERS)):
            return
        if not removes(before.errors, after.errors, noise):
            return
        names = self.evidence.network.output_names
        worst = int(np.argmax(before.errors / np.maximum(after.errors, TINY)))
        errors = (
            f"torque errors are {100 * before.errors[worst]:.3g} % of the torque of"
            f" {names[worst]}, and {100 * after.errors[worst]:.3g} % without it"
        )
        yield Cause(finding(row, f"{text}; {errors}", joint, **values), gain, mended)

    def rescored(self, patterns: Patterns) -> Score:
        """Return the errors of changed patterns."""
        return FirstOrder.of(self.evidence, patterns, only=("", 0)).score()


def _torque_scale(trial: _Trial) -> Iterator[Cause]:
    """Yield the scale of one joint's torque, or of those of all, relative to the others."""
    evidence, count = trial.evidence, trial.evidence.network.joint_count
    joints = range(count) if trial.kind == "scales of torques" else [trial.which]
    factors = np.ones(count)

    for _ in range(_ROUNDS):
        first = trial.first.scaled(1.0 / factors)
        steps = first.sizes(first.gains(*joints))
        factors[[*joints]] *= np.clip(1.0 + steps, 1.0 / _LARGEST_STEP, _LARGEST_STEP)
        if np.max(np.abs(steps)) < _SMALL_STEP:
            break
    if len(joints) > 1:
        factors /= np.median(factors)
    off = np.flatnonzero(np.abs(factors - 1.0) > _SCALE)
    if not off.size:
        return
    names = [evidence.network.output_names[joint] for joint in off]
    listed = ", ".join(f"{name} {factors[j]:.3g}" for name, j in zip(names, off, strict=True))
    yield from trial.cause(
        "torque scale: of some joints",
        ", ".join(names),
        trial.first.scaled(1.0 / factors).score(),
        f"torques are too large for the motion of the other joints by factors of {listed}"
        if len(names) > 1
        else f"torque is {_times(float(factors[off[0]]))} times what goes with those of the others",
        partial(Change(torque_factors=1.0 / factors).mended, trial.evidence),
        listed=listed,
    )


def _times(factor: float) -> str:
    """Return a factor in three digits, and as an integer where it has more.

    >>> _times(1.4978), _times(1034.6)
    ('1.5', '1035')
    """
    return f"{factor:.3g}" if factor < 999.5 else f"{factor:.0f}"


def _zero_position(trial: _Trial) -> Iterator[Cause]:
    offset, steps = np.zeros(trial.evidence.network.joint_count), 1.0
    for _ in range(_ROUNDS):
        patterns = Change(motion_offsets=offset).patterns(trial.evidence.patterns)
        first = FirstOrder.of(trial.evidence, patterns, only=("zero", trial.which))
        steps = float(first.sizes(first.group("zero"))[0])
        offset[trial.which] += np.clip(steps, -_LARGEST_OFFSET, _LARGEST_OFFSET)
        if abs(steps) < _SMALL_STEP:
            break
    size = float(-offset[trial.which])
    if not _ZERO < abs(size) < np.pi:
        return
    change = Change(motion_offsets=offset)
    revolute = trial.evidence.network.joint_kinds[trial.which] == "R"
    shown = f"{np.degrees(size):.3g}°" if revolute else f"{size:.3g} m"
    yield from trial.cause(
        "zero position",
        trial.name,
        trial.rescored(change.patterns(trial.evidence.patterns)),
        f"the torque fits best if {shown} is subtracted from positions",
        partial(change.mended, trial.evidence),
        joint=trial.name,
        offset=shown,
    )


def _position_scale(trial: _Trial) -> Iterator[Cause]:
    factors = np.ones(trial.evidence.network.joint_count)
    for _ in range(_ROUNDS):
        patterns = Change(motion_factors=factors).patterns(trial.evidence.patterns)
        first = FirstOrder.of(trial.evidence, patterns, only=("scale", trial.which))
        step = float(first.sizes(first.group("scale"))[0])
        factors[trial.which] *= np.clip(1.0 + step, 1.0 / _LARGEST_STRETCH, _LARGEST_STRETCH)
        if abs(step) < _SMALL_STEP:
            break
    factor = float(1.0 / factors[trial.which])
    if abs(factor - 1.0) < _STRETCH:
        return
    change = Change(motion_factors=factors)
    yield from trial.cause(
        "position scale",
        trial.name,
        trial.rescored(change.patterns(trial.evidence.patterns)),
        f"positions fit the torque best divided by {factor:.3g}",
        partial(change.mended, trial.evidence),
        joint=trial.name,
        factor=f"{factor:.3g}",
    )


def _gravity_share(trial: _Trial) -> Iterator[Cause]:
    """Yield what changes gravity's torque relative to that of motion: a clock, or compensation.

    Torque of motion is proportional to the square of the time's unit, gravity's is not.
    """
    evidence, network = trial.evidence, trial.evidence.network
    patterns = evidence.patterns
    moving = evidence.columns(patterns)
    zeros = np.zeros_like(np.asarray(patterns.q))
    still = columns_of(network, dataclasses.replace(patterns, qd=zeros, qdd=zeros))

    def columns(share: float) -> HostColumns:
        pairs = zip(moving, still, strict=True)
        return tuple(rows + (share - 1.0) * rest for rows, rest in pairs)

    def errors(share: float) -> Score:
        return Score(evidence.errors(patterns, columns(share)))

    scores = {share: errors(share) for share in _SHARES}
    for _ in range(2):  # halve the intervals about the best
        ordered = sorted(scores)
        best = min(ordered, key=lambda share: scores[share].mean)
        at = ordered.index(best)
        for other in (ordered[max(at - 1, 0)], ordered[min(at + 1, len(ordered) - 1)]):
            middle = 0.5 * (best + other)
            if middle not in scores:
                scores[middle] = errors(middle)
    share = min(scores, key=lambda share: scores[share].mean)
    after = scores[share]
    trial = dataclasses.replace(trial, before=Score(evidence.relative_errors))
    known = np.isfinite(trial.factor)
    if share < -_PRESENT:
        gravity = -np.array(network.robot.gravity)
        yield from trial.cause(
            "mounting",
            "",
            after,
            "gravity acts the other way round than in the robot's file",
            lambda: _mounted(evidence, gravity),
            gravity=_vector(gravity),
        )
        return
    if share < _NO_SHARE or (share < _PRESENT and known and trial.factor < _PRESENT):
        k = evidence.coefficients(patterns, columns(share))
        recording = evidence.recording
        at_rest = np.zeros_like(recording.position)
        whole = np.ones(at_rest.shape, bool)
        rows = Patterns(
            recording.time, recording.position, at_rest, at_rest, recording.torque, whole, whole
        )
        inertial = np.zeros(network.size)
        inertial[network.layout.inertial] = k[network.layout.inertial]
        missing = (1.0 - share) * torque_of(network, rows, inertial)
        mended = Recording(recording.time, recording.position, recording.torque + missing)
        yield from trial.cause(
            "gravity compensation",
            "",
            after,
            f"the torque holds {100 * max(share, 0.0):.0f} % of the gravity that goes with its"
            " inertia",
            lambda: Evidence.of(network, mended, evidence.valid),
        )
        return
    clock = share**-0.5
    if abs(clock - 1.0) < _CLOCK or (
        known and not 1.0 / _OTHER_MASSES < trial.factor < _OTHER_MASSES
    ):
        return
    slow = Recording(
        evidence.recording.time / clock, evidence.recording.position, evidence.recording.torque
    )
    yield from trial.cause(
        "clock",
        "",
        after,
        f"torques of inertia and gravity go together if time is divided by {clock:.3g}",
        lambda: Evidence.of(network, slow, evidence.valid),
        factor=f"{clock:.3g}",
    )


def _mounting(trial: _Trial) -> Iterator[Cause]:
    """Yield another direction of gravity in the base frame."""
    evidence, first = trial.evidence, trial.first
    given = np.array(trial.evidence.network.robot.gravity, float)
    size = float(np.linalg.norm(given))
    gravity, angle = given.copy(), 0.0
    if size == 0.0:
        return
    for round in range(3):
        gravity = gravity + first.sizes(first.group("gravity"))
        gravity *= size / max(float(np.linalg.norm(gravity)), TINY)
        angle = float(np.arccos(np.clip(gravity @ given / size**2, -1.0, 1.0)))
        if angle < _TILT:
            return
        tilted = _mounted(evidence, gravity)
        first = FirstOrder.of(tilted, only=("gravity", 0))
        turn = float(np.linalg.norm(np.cross(first.sizes(first.group("gravity")), gravity)))
        if turn < _LAST * _TILT * size**2 or round == 2:
            break
    yield from trial.cause(
        "mounting",
        "",
        first.score(),
        f"gravity acts along {_vector(gravity)} m/s² in the base frame, {np.degrees(angle):.3g}°"
        " from the direction in the robot's file",
        lambda: _mounted(evidence, gravity),
        gravity=_vector(gravity),
    )


def _mounted(evidence: Evidence, gravity: Float[np.ndarray, "3"]) -> Evidence:
    """Return the evidence with another gravity vector in the base frame."""
    network = evidence.network
    numeric = derive(network.robot.with_gravity(gravity.tolist()), lengths="numeric")
    return dataclasses.replace(evidence, network=numeric.without_load())


def _vector(values: np.ndarray) -> str:
    return f"({', '.join(f'{value:.3g}' for value in values + 0.0)})"


def _length(trial: _Trial) -> Iterator[Cause]:
    """Yield a length or an angle of the robot's file that is not the arm's."""
    size, first, mended, what = 0.0, trial.first, trial.evidence, ""
    least = _TILT if geometry_errors(mended.network)[trial.which].is_angle else _LENGTH
    for _ in range(_LENGTH_ROUNDS):
        step = float(first.sizes(first.group("length", trial.which))[0])
        size += step
        if abs(size) < least:
            return
        network, what = _network_with_length(trial.evidence.network, trial.which, size)
        mended = dataclasses.replace(trial.evidence, network=network)
        first = FirstOrder.of(mended, only=("length", trial.which))
        if abs(step) < _LAST * least:
            break
    if not geometry_errors(trial.evidence.network)[trial.which].is_plausible(
        trial.evidence.network.robot, size
    ):
        return
    yield from trial.cause(
        "length",
        "",
        first.score(),
        f"the torque fits best if {what}",
        lambda: mended,
        what=what,
    )


def _network_with_length(network: CSLC, which: int, size: float) -> tuple[CSLC, str]:
    """Return the network with an error of its file added, and what was, in words."""
    error, robot = geometry_errors(network)[which], network.robot
    what = error.described(network.output_names, robot.parents[error.joint], size)
    return derive(error.robot(robot, size), lengths="numeric").without_load(), what


def _drift(trial: _Trial) -> Iterator[Cause]:
    after = trial.first.score(trial.columns)
    names = np.array(trial.evidence.network.output_names)
    halved = after.errors**2 < 0.5 * trial.before.errors**2
    joints = ", ".join(names[halved])
    yield from trial.cause(
        "drift",
        joints,
        after,
        "friction or the zero of torque changes steadily from the start to the end",
        lambda: None,
    )


def _tool(trial: _Trial) -> Iterator[Cause]:
    first, evidence = trial.first, trial.evidence
    moment = float(first.edges[trial.which])
    mass = float(first.sizes(trial.columns)[-1])
    time, middle = evidence.recording.time, 0.5 * float(first.edges[0] + first.edges[-1])
    rows = time < moment if moment > middle else time > moment
    start, end = (float(time[rows][i]) for i in (0, -1))

    def longer_part() -> Evidence:
        part = evidence.recording.rows(rows)
        return Evidence.of(evidence.network, part, evidence.valid[rows])

    shown = f" ({mass:+.2g} kg)" if abs(mass) > TINY else ""
    yield from trial.cause(
        "tool change",
        "",
        first.score(trial.columns),
        f"the torque is that of another body at the last link{shown} from {moment:.3g} s on",
        longer_part,
        start=start,
        end=end,
    )


def _contact(evidence: Evidence, first: FirstOrder, before: Score) -> Iterator[Cause]:
    """Yield a stretch whose torque the coefficients of all others do not explain."""
    ratio = block_ratios(evidence, first)
    touched = _main_stretch(ratio.max(axis=1))
    # The blocks beside may be touched in part.
    wide = touched.copy()
    wide[1:] |= touched[:-1]
    wide[:-1] |= touched[1:]
    if not touched.any() or wide.mean() > _MOST_TOUCHED:
        return
    start, end = first.edges[np.flatnonzero(wide)[0]], first.edges[np.flatnonzero(wide)[-1] + 1]
    names = np.array(evidence.network.output_names)
    joints = names[np.any((ratio > TOUCHED) & wide[:, None], axis=0)]
    trial = _Trial(evidence, first, before, "contact", 0, Columns(np.zeros((1, 1, 1, 0))), np.nan)

    def without() -> Evidence:
        time = evidence.recording.time
        outside = (time < start) | (time > end)
        return Evidence.of(evidence.network, evidence.recording, evidence.valid & outside[:, None])

    yield from trial.cause(
        "contact",
        ", ".join(joints),
        first.without(wide).score(),
        f"from {start:.3g} s to {end:.3g} s the torque is another one than that of all other"
        " motion",
        without,
        start=f"{start:.3g}",
        end=f"{end:.3g}",
    )


def block_ratios(evidence: Evidence, first: FirstOrder) -> Float[np.ndarray, "blocks joints"]:
    """Return the errors of blocks over the usual ones; 0 where they do not matter.

    Least trimmed squares: each time, the fit omits the blocks with the largest errors.
    """
    left = np.zeros(BLOCKS, bool)
    ratio = np.zeros(first.counts.shape)
    for _ in range(_TRIMS):
        errors = first.without(left).block_errors(first)
        usual = np.median(errors[~left], axis=0)
        ratio = errors / np.maximum(usual, np.maximum(evidence.noise, TINY))
        ratio = np.where(errors > _MATTERS, ratio, 0.0)
        left = np.zeros(BLOCKS, bool)
        left[np.argsort(ratio.max(axis=1))[BLOCKS - round(_MOST_TOUCHED * BLOCKS) :]] = True
    return ratio


def _main_stretch(ratio: Float[np.ndarray, " blocks"]) -> Bool[np.ndarray, " blocks"]:
    """Mark the blocks beside the one with the largest ratio that are touched as well."""
    touched, top = ratio > TOUCHED, int(np.argmax(ratio))
    stretch = np.zeros(len(ratio), bool)
    for blocks in (range(top, len(ratio)), range(top, -1, -1)):
        for block in blocks:
            if not touched[block]:
                break
            stretch[block] = True
    return stretch


_REFINE: dict[str, Callable[[_Trial], Iterator[Cause]]] = {
    "scale of torque": _torque_scale,
    "scales of torques": _torque_scale,
    "zero": _zero_position,
    "scale of position": _position_scale,
    "share of gravity": _gravity_share,
    "mounting": _mounting,
    "drift": _drift,
    "tool": _tool,
    "length": _length,
}


@dataclasses.dataclass(frozen=True)
class FileFactors:
    """Factors of the file's gravity in a recording, of joints that gravity loads.

    - `joints`: the joints, from 0.
    - `factor`: of gravity's torque; 1 where file and recording agree.
    - `error`: its standard error.
    """

    joints: Int[np.ndarray, " loaded"]
    factor: Float[np.ndarray, " loaded"]
    error: Float[np.ndarray, " loaded"]

    @property
    def common(self) -> float:
        """Median factor; NaN without joints that gravity loads."""
        return float(np.median(self.factor)) if self.joints.size else np.nan


# A joint is loaded if gravity's torque is this part of that of the most loaded joint (heuristic),
# and at least as large as what motion takes; its factor counts if its relative error is below what
# masses of files are usually wrong by.
_LOADED, _KNOWN = 0.15, 0.2
_ROWS_ALIKE = 5.0  # rows that share their errors: five a period of the cut-off are kept
_EIGENVALUES = 1e-10  # of normal equations of four columns that count


def file_factors(evidence: Evidence) -> FileFactors | None:
    """Compare gravity's torque with that of the file's masses; None if the file has none.

    Joint by joint, torque is a factor times the file's gravity, another times the file's torque of
    motion, and friction.
    """
    patterns, network = evidence.patterns, evidence.network
    q, qd, torque = (np.asarray(x) for x in (patterns.q, patterns.qd, patterns.torque))
    per_axis = gravity_columns(network, q)
    if per_axis is None or network.robot.links is None:
        return None
    gravity = per_axis @ np.array(network.robot.gravity, float)
    k = np.asarray(network.coefficients_from(network.robot.links))
    motion = torque_by(network.support, evidence.columns(patterns), k) - gravity
    mask = np.asarray(patterns.mask)
    sizes, others = (counted_rms(x, mask) for x in (gravity, motion))
    loaded = (sizes > _LOADED * np.max(sizes)) & (sizes > others) & (mask.sum(axis=0) > 20)
    factors: list[tuple[int, float, float]] = []
    for joint in np.flatnonzero(loaded & (np.ptp(torque, axis=0) > 0.0)).tolist():
        rows = mask[:, joint]
        terms = (gravity[:, joint], motion[:, joint], qd[:, joint], np.sign(qd[:, joint]))
        matrix = np.stack(terms, axis=1)[rows]
        scale = np.maximum(np.sqrt(np.sum(matrix**2, axis=0)), TINY)
        inverse = np.linalg.pinv((matrix / scale).T @ (matrix / scale), _EIGENVALUES, True)
        solution = inverse @ ((matrix / scale).T @ torque[rows, joint]) / scale
        residual = torque[rows, joint] - matrix @ solution
        variance = _ROWS_ALIKE * float(np.mean(residual**2))
        error = np.sqrt(variance * inverse[0, 0]) / scale[0]
        if error < _KNOWN * max(abs(solution[0]), 1.0):
            factors.append((joint, float(solution[0]), float(error)))
    joints, values, errors = zip(*factors, strict=True) if factors else ((), (), ())
    return FileFactors(np.array(joints, int), np.array(values, float), np.array(errors, float))


def _file_factor(evidence: Evidence) -> float:
    factors = file_factors(evidence)
    return np.nan if factors is None else factors.common


# What files' masses are usually wrong by, as a logarithm (heuristic; so are those of
# `scripts.studies.checks.robots`). Standard deviations that 1 % of right files exceed, by the
# normal distribution; and a factor that is named, 20 % and some.
_USUAL, _SIGNIFICANT, _FACTOR = 0.2, 2.5, 1.25
SPREAD = 0.5
"""Deviation of joints' factors from each other, as a logarithm, of another robot's file.

(Heuristic: right recordings have 0.1 at most, `scripts.studies.checks.margins`.)"""


def file_findings(evidence: Evidence) -> Iterator[Finding]:
    """Compare a recording, which nothing else looks wrong with, with its file's masses and limits.

    **Yields** a common factor of all torques, or that it is another robot's file.
    """
    factors = file_factors(evidence)
    names = np.array(evidence.network.output_names)
    if factors is not None and factors.joints.size and np.all(factors.factor > 0.0):
        logs = np.log(factors.factor)
        weights = 1.0 / (_USUAL**2 + (factors.error / factors.factor) ** 2)
        mean = float(weights @ logs / weights.sum())
        spread = float(np.sqrt(weights @ (logs - mean) ** 2 / weights.sum()))
        listed = ", ".join(
            f"{name} {factor:.3g}"
            for name, factor in zip(names[factors.joints], factors.factor, strict=True)
        )
        text = f"gravity's torques are those of the masses in the robot's file times {listed}"
        if factors.joints.size > 1 and spread > SPREAD:
            yield finding("wrong robot", text)
        elif abs(mean) > max(np.log(_FACTOR), _SIGNIFICANT / np.sqrt(weights.sum())):
            # Lengths of another robot change gravity's torque relative to that of motion.
            first = FirstOrder.of(evidence)
            gain = first.score().mean - first.score(first.group("motion")).mean
            if gain > LEAST_GAIN:
                text += ", and its lengths are not those of the motion's inertia"
            yield finding("wrong robot" if gain > LEAST_GAIN else "torque scale", text)
