"""Choice of friction terms, joint by joint, by errors on held-out data.

Stretches of one recording are alike. So a term is judged a second time on motion that differs: fits
to the slow half predict the fast half and the other way round, fits to positions near the middle
those far from it, and a fit to the recording predicts all others.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..friction import (
    PreSlidingFit,
    along_motion,
    fit_load,
    fit_slopes,
    informed_errors,
    linearised,
)
from ..least_squares import Identification, Settings, columns_of, torque_of, unknowns_of
from ..manipulator import RobotError
from ..network import CSLC, DIRECTIONAL_LOAD, LOAD
from ..recordings import (
    DEFAULT_THRESHOLD_FRACTION,
    Derivatives,
    Patterns,
    Recording,
    friction_mask,
    friction_thresholds,
    static_fractions,
)
from ..uncertainty import RelativeError, fold_numbers, unlike_halves
from ._selection import choose_settings


OFFSET = "offset"
# In the order in which they are tried: a constant decides more, on real arms, than all others.
# Friction that differs between directions is viscous and dry: tried one by one, either compensates
# the other.
FRICTION_CANDIDATES = (
    OFFSET,
    "asymmetric_viscous",
    "asymmetric_viscous and offset",
    "static",
    "root",
    "quadratic",
    "spring",
    LOAD,
    DIRECTIONAL_LOAD,
)
# Kinds that take the place of another one, which they have in them.
_REPLACES = {"asymmetric_viscous": "viscous"}
# An offset is told from gravity if its standard error is at most this part of the joint's dry
# friction, or if it is so many standard errors from 0.
_OFFSET_ERROR, _OFFSET_SIGNIFICANT = 0.1, 5.0
# Two terms together are used instead of one if the logarithm of errors is smaller by this.
_GAIN_OF_SECOND = 0.01
# What trials of a state of dry friction are called (`fit_pre_sliding`).
PRE_SLIDING = "pre-sliding"
# Rounds of adding terms.
_ROUNDS = 3

Informed = Callable[[CSLC, Identification], Callable[[Any], Any] | None]
"""Function of a network and its fit that returns what adds knowledge of bodies to fits of parts of
the motion, or None without such knowledge."""


@dataclasses.dataclass(frozen=True)
class FrictionTrial:
    """A friction term, tried at one joint.

    **Attributes**

    - `joint`: counted from 1; `kind`: of the term, or two of them joined by "and".
    - `relative`: the joint's held-out error with the term over that without it; of pre-sliding over
      all samples, of other kinds over those at which the joint moves.
    - `elsewhere`: the same on motion that differs from what was fitted: in speed and position, or
      other recordings, whichever are predicted worse.
    - `used`: whether the joint has the term in the end.
    - `possible`: whether the fit kept the term: a slope of static friction may not be determined, a
      coefficient of the load may be none that friction has, no length of pre-sliding may fit
      better than none. An offset is possible where the motion tells it from gravity, which is
      looked at only if some joint's held-out error falls by it.
    - `length`: of pre-sliding [`length_unit`]; None of other kinds. `length_unit`: rad or m.

    >>> from jaxcslc.selection import FrictionTrial
    >>> from jaxcslc.uncertainty import RelativeError
    >>> print(FrictionTrial(1, "offset", RelativeError(-0.1, 0.02, 8), used=True))
    offset -9.5 % ± 2 %, used
    """

    joint: int
    kind: str
    relative: RelativeError
    used: bool
    possible: bool = True
    length: float | None = None
    length_unit: str = "rad"
    elsewhere: RelativeError | None = None

    def __str__(self) -> str:
        if not self.possible:
            reason = "not told from gravity" if "offset" in self.kind else "dropped by the fit"
            return f"{self.kind} {reason}"
        length = (
            ""
            if self.length is None
            else f" over all samples, length {self.length:.2g} {self.length_unit}"
        )
        other = self.elsewhere
        differs = "" if other is None else f" ({100 * np.expm1(other.change):+.2g} % elsewhere)"
        return f"{self.kind} {self.relative}{differs}{length}{', used' if self.used else ''}"

    def document(self) -> dict[str, Any]:
        """Return the trial as plain data."""
        entries = dataclasses.asdict(self)
        relative, elsewhere = entries.pop("relative"), entries.pop("elsewhere")
        return {
            **entries,
            "change": relative["change"],
            "change_error": relative["change_error"],
            "change_elsewhere": None if elsewhere is None else elsewhere["change"],
        }


@dataclasses.dataclass(frozen=True, eq=False)
class FrictionChoice:
    """Friction terms chosen joint by joint, and what each was worth.

    **Attributes**

    - `network`: with the terms; the robot that it was derived from is `network.robot`.
    - `trials`: in the order in which they were made.
    - `note`: what was added without a trial, if anything was.
    - `brief`: whether sentences name only what is used.
    """

    network: CSLC
    trials: tuple[FrictionTrial, ...]
    note: str | None = None
    brief: bool = False

    @property
    def sentences(self) -> tuple[str, ...]:
        """Sentences, one per joint: what was tried, and what it changed of held-out errors."""
        if self.brief:
            names = self.network.output_names
            used = [f"{names[x.joint - 1]} {x.kind} {x.relative}" for x in self.trials if x.used]
            words = "friction terms added, held-out error with a term over that without"
            return (f"{words}: {', '.join(used)}",) if used else ()
        by_joint: dict[int, list[str]] = {}
        for trial in self.trials:
            by_joint.setdefault(trial.joint, []).append(str(trial))
        names = self.network.output_names
        tried = (
            f"friction of {names[joint - 1]}, held-out error with a term over that without:"
            f" {'; '.join(of_joint)}"
            for joint, of_joint in sorted(by_joint.items())
        )
        return (*tried, *(() if self.note is None else (self.note,)))

    def document(self) -> list[dict[str, Any]]:
        """Return the trials as plain data."""
        return [trial.document() for trial in self.trials]

    def with_pre_sliding(self, fit: PreSlidingFit) -> "FrictionChoice":
        """Add the distances of pre-sliding of every joint with dry friction to the trials."""
        units = self.network.output_units
        nothing = RelativeError(0.0, np.inf, 0)
        trials = (
            FrictionTrial(
                joint,
                PRE_SLIDING,
                fit.relative.get(joint, nothing),
                used=bool(fit.presliding_distance[joint - 1] > 0.0),
                possible=joint in fit.relative,
                length=float(fit.tried_distance[joint - 1]),
                elsewhere=fit.elsewhere.get(joint),
                length_unit="m" if units[joint - 1] == "N" else "rad",
            )
            for joint, kinds in enumerate(self.network.friction_per_joint, start=1)
            if "dry" in kinds
        )
        return dataclasses.replace(self, trials=(*self.trials, *trials))

    def with_static_friction(self) -> "FrictionChoice":
        """Add static friction to every joint whose dry friction follows the sign of velocity.

        Smoothed reversals, which trials are judged on, do not show it. An estimator without a
        smoothing sees it, and without it gravity and dry friction absorb it. Where a state
        of dry friction is used, that is what friction before sliding is: static friction beside it
        would absorb errors of its length.
        """
        kinds = self.network.friction_per_joint
        yielding = {
            trial.joint for trial in self.trials if trial.used and trial.kind == PRE_SLIDING
        }
        wider = [
            (*laws, "static")
            if "dry" in laws and "static" not in laws and joint not in yielding
            else laws
            for joint, laws in enumerate(kinds, start=1)
        ]
        joints = [i for i, (new, old) in enumerate(zip(wider, kinds, strict=True)) if new != old]
        if not joints:
            return self
        names = ", ".join(self.network.output_names[joint] for joint in joints)
        return FrictionChoice(
            self.network.with_joint_friction(wider),
            self.trials,
            f"friction of kind 'static' added, {names}: maximum likelihood estimates it where"
            " smoothed motion does not show it",
        )

    def __str__(self) -> str:
        return "\n".join(self.sentences)


def choose_friction(
    network: CSLC,
    recording: Recording,
    settings: Settings | None = None,
    *,
    candidates: Sequence[str] = FRICTION_CANDIDATES,
    others: Sequence[Recording] = (),
    motion: Derivatives | None = None,
    presliding_distance: Float[np.ndarray, " joints"] | None = None,
    informed: Informed | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> FrictionChoice:
    """Friction terms that predict motion better that was not fitted, joint by joint.

    Starts with the network's terms. In each round every candidate is added to all joints that lack
    it, and a joint gets the one that makes its error smallest on stretches held out of
    the fit, if it falls by 1 % at least and by more than chance explains (Student's t over the
    stretches, one-sided, at 5 % divided by the number of candidates); until no joint gets another.
    On motion that differs from what was fitted its error must not rise: slow or fast motion,
    positions near the middle or far from it, another recording.
    Viscous friction of each direction takes the place of that of both.

    Stretches of one recording have one range of motion, in which an offset may be as good as a
    wrong gravity that another range shows. So a joint gets an offset only if its standard error is
    at most a tenth of the joint's dry friction, or a fifth of the offset.

    **Arguments**

    - `network`: n joints, p coefficients.
    - `recording`: to choose on.
    - `settings`: of preparation and fit; chosen on the recording if None.
    - `candidates`: kinds of friction, or some joined by "and". Those that are collinear with a
      joint's terms are left out.
    - `others`: recordings of the same robot, which terms are judged on too.
    - `motion`: the recording's derivatives by the settings, if they are known already.
    - `presliding_distance`: (n,) of joints whose dry friction has a state (`fit_pre_sliding`), 0 of
      others: terms are judged beside it, so that none compensates for it. Such joints get no static
      friction, which is what friction before sliding is.
    - `informed`: of a network and its fit, returns what adds known bodies to fits of parts of the
      motion, which terms are judged by.
    - `progress`: is called with a few words at each trial.

    **Returns** a `FrictionChoice`.

    **Raises** `ValueError`, `RuntimeError`: as `choose_settings`, `LeastSquares.fit`.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.selection import choose_friction
    >>> true = jc.derive(jc.examples.turntable("viscous", "offset"))
    >>> exact = jc.examples.swing_recording(true, [0.5, 0.4, 0.3])  # with a constant torque
    >>> noise = 0.01 * np.random.default_rng(0).normal(size=exact.torque.shape)
    >>> recording = jc.Recording(exact.time, exact.position, exact.torque + noise)
    >>> network = jc.derive(jc.examples.turntable("viscous"))
    >>> choice = choose_friction(network, recording, jc.Settings(), candidates=["offset"])
    >>> choice.network.names
    ('kM1', 'kv1', 'ko1')
    """
    if settings is None:
        progress("choosing settings")
        settings = choose_settings(network, recording).settings
    yields = np.zeros(network.joint_count) if presliding_distance is None else presliding_distance
    judge = _Judge(recording, settings, others, motion, yields, informed)
    trials: list[FrictionTrial] = []
    chance = 0.05 / max(len(candidates), 1)
    for _ in range(_ROUNDS):
        before = judge.held_out(network)
        tried: list[FrictionTrial] = []
        for kind in candidates:
            static = "static" in _kinds(kind)
            barred = tuple((np.flatnonzero(yields) + 1).tolist()) if static else ()
            for richer, joints in _with(network, kind, barred):
                progress(f"trying friction: {kind}")
                try:
                    after = judge.held_out(richer)
                except (ValueError, RuntimeError):  # nothing in the motion determines it
                    continue
                added: list[FrictionTrial] = []
                for joint in joints:
                    possible = {*_kinds(kind)} <= {*after.laws[joint - 1]}
                    relative, *differing = after.relative(before, joint)
                    worst = max(differing, key=lambda some: some.change)
                    added.append(
                        FrictionTrial(joint, kind, relative, False, possible, elsewhere=worst)
                    )
                if "offset" in kind and any(_gains(trial, chance) for trial in added):
                    unclear = judge.unclear_offsets(richer)
                    added = [
                        dataclasses.replace(trial, possible=trial.possible and joint not in unclear)
                        for joint, trial in zip(joints, added, strict=True)
                    ]
                tried += added
        best = _best(tried, chance)
        trials += [dataclasses.replace(trial, used=trial in best.values()) for trial in tried]
        if not best:
            break
        network = network.with_joint_friction(
            [
                _with_kind(kinds, best[joint].kind) if joint in best else kinds
                for joint, kinds in enumerate(network.friction_per_joint, start=1)
            ]
        )
    return FrictionChoice(network, tuple(trials))


def with_all_offsets(network: CSLC) -> CSLC:
    """Return the network with a torque offset of every joint that may have one."""
    return next((richer for richer, _ in _with(network, OFFSET)), network)


def _with(network: CSLC, kind: str, barred: Sequence[int] = ()) -> Iterator[tuple[CSLC, list[int]]]:
    """Yield networks with a kind of friction added, and the joints that it was added to, from 1.

    It is added at all joints that may have it.

    Of directional friction, joint by joint: at all of them, no motion would determine it.

    - `barred`: joints, from 1, that may not have it.
    """
    kinds_of_joints = list(network.friction_per_joint)
    joints: list[int] = []
    for joint, kinds in enumerate(kinds_of_joints, start=1):
        if joint in barred or {*_kinds(kind)} & {*kinds}:
            continue
        richer = _with_kind(kinds, kind)
        try:
            network.robot.with_friction(*richer, joint=joint)
        except RobotError:  # collinear
            continue
        kinds_of_joints[joint - 1] = richer
        joints.append(joint)
    sets = [[joint] for joint in joints] if kind == DIRECTIONAL_LOAD else [joints]
    for some in sets:
        if some:
            laws = [
                kinds if joint in some else before
                for joint, (kinds, before) in enumerate(
                    zip(kinds_of_joints, network.friction_per_joint, strict=True), start=1
                )
            ]
            yield network.with_joint_friction(laws), some


def _kinds(candidate: str) -> tuple[str, ...]:
    return tuple(candidate.split(" and "))


def _with_kind(kinds: Sequence[str], candidate: str) -> tuple[str, ...]:
    """A joint's friction with a candidate, which replaces what it has in it."""
    more = _kinds(candidate)
    replaced = [_REPLACES.get(kind) for kind in more]
    return (*(kind for kind in kinds if kind not in replaced), *more)


