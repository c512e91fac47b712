"""Fit of servo drives to recorded commands and positions, with intervals.

     recordings --> loads of each joint --> regression --> search with coarse steps --+
                         ^                                                            |
                         +-- zero positions of the joints ----------------------------+
                                                                                      |
     ServoFit <-- intervals, confounded parameters <-- search with fine steps <-------+

The search minimises the squares of simulated minus measured positions, joint by joint, each under
the loads that the measured motion of the others gives it. `_search` holds the problem of a joint.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple, dataclass
from typing import Literal

import numpy as np
import scipy
from jaxtyping import Bool, Float

from .._display import Progress, html_rows, steps as progress_steps
from .._text_table import counted
from ..manipulator import LinkParameters, Manipulator
from ..recordings import encoder_resolution
from ._base import base_motion
from ._current import CurrentGain, current_gains
from ._drive import ServoDrive
from ._identifiability import ALONE, ConfoundedParameters, confounded
from ._intervals import ServoParameter, Stack, information_per_sample
from ._recording import ServoRecording
from ._search import (
    MOVING,
    NAMES,
    STALLED,
    UNKNOWNS,
    JointMotion,
    JointProblem,
)
from ._sensitivity import Coupling, accelerations, lengths_of_steps, sensitivities
from ._simulation import LONGEST_STEP, joint_loads, simulate, with_payload
from ._start import CORRELATION, Regression, starting_point
from ._table import Table


ESTIMATED = (
    "gain",
    "damping",
    "delay",
    "offset",
    "armature",
    "coulomb",
    "static",
    "stribeck",
    "load_friction",
)
"""Parameters that `identify_servo` estimates unless it is told otherwise."""

MASS_ERROR = 0.2
"""Relative standard error of a file's masses: printed parts and cables differ so much from CAD."""

# Servos of one arm differ by this part of their gain: joints of one size have the same servos,
# others may not. A gain with a larger error, whose 95 % interval spans a factor of four, says less
# than those of the other joints.
_LIKE_GAINS = 0.35
# Steps of the first search, and of derivatives.
_COARSE_STEP, _DERIVATIVE_STEP = 4.0 * LONGEST_STEP, 2.0 * LONGEST_STEP
# Iterations: of the first and second search for each joint alone, and of that for all together.
_COARSE, _AGAIN, _TOGETHER = 20, 6, 25
_DAMPINGS = (1e-3, 1e-1, 1.0)  # of Levenberg and Marquardt, tried one after the other
_LITTLE = 1e-2  # part of the cost: `STALLED` iterations that gain less end the search
_START_NOISE = 0.005  # rad, of residuals, before the first search
_SMOOTHING = 0.12  # s, window of the cubic polynomials that give accelerations of other joints
_LEANING_TICKS, _LEANING_TIME, _LEANING_EXCESS = 2.5, 0.5, 1.3


@dataclass(frozen=True, eq=False)
class ServoFit:
    """Drives of an arm of position servos, with errors and what cannot be told apart.

    **Attributes**

    - `robot`: the arm, with the masses that the fit used.
    - `drives`: one per joint.
    - `parameters`: the estimated parameters of all joints, in the order of `covariance`.
    - `covariance`: of `parameters`.
    - `units`: `"torque"` if the unit of torque is determined, `"gain"` if only ratios to the gain
      are. In the latter case torques are those of the file's masses.
    - `confounded`: parameters that the recordings cannot tell apart.
    - `notes`: sentences about what was decided, as ends of travel that were found.
    - `currents`: gains of currents over torque, where recordings have currents and determine
      torques.
    - `table`: on which the hand may lean, or None.
    """

    robot: Manipulator
    drives: tuple[ServoDrive, ...]
    parameters: tuple[ServoParameter, ...]
    covariance: Float[np.ndarray, "parameters parameters"]
    units: Literal["torque", "gain"]
    confounded: tuple[ConfoundedParameters, ...] = ()
    notes: tuple[str, ...] = ()
    currents: tuple[CurrentGain, ...] = ()
    table: Table | None = None

    def __repr__(self) -> str:
        determined = sum(parameter.is_determined for parameter in self.parameters)
        torques = "determined" if self.units == "torque" else "those of the file's masses"
        return (
            f"ServoFit({self.robot.name}: {counted(len(self.drives), 'servo')}, {determined} of"
            f" {counted(len(self.parameters), 'parameter')} determined; torques {torques})"
        )

    def _repr_html_(self) -> str:
        """Return a table of the estimated parameters with 95 % intervals, for notebooks."""
        rows = [
            {
                "joint": self.robot.joint_names[x.joint],
                "parameter": x.name,
                "value": x.value,
                "unit": x.unit,
                "from": x.low,
                "to (95 %)": x.high,
                "determined": "yes" if x.is_determined else "no",
            }
            for x in self.parameters
        ]
        return html_rows(repr(self), rows)

    def parameter(self, joint: int, name: str) -> ServoParameter:
        """Return one estimate.

        **Raises** `KeyError` for a parameter that was not estimated.
        """
        for parameter in self.parameters:
            if (parameter.joint, parameter.name) == (joint, name):
                return parameter
        raise KeyError(f"joint {joint + 1}: {name} was not estimated")

    def simulate(
        self, recording: ServoRecording, payload: LinkParameters | None = None
    ) -> Float[np.ndarray, "samples joints"]:
        """Return positions simulated open loop from the recording's commands and its first sample.

        **Raises** as `simulate` does.
        """
        return simulate(
            with_payload(self.robot, payload),
            self.drives,
            recording.time,
            recording.command,
            recording.position[0],
            _start_velocity(recording),
            table=self.table,
        )

    def position_error(
        self,
        recordings: Sequence[ServoRecording],
        payloads: Sequence[LinkParameters | None] | None = None,
    ) -> Float[np.ndarray, "recordings joints"]:
        """Return root mean squares of simulated minus measured positions [mrad].

        Each recording is simulated open loop, as by `simulate`.
        """
        carried = payloads or [None] * len(recordings)
        return np.array(
            [
                1e3 * np.sqrt(np.mean((self.simulate(x, load) - x.position) ** 2, axis=0))
                for x, load in zip(recordings, carried, strict=True)
            ]
        )