class _Part(NamedTuple):
    """Errors on motion that a fit has not seen (samples, n), what counts of them, and the number of
    each sample's fit or recording, ascending."""

    errors: Float[np.ndarray, "samples joints"]
    mask: Bool[np.ndarray, "samples joints"]
    fold: Int[np.ndarray, " samples"]


@dataclasses.dataclass(frozen=True)
class _HeldOut:
    """Errors of a network's fits: on stretches, on halves of motion, and on other recordings.

    - `laws`: the joints' friction where the fit was possible.
    """

    parts: tuple[_Part, ...]
    laws: tuple[tuple[str, ...], ...]

    def relative(self, reference: "_HeldOut", joint: int) -> list[RelativeError]:
        """Compare errors of a joint, from 1, with others on the same motion: one of each part."""
        return [
            RelativeError.of_joint(part.errors, other.errors, part.mask, part.fold, joint)
            for part, other in zip(self.parts, reference.parts, strict=True)
        ]


@dataclasses.dataclass(frozen=True, eq=False)
class _Judge:
    """Recordings that terms are judged on: a fitted one, and `others`.

    - `motion`: derivatives of the fitted one, where they are known.
    - `presliding_distance`: (n,) of states of dry friction; 0 where it has the velocity's sign.
    - `informed`: as of `choose_friction`.
    """

    recording: Recording
    settings: Settings
    others: Sequence[Recording]
    motion: Derivatives | None
    presliding_distance: Float[np.ndarray, " joints"]
    informed: Informed | None = None

    @cached_property
    def derivatives(self) -> tuple[Derivatives, ...]:
        """Return derivatives of all recordings: they do not depend on friction."""
        derivatives = self.settings.preparation.derivatives
        first = derivatives(self.recording) if self.motion is None else self.motion
        return (first, *map(derivatives, self.others))

    def patterns(self, settings: Settings) -> list[Patterns]:
        """Return the patterns of all recordings by settings that suit a network."""
        recordings = (self.recording, *self.others)
        return [
            settings.preparation.patterns(recording, derivatives)
            for recording, derivatives in zip(recordings, self.derivatives, strict=True)
        ]

    def held_out(self, network: CSLC) -> _HeldOut:
        """Judge a network's friction.

        Fits are of the pairs that masks keep; judged are all that move. Judged over the former
        alone, a KUKA KR300's joint 5 got a quadratic term, 33 % better there, with which two other
        motions are predicted 7 % worse.

        Slopes of static friction, and the rigid torque that friction of the load follows to first
        order, are those of all stretches: a few numbers of thousands of rows.
        """
        suited = self.settings.for_network(network)
        listed, solver = self.patterns(suited), suited.solver
        qd = [np.asarray(patterns.qd) for patterns in listed]
        # From the speed on that static friction is fitted from.
        slowest = static_fractions(DEFAULT_THRESHOLD_FRACTION, [True] * qd[0].shape[1])
        moving = [friction_mask(some, friction_thresholds(some, slowest)) for some in qd]
        if network.load_terms:
            load = fit_load(network, listed[0], solver=solver)
            pairs = [linearised(load.network, load.fit.k, patterns) for patterns in listed]
            networks, listed = [network for network, _ in pairs], [some for _, some in pairs]
        else:
            if "static" in network.robot.friction_terms:
                network = fit_slopes(network, listed[0], solver=solver).network
            networks = [network] * len(listed)
        if self.presliding_distance.any():
            networks = [
                along_motion(some, patterns, self.presliding_distance)
                for some, patterns in zip(networks, listed, strict=True)
            ]
        first = listed[0]
        stretches = fold_numbers(first.samples)
        halves = unlike_halves(first, moving[0])
        known: Callable[[Any], Any] | None = None
        if self.informed is not None:
            known = self.informed(networks[0], solver.fit(networks[0], first))
        if known is None:
            columns = columns_of(networks[0], first)
            unknowns = unknowns_of(networks[0], first, columns)
            stretches_errors, *halves_errors = (
                solver.held_out_errors(networks[0], first, fold, columns, unknowns)
                for fold in (stretches, *halves)
            )
        else:
            stretches_errors, *halves_errors = (
                informed_errors(networks[0], first, solver, fold, known)
                for fold in (stretches, *halves)
            )
        parts = [
            _Part(stretches_errors, moving[0], stretches),
            _joined(halves_errors, [moving[0]] * 2, halves),
        ]
        if len(listed) > 1:
            if known is None:
                k = solver.coefficients(solver.equations(networks[0], first))
            else:
                k = known(solver.fit(networks[0], first)).k
            errors = [
                np.asarray(patterns.torque) - torque_of(some, patterns, k)
                for some, patterns in zip(networks[1:], listed[1:], strict=True)
            ]
            parts.append(_joined(errors, moving[1:], [fold_numbers(len(some)) for some in errors]))
        return _HeldOut(tuple(parts), networks[0].friction_per_joint)

    def unclear_offsets(self, network: CSLC) -> tuple[int, ...]:
        """Joints, from 1, whose offset the motion does not tell from gravity.

        Of a joint without dry friction, there is nothing that its offset would be small beside.
        """
        if network.load_terms:
            network = network.without_load()
        if "static" in network.robot.friction_terms:
            network = network.without_law("static", range(1, network.joint_count + 1))
        suited = self.settings.for_network(network)
        fit = suited.fit(network, self.patterns(suited)[0])
        k, error = np.abs(np.asarray(fit.k)), np.asarray(fit.standard_error)
        offset, dry = (_indices(network, kind) for kind in ("offset", "dry"))
        return tuple(
            joint
            for joint in offset.keys() & dry.keys()
            if not error[offset[joint]]
            <= max(_OFFSET_ERROR * k[dry[joint]], k[offset[joint]] / _OFFSET_SIGNIFICANT)
        )