def identify_servo(
    robot: Manipulator,
    recordings: ServoRecording | Sequence[ServoRecording],
    *,
    payloads: Sequence[LinkParameters | None] | None = None,
    known: Mapping[str, float | Sequence[float]] | None = None,
    estimated: Sequence[str] | None = None,
    mass_error: float = MASS_ERROR,
    table: Table | None = None,
    progress: Progress = None,
) -> ServoFit:
    """Identify the drives of an arm of position servos from commands and positions alone.

    The estimate is that of maximum likelihood of output errors: the drives whose simulation, open
    loop from the commands, is nearest to the measured positions. Its errors count what the model
    leaves unexplained as correlated noise (jackknife over blocks of seconds).

    **Arguments**

    - `robot`: the arm, with the masses of its links.
    - `recordings`: one or more, of the robot's joints in its order.
    - `payloads`: the body that each recording's arm carried, in the frame of the last link, or
      None for nothing. A known payload determines the unit of torque.
    - `known`: drive parameters that are known, by name: one value, or one per joint.
    - `estimated`: names of the parameters to estimate; by default `ESTIMATED`, and `viscous`
      friction if `damping` is known.
    - `mass_error`: relative standard error of the robot's masses. Without a payload, the errors of
      all torques have it. 0 takes the masses as exact; infinity leaves ratios to the gain alone.
    - `table`: on which the hand may lean. Without one, the hand is simulated to go through it.
    - `progress`: a function for messages, or whether to show them.

    **Returns** the drives with their intervals.

    **Raises**

    - `RobotError`: a robot without masses, or a table that does not fit it.
    - `ValueError`: recordings of other joints, or names that are no parameters.
    - `OSError`: no C compiler.

    >>> import dataclasses
    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.manipulator import LinkParameters
    >>> from jaxcslc.servo import ServoDrive, ServoRecording, identify_servo, simulate
    >>> rod = LinkParameters(0.5, np.array([0.2, 0.0, 0.0]), 0.002 * np.eye(3))
    >>> arm = dataclasses.replace(jc.examples.pendulum(), links=(rod,))
    >>> drive = ServoDrive(12.0, 0.8, delay=0.02, armature=0.02, coulomb=0.1)
    >>> time = np.arange(0.0, 40.0, 0.02)
    >>> command = (np.sin(time) + 0.4 * np.sin(2.7 * time) + 0.1 * np.sin(13.0 * time))[:, None]
    >>> position = simulate(arm, [drive], time, command, [0.0])
    >>> recording = ServoRecording(time, np.round(position, 3), command)
    >>> names = ("gain", "damping", "delay", "armature", "coulomb")
    >>> fit = identify_servo(arm, recording, estimated=names, mass_error=0.0)
    >>> round(fit.drives[0].gain, 1), round(fit.drives[0].delay, 3)
    (12.0, 0.02)
    """
    given = [recordings] if isinstance(recordings, ServoRecording) else list(recordings)
    carried: list[LinkParameters | None] = list(payloads or [None] * len(given))
    if estimated is None:
        estimated = (*ESTIMATED, "viscous") if "damping" in (known or {}) else ESTIMATED
    _check(robot, given, carried, estimated, mass_error)
    base = known_rows(robot, given, known or {})
    names = tuple(name for name in estimated if name not in (known or {}))
    with progress_steps(progress, "identify servos") as step:
        search = _Search(robot, given, carried, base, names, tuple(known or ()), table)
        ratios_only = math.isinf(mass_error) and not search.is_absolute
        scale_error = 0.0 if ratios_only else mass_error
        step("searching for each joint alone")
        search.alone(scale_error)
        step("searching for all joints together")
        search.together(scale_error)
        step("computing intervals")
        return search.result(scale_error, ratios_only)


def _check(
    robot: Manipulator,
    recordings: Sequence[ServoRecording],
    payloads: Sequence[LinkParameters | None],
    estimated: Sequence[str],
    mass_error: float,
) -> None:
    if not recordings:
        raise ValueError("no recordings; expected at least one")
    if len(payloads) != len(recordings):
        raise ValueError(f"{len(payloads)} payloads; expected {len(recordings)}, as recordings")
    for number, recording in enumerate(recordings, start=1):
        if recording.joints != robot.joint_count:
            raise ValueError(
                f"recording {number} has {recording.joints} joints; expected"
                f" {robot.joint_count}, as robot {robot.name!r}"
            )
    for name in estimated:
        if name not in UNKNOWNS:
            raise ValueError(f"{name!r} cannot be estimated; expected of {' '.join(UNKNOWNS)}")
    if not mass_error >= 0.0:
        raise ValueError(f"mass_error: expected at least 0, got {mass_error}")


def known_rows(
    robot: Manipulator,
    recordings: Sequence[ServoRecording],
    known: Mapping[str, float | Sequence[float]],
) -> Float[np.ndarray, "joints parameters"]:
    joints = robot.joint_count
    rows = np.tile(np.array(astuple(ServoDrive(math.exp(UNKNOWNS["gain"].start)))), (joints, 1))
    ticks = np.array([encoder_resolution(x.position) for x in recordings])
    rows[:, NAMES.index("encoder_step")] = ticks.min(axis=0) if len(ticks) else 0.0
    for name, value in known.items():
        if name not in NAMES:
            raise ValueError(f"known: {name!r} is no parameter; expected of {' '.join(NAMES)}")
        values = np.asarray(value, float)
        if values.shape not in ((), (joints,)):
            raise ValueError(f"known: {name} has {values.size} values; expected 1 or {joints}")
        rows[:, NAMES.index(name)] = values
    return rows