def _joined(
    errors: Sequence[np.ndarray], masks: Sequence[np.ndarray], folds: Sequence[np.ndarray]
) -> _Part:
    """Several parts as one, numbers of folds behind each other."""
    starts = np.cumsum([0, *(int(fold.max()) + 1 for fold in folds[:-1])])
    fold = np.concatenate([some + start for some, start in zip(folds, starts, strict=True)])
    order = np.argsort(fold, kind="stable")
    return _Part(np.concatenate(errors)[order], np.concatenate(masks)[order], fold[order])


def _indices(network: CSLC, kind: str) -> dict[int, int]:
    """Return, by joint from 1, the index of its coefficient of a kind of friction."""
    if kind not in network.robot.friction_terms:
        return {}
    joints = (j for j, kinds in enumerate(network.friction_per_joint, start=1) if kind in kinds)
    return dict(zip(joints, network.layout.indices(kind).tolist(), strict=True))


def _best(trials: Sequence[FrictionTrial], chance: float) -> dict[int, FrictionTrial]:
    """Return each joint's trial with the smallest error, of those that are better beyond chance."""

    def cost(trial: FrictionTrial) -> float:
        return trial.relative.change + _GAIN_OF_SECOND * (len(_kinds(trial.kind)) - 1)

    best: dict[int, FrictionTrial] = {}
    for trial in sorted(trials, key=cost, reverse=True):
        if _gains(trial, chance):
            best[trial.joint] = trial
    return best


def _gains(trial: FrictionTrial, chance: float) -> bool:
    worse = trial.elsewhere is not None and trial.elsewhere.change > 0.0
    return trial.possible and not worse and trial.relative.beyond_chance(chance)