def smoothed(
    recording: ServoRecording,
) -> tuple[Float[np.ndarray, "samples joints"], ...]:
    """Return position, velocity and acceleration by local cubic polynomials."""
    interval = float(np.median(np.diff(recording.time)))
    window = max(5, 2 * round(0.5 * _SMOOTHING / interval) + 1)
    window = min(window, recording.samples - 1 + recording.samples % 2)
    return tuple(
        scipy.signal.savgol_filter(recording.position, window, 3, deriv=n, delta=interval, axis=0)
        if n
        else scipy.signal.savgol_filter(recording.position, window, 3, axis=0)
        for n in range(3)
    )


def _start_velocity(recording: ServoRecording) -> Float[np.ndarray, " joints"]:
    """Return the velocity at the first sample; 0 where the joint moves less than two ticks."""
    interval = float(np.median(np.diff(recording.time)))
    first = recording.position[: max(5, round(0.5 * _SMOOTHING / interval))]
    time = recording.time[: len(first)]
    slopes = np.polynomial.polynomial.polyfit(time - time[0], first, 2)[1]
    ticks = 2.0 * encoder_resolution(recording.position)
    return np.where(np.ptp(first, axis=0) > ticks, slopes, 0.0)


@dataclass
class _Search:
    """State of the search for all joints' drives."""

    robot: Manipulator
    recordings: list[ServoRecording]
    payloads: Sequence[LinkParameters | None]
    base: Float[np.ndarray, "joints parameters"]
    names: tuple[str, ...]
    given: tuple[str, ...] = ()
    table: Table | None = None

    def __post_init__(self) -> None:
        self.smooth = [smoothed(x) for x in self.recordings]
        self.velocities = [_start_velocity(x) for x in self.recordings]
        self.offsets = self.base[:, NAMES.index("offset")].copy()
        self.masses = 1.0
        self.notes: list[str] = []
        self.vague_gain = [False] * self.robot.joint_count
        self.unknowns: list[np.ndarray] = []
        self.problems: list[JointProblem] = []
        self.lengths: list[np.ndarray] = []
        self.misfits: list[np.ndarray] = []

    @property
    def has_payload(self) -> bool:
        return any(payload is not None for payload in self.payloads)

    def motions(self, offsets: Float[np.ndarray, " joints"]) -> list[tuple[JointMotion, ...]]:
        """Return each joint's motions, under the loads that zero positions give."""
        per_joint: list[list[JointMotion]] = [[] for _ in range(self.robot.joint_count)]
        for recording, (q, v, a), payload, velocity in zip(
            self.recordings, self.smooth, self.payloads, self.velocities, strict=True
        ):
            angles = q - offsets
            arm = joint_loads(self.robot, angles, v, a)
            loaded = None
            if payload is not None:
                loaded = joint_loads(with_payload(self.robot, payload), angles, v, a)
            for i, motions in enumerate(per_joint):
                motions.append(
                    JointMotion(
                        recording.time,
                        np.ascontiguousarray(recording.command[:, i]),
                        np.ascontiguousarray(recording.position[:, i]),
                        np.array([recording.position[0, i], velocity[i]]),
                        arm[i],
                        None if loaded is None else loaded[i].less(arm[i]),
                    )
                )
        return [tuple(motions) for motions in per_joint]

    def alone(self, mass_error: float) -> None:
        """Search joint by joint from the regression, with coarse steps.

        Zero positions and the masses' scale are those of the regression: what a joint alone says
        about them depends on the errors of the others.
        """
        gains = self.base[:, NAMES.index("gain")]
        unknown = np.full(len(gains), np.nan)
        known = unknown if "gain" in self.names else gains
        free = np.append(np.full(len(gains), "offset" in self.names), self.is_absolute)
        regression = Regression.of(self.robot, self.recordings, self.payloads, self.smooth, known)
        start = regression.start(self.offsets, free & self._scalable(mass_error), mass_error)
        self.offsets, self.masses = start.offsets, start.masses
        self.base[:, NAMES.index("offset")] = start.offsets
        names = tuple(name for name in self.names if name != "offset")
        weight = 1.0 / (_START_NOISE**2 * CORRELATION)
        self.problems = [
            JointProblem(names, self.base[i].copy(), motions, weight, _COARSE_STEP)
            for i, motions in enumerate(self.motions(self.offsets))
        ]
        self.unknowns = self._minima([starting_point(names, x) for x in start.found], _COARSE)
        self._settle_gains()
        self._find_ends()
        self._take_motions(self._simulated(self.unknowns, self.masses))
        self.unknowns = self._minima(self.unknowns, _AGAIN)
        rows = [p.rows(x[None])[0] for p, x in zip(self.problems, self.unknowns, strict=True)]
        self.problems = [dataclasses.replace(x, names=self.names) for x in self.problems]
        pairs = zip(self.problems, rows, strict=True)
        self.unknowns = [problem.unknowns_of(row) for problem, row in pairs]
        self.lengths = [problem.steps for problem in self.problems]

    def _scalable(self, mass_error: float) -> Bool[np.ndarray, " unknowns"]:
        """Return which of the zero positions and the scale of the masses may be sought."""
        return np.append(np.full(self.robot.joint_count, True), mass_error > 0.0)

    def _with_offsets(self, offsets: Float[np.ndarray, " joints"]) -> list[JointProblem]:
        return [
            dataclasses.replace(problem, motions=motions)
            for problem, motions in zip(self.problems, self.motions(offsets), strict=True)
        ]

    def _offsets(self, unknowns: Sequence[np.ndarray]) -> Float[np.ndarray, " joints"]:
        at = NAMES.index("offset")
        pairs = zip(self.problems, unknowns, strict=True)
        return np.array([problem.rows(x[None])[0, at] for problem, x in pairs])

    def _minima(self, starts: Sequence[np.ndarray], iterations: int) -> list[np.ndarray]:
        def minimum(i: int) -> np.ndarray:
            return self.problems[i].minimum(starts[i], iterations, self.masses)

        # C code runs without Python's lock.
        with ThreadPoolExecutor() as pool:
            return list(pool.map(minimum, range(len(starts))))

    def _simulated(
        self, unknowns: Sequence[np.ndarray], masses: float
    ) -> list[Float[np.ndarray, "samples joints"]]:
        """Return positions of the whole arm in each recording."""
        drives = [
            ServoDrive(*map(float, problem.rows(x[None])[0]))
            for problem, x in zip(self.problems, unknowns, strict=True)
        ]
        robot = scaled(self.robot, masses)

        def positions(k: int) -> Float[np.ndarray, "samples joints"]:
            recording = self.recordings[k]
            return simulate(
                with_payload(robot, self.payloads[k]),
                drives,
                recording.time,
                recording.command,
                recording.position[0],
                self.velocities[k],
                table=self.table,
            )

        with ThreadPoolExecutor() as pool:
            return list(pool.map(positions, range(len(self.recordings))))

    def _misfits(self, simulated: Sequence[np.ndarray]) -> list[Float[np.ndarray, " samples"]]:
        """Return each joint's residuals, all recordings joined."""
        pairs = zip(simulated, self.recordings, strict=True)
        joined = np.concatenate([position - x.position for position, x in pairs])
        return list(np.ascontiguousarray(joined.T))

    def _take_weights(self, misfits: Sequence[np.ndarray]) -> None:
        # Correlation is taken as that of the median joint: a slow misfit that an iteration leaves
        # in one joint would otherwise lower that joint's weight, and stay.
        pairs = list(zip(misfits, self.problems, strict=True))
        variances = [max(float(np.mean(misfit**2)), 1e-12) for misfit, _ in pairs]
        sizes = [information_per_sample(*pair) for pair in pairs]
        samples = float(np.median(np.array(sizes) / np.array(variances)))
        self.problems = [
            dataclasses.replace(problem, weight=1.0 / (variance * samples))
            for problem, variance in zip(self.problems, variances, strict=True)
        ]

    def _take_motions(self, simulated: Sequence[np.ndarray]) -> None:
        """Take loads from a simulated motion, and from the zero positions found.

        Accelerations of a simulation have no noise of encoders. Those of smoothed readings were
        the largest error of fits to simulated arms.
        """
        self.offsets = self._offsets(self.unknowns)
        for k, (recording, position) in enumerate(zip(self.recordings, simulated, strict=True)):
            velocity = np.gradient(position, recording.time, axis=0)
            acceleration = accelerations(position, recording.time)
            self.smooth[k] = (self.smooth[k][0], velocity, acceleration)
        self.problems = self._with_offsets(self.offsets)

    def _settle_gains(self) -> None:
        """Expect gains that nothing determines to be like the others."""
        if "gain" not in self.names:
            return
        at = self.names.index("gain")
        gains = np.array([x[at] for x in self.unknowns])
        pairs = list(zip(self.problems, self.unknowns, strict=True))
        random = [np.linalg.inv(p.information(x, self.masses))[at, at] for p, x in pairs]
        errors = self._gain_errors(random)
        weights = np.array(errors) ** -2.0
        self.vague_gain = [error > _LIKE_GAINS for error in errors]
        sure = ~np.array(self.vague_gain)
        common = float(np.average(gains[sure], weights=weights[sure])) if sure.any() else None
        prior = UNKNOWNS["gain"].start if common is None else common, _LIKE_GAINS
        for i, vague in enumerate(self.vague_gain):
            if vague:
                self.problems[i] = dataclasses.replace(self.problems[i], gain_prior=prior)

    def _gain_errors(self, variances: Sequence[float]) -> list[float]:
        """Return relative errors of the gains, misfits included.

        A misfit may be correlated with the load: it then falsifies the gain by as much.
        """
        errors: list[float] = []
        at = NAMES.index("gain")
        for problem, x, variance in zip(self.problems, self.unknowns, variances, strict=True):
            misfit = float(np.mean(problem.residuals(x[None], self.masses) ** 2))
            load = problem.load(x, self.masses) / problem.rows(x[None])[0, at]
            errors.append(math.sqrt(variance + misfit / max(load, 1e-9) ** 2))
        return errors

    def _find_ends(self) -> None:
        """Find ends of travel on which a joint leans, and take the file's elsewhere."""
        low, high = NAMES.index("low"), NAMES.index("high")
        for i, problem in enumerate(self.problems):
            row = problem.known.copy()
            found = ServoDrive(*map(float, problem.rows(self.unknowns[i][None])[0]))
            tick = row[NAMES.index("encoder_step")]
            for index, sign in ((low, -1.0), (high, 1.0)):
                if math.isfinite(row[index]):
                    continue
                end = sign * max(float(np.max(sign * x.position)) for x in problem.motions)
                moved = [(v[:, i], a[:, i]) for _, v, a in self.smooth]
                if _leans(problem.motions, moved, found, end, sign, tick):
                    row[index] = end
                    name = self.robot.joint_names[i]
                    self.notes.append(f"{name} leans on an end of travel at {end:.3f} rad.")
            self.problems[i] = dataclasses.replace(problem, known=row)

    def together(self, mass_error: float) -> None:
        """Search for all joints' unknowns together, with simulations of the whole arm.

        The scale of the masses is one of the unknowns where something else fixes torques.
        """
        self.problems = [
            dataclasses.replace(problem, longest_step=_DERIVATIVE_STEP) for problem in self.problems
        ]
        simulated = self._simulated(self.unknowns, self.masses)
        stalled = 0
        for _ in range(_TOGETHER):
            self._take_motions(simulated)
            misfits = self._misfits(simulated)
            self._take_weights(misfits)
            before = self._cost(self.unknowns, self.masses, misfits, mass_error)
            low = np.concatenate(
                [problem.low - x for problem, x in zip(self.problems, self.unknowns, strict=True)]
            )
            stack = self.stack(misfits, mass_error)
            cost = before
            for damping in _DAMPINGS:
                unknowns, masses = self._moved(stack.step(np.append(low, -np.inf), damping))
                trial = self._simulated(unknowns, masses)
                cost = self._cost(unknowns, masses, self._misfits(trial), mass_error)
                if cost < before:
                    self.unknowns, self.masses, simulated = unknowns, masses, trial
                    break
            stalled = stalled + 1 if cost > (1.0 - _LITTLE) * before else 0
            if stalled == STALLED:
                break
        self._take_motions(simulated)
        self.misfits = self._misfits(simulated)
        self._take_weights(self.misfits)

    def stack(self, misfits: Sequence[np.ndarray], mass_error: float) -> Stack:
        """Linearise the problems of all joints."""
        scale = self.masses, mass_error, self.is_absolute
        return Stack.of(self.problems, self.unknowns, misfits, self.sensitivities(), *scale)

    def sensitivities(self) -> list[Float[np.ndarray, "samples all"]]:
        """Return derivatives of each joint's positions with respect to all unknowns."""
        robot = scaled(self.robot, self.masses)
        couplings = [
            Coupling.of(with_payload(robot, payload), q - self.offsets, v, a)
            for (q, v, a), payload in zip(self.smooth, self.payloads, strict=True)
        ]
        scale = self.masses, self.is_absolute
        found = sensitivities(self.problems, self.unknowns, couplings, *scale, self.lengths)
        self.lengths = lengths_of_steps(self.problems, found)
        return found

    def _moved(self, step: Float[np.ndarray, " unknowns"]) -> tuple[list[np.ndarray], float]:
        ends = np.cumsum([len(x) for x in self.unknowns])
        parts = np.split(step, ends)[:-1]
        unknowns = [
            np.maximum(x + np.clip(part, -problem.deviations, problem.deviations), problem.low)
            for problem, x, part in zip(self.problems, self.unknowns, parts, strict=True)
        ]
        masses = self.masses * math.exp(float(step[-1])) if self.is_absolute else self.masses
        return unknowns, masses

    def _cost(
        self,
        unknowns: Sequence[np.ndarray],
        masses: float,
        misfits: Sequence[np.ndarray],
        mass_error: float,
    ) -> float:
        costs = [
            problem.weight * float(misfit @ misfit) + float(np.sum(problem.prior(x[None]) ** 2))
            for problem, x, misfit in zip(self.problems, unknowns, misfits, strict=True)
        ]
        if self.is_absolute and mass_error > 0.0:
            costs.append((math.log(masses) / mass_error) ** 2)
        return sum(costs)

    @property
    def is_absolute(self) -> bool:
        """True if something other than the links' masses fixes the unit of torque."""
        return self.has_payload or "gain" not in self.names

    def result(self, mass_error: float, ratios_only: bool) -> ServoFit:
        """Return the fit with its intervals."""
        rows = np.concatenate(
            [problem.rows(x[None]) for problem, x in zip(self.problems, self.unknowns, strict=True)]
        )
        self._take_file_limits(rows)
        stack = self.stack(self.misfits, mass_error)
        confusions: list[ConfoundedParameters] = []
        for i, (problem, x) in enumerate(zip(self.problems, self.unknowns, strict=True)):
            for pair, covariance in confounded(i, problem, x, self.masses, self.given):
                confusions.append(pair)
                stack = stack.with_confounded(self.problems, pair, covariance)
        if "gain" in self.names:
            starts = np.cumsum([0, *[len(x) for x in self.unknowns[:-1]]])
            variances = np.diag(stack.covariance)[starts + self.names.index("gain")]
            self.vague_gain = [x > _LIKE_GAINS for x in self._gain_errors(list(variances))]
        parameters, covariance, refused = stack.parameters(
            self.problems, self.unknowns, rows, self.vague_gain, ratios_only
        )
        confusions += [
            ConfoundedParameters(joint, (name,), *ALONE[name])
            for joint, name in refused
            if name in ALONE
        ]
        drives = tuple(ServoDrive(*map(float, row)) for row in rows)
        robot = scaled(self.robot, self.masses)
        empty = [x for x, load in zip(self.recordings, self.payloads, strict=True) if load is None]
        moved = base_motion(robot, drives, empty, [smoothed(x) for x in empty]) if empty else None
        if moved is not None:
            self.notes.append(
                f"The base moves: {moved.evidence}. The model has a fixed base: {moved.remedy}."
            )
        velocities = [smoothed(x)[1] for x in self.recordings]
        currents = current_gains(drives, self.recordings, velocities)
        return ServoFit(
            robot,
            drives,
            tuple(parameters),
            covariance,
            "gain" if ratios_only or all(self.vague_gain) else "torque",
            tuple(confusions),
            tuple(self.notes),
            tuple(x for x in currents if not (ratios_only or self.vague_gain[x.joint])),
            self.table,
        )

    def _take_file_limits(self, rows: Float[np.ndarray, "joints parameters"]) -> None:
        """Set the file's ends of travel where the recordings do not contradict them."""
        low, high, offset = (NAMES.index(name) for name in ("low", "high", "offset"))
        for i, limits in enumerate(self.robot.joint_limits):
            positions = [x.position[:, i] for x in self.recordings]
            if limits.low + rows[i, offset] < min(map(np.min, positions)):
                rows[i, low] = max(rows[i, low], limits.low + rows[i, offset])
            if limits.high + rows[i, offset] > max(map(np.max, positions)):
                rows[i, high] = min(rows[i, high], limits.high + rows[i, offset])


def scaled(robot: Manipulator, factor: float) -> Manipulator:
    links = tuple(
        LinkParameters(
            factor * link.mass, link.centre_of_gravity, factor * link.inertia, link.motor_inertia
        )
        for link in robot.links or ()
    )
    return dataclasses.replace(robot, links=links)


def _leans(
    motions: Sequence[JointMotion],
    moved: Sequence[tuple[Float[np.ndarray, " samples"], Float[np.ndarray, " samples"]]],
    drive: ServoDrive,
    end: float,
    sign: float,
    tick: float,
) -> bool:
    """Return True if a joint stays at its extreme under errors that move it elsewhere.

    A joint that friction holds is not meant: it moves as soon as the error exceeds that at which
    it moved elsewhere, damping and inertia aside.
    """
    leaning, moving, interval = [0.0], [0.0], 0.0
    for motion, (v, a) in zip(motions, moved, strict=True):
        late = np.interp(motion.time - drive.delay, motion.time, motion.command)
        braking = drive.damping * v + (drive.armature + motion.arm.inertia) * a
        error = sign * (late - motion.position - braking / drive.gain)
        at_end = sign * (end - motion.position) <= _LEANING_TICKS * tick
        leaning.extend(error[at_end])
        moving.extend(error[~at_end & (sign * v > MOVING)])
        interval = float(np.median(np.diff(motion.time)))
    threshold = _LEANING_EXCESS * max(float(np.quantile(moving, 0.99)), 2.0 * tick)
    return interval * float(np.sum(np.array(leaning) > threshold)) > _LEANING_TIME
