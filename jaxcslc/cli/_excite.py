"""The command `jaxcslc excite`: the motion to record next, what it is for, and what is known."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from ..excitation import (
    Effort,
    Goal,
    Knowledge,
    Limits,
    Noise,
    coefficient_sizes,
    design_files,
    design_motion,
    load_limits,
    save_design,
    wanted_indices,
)
from ..identification import identify
from ..least_squares import Identification, Settings
from ..manipulator import Manipulator
from ..network import CSLC
from ..recordings import Sampling
from ..report import load_report
from ._common import Context, Output, OverwriteOption, command, names_in
from ._inputs import (
    ColumnsOption,
    Drives,
    LengthsOption,
    LimitsOption,
    RobotArgument,
    RobotPart,
    numbers,
    recording_of,
    recordings_of,
)
from ._options import UsageError, option


# As `CRITERIA` and `FAMILIES` of the library, which a test compares.
Criterion = Literal[
    "overall", "error", "worst", "torque", "bodies", "A", "D", "E", "condition", "scaled_condition"
]
Family = Literal["splines", "fourier", "periodic", "moves"]


@dataclasses.dataclass(frozen=True)
class MotionOptions:
    """The motion, the coefficients that it is for, and noise of its recording."""

    output: Annotated[
        Path,
        option(
            "-o",
            "--output",
            help="CSV file of the motion; .yaml, .json, .h and .html go next to it.",
        ),
    ] = Path("motion.csv")
    overwrite: OverwriteOption = False
    duration: Annotated[
        float, option(metavar="SECONDS", above=0.0, help="Length of the motion.")
    ] = 10.0
    limits: LimitsOption = None
    previous: Annotated[
        Path | None,
        option("--previous", "--prior", help="Result of identify: what is known already."),
    ] = None
    recorded: Annotated[
        list[Path] | None,
        option(
            "--recorded",
            "--after",
            group="goal",
            help="Earlier recordings, which are identified first, instead of --previous. May be"
            " repeated.",
        ),
    ] = None
    parameters: Annotated[
        str | None,
        option(
            "--parameters",
            "--for",
            group="goal",
            metavar="NAMES",
            help="Coefficients that matter, by group or name as in viscous,kd5. By default all.",
        ),
    ] = None
    payload: Annotated[
        float | None,
        option(
            group="goal",
            metavar="KG",
            least=0,
            help="Design for identifying a payload of about this mass at the last link. Parameters"
            " of the arm from --previous count as known.",
        ),
    ] = None
    target: Annotated[
        float | None,
        option(
            "--target",
            "--reach",
            group="goal",
            metavar="PERCENT",
            above=0.0,
            help="Target standard error, of the value or, if that is larger, of what makes 1 % of a"
            " joint's torque. Does nothing if it is already met.",
        ),
    ] = None
    criterion: Annotated[
        Criterion,
        option(
            group="goal",
            metavar="CRITERION",
            help="What is minimised: error or worst, the mean or largest relative standard error;"
            " torque, the error of torques on --task; overall, the mean of error and torque;"
            " bodies, A, D, E, condition or scaled_condition (docs/excitation.md).",
        ),
    ] = "overall"
    task: Annotated[
        Path | None,
        option(
            group="goal",
            help="Recording of the motion on which torques matter. By default random motions"
            " within the limits.",
        ),
    ] = None
    estimator: Annotated[
        Literal["maximum-likelihood", "least-squares"],
        option(
            group="goal",
            renamed=(("likelihood", "maximum-likelihood"), ("regression", "least-squares")),
            help="The estimator that the recording is for.",
        ),
    ] = "maximum-likelihood"
    rate: Annotated[
        float | None,
        option(
            group="motion",
            metavar="HZ",
            above=0.0,
            help="Samples per second of motion and recording. By default that of --previous, or"
            " 500.",
        ),
    ] = None
    family: Annotated[
        Family,
        option(
            group="motion",
            help="B-splines, a Fourier series, one that ends where it starts, or minimum-jerk"
            " moves.",
        ),
    ] = "splines"
    start: Annotated[
        str | None,
        option(
            group="motion",
            metavar="NUMBERS",
            help="Pose to start from, one number per joint [rad or m]. By default searched for.",
        ),
    ] = None
    seed: Annotated[
        int, option(group="motion", help="Seed of random motions; the same gives the same motion.")
    ] = 0
    starts: Annotated[
        int,
        option(
            group="motion",
            least=1,
            help="Number of random motions that the search starts from; the best is taken.",
        ),
    ] = 3
    floor: Annotated[
        bool,
        option(
            group="motion",
            help="Do not keep above the floor: the plane through the base's foot, or that of"
            " --limits.",
        ),
    ] = True
    torque_noise: Annotated[
        str | None,
        option(
            group="noise",
            metavar="NUMBERS",
            help="Standard deviation of torques, one number or one per joint [N m]. By default that"
            " of --previous, or 1 % of the torque limits.",
        ),
    ] = None
    torque_offset: Annotated[
        str | None,
        option(
            group="noise",
            metavar="NUMBERS",
            help="Standard deviation of constant torque errors, one number or one per joint [N m]."
            " By default that of the noise; 0 after --previous and for joints with friction offset"
            " or asymmetric_dry.",
        ),
    ] = None
    encoder: Annotated[
        str | None,
        option(
            group="noise",
            metavar="NUMBERS",
            help="Encoder tick, one number or one per joint [rad]. By default that of --previous,"
            " or 1e-4.",
        ),
    ] = None

    def __post_init__(self) -> None:
        noise: dict[str, Any] = {"torque": 1.0, **self.stated_noise()}
        Noise(**noise)  # raises what is wrong with it
        self.start_pose()
        if self.previous is not None and self.recorded:
            raise UsageError("--previous and --recorded: expected one of them")

    def stated_noise(self) -> dict[str, Any]:
        """Return noise that the command line states, by the names of `Noise`."""
        texts = {
            "torque": ("--torque-noise", self.torque_noise),
            "offset": ("--torque-offset", self.torque_offset),
            "resolution": ("--encoder", self.encoder),
        }
        given = {
            name: numbers(shown, text, _NUMBERS)
            for name, (shown, text) in texts.items()
            if text is not None
        }
        return {**given, "estimator": _ESTIMATORS[self.estimator]}

    def start_pose(self) -> np.ndarray | None:
        """Return the pose that the motion starts from, if it is stated."""
        return None if not self.start else np.array(numbers("--start", self.start, _NUMBERS))


_NUMBERS = "numbers as in 0.1,0.2"
_ESTIMATORS = {"maximum-likelihood": "likelihood", "least-squares": "regression"}
_RATE = 500.0  # of a first recording [Hz]
_STATES = 200  # that show what a coefficient is for the torque
# Kinds of friction with a coefficient for a torque that is the same whatever the motion.
_CONSTANTS = {"offset", "asymmetric_dry"}
# Before a first recording: noise of torques over their limits, and the step of encoders [rad].
_TORQUE_NOISE, _ENCODER = 0.01, 1e-4


@command(
    "excitation",
    "excite arm.urdf --limits limits.toml --duration 20 -o motion.csv",
    "excite arm.urdf --previous results -o next.csv",
)
def excite_command(
    context: Context,
    robot: RobotArgument,
    options: MotionOptions,
    part: RobotPart,
    drives: Drives,
    lengths: LengthsOption = "auto",
    columns: ColumnsOption = None,
) -> Output:
    """Design the motion to record next, within all limits, for the smallest errors."""
    with context.progress("reading") as step:
        folder = options.output.parent
        if not folder.is_dir():
            raise ValueError(f"--output: no such folder: {folder}; expected one that exists")
        context.check_output(design_files(options.output))
        arm = part.read(robot)
        before = _before(arm, options, columns, lambda: drives.network(arm, lengths), step)
        names = None if options.parameters is None else names_in(options.parameters)
        if options.payload is not None:
            before, names = before.carrying(options.payload), names or ["payload"]
        bounds = _bounds(arm, options)
        rate = before.rate(_RATE) if options.rate is None else options.rate
        noise = _noise(before, bounds, options.stated_noise() | {"rate": rate})
        if reached := _reached(before, names, options.target, bounds, noise):
            return Output(reached)
        task = None if options.task is None else recording_of(options.task, arm, columns)
        design = design_motion(
            before.network,
            bounds,
            noise,
            goal=Goal(options.criterion, names, task),
            knowledge=before.knowledge,
            duration=options.duration,
            family=options.family,
            start=options.start_pose(),
            effort=Effort(options.starts, seed=options.seed),
            progress=step,
        )
        paths = save_design(design, options.output, command=context.text())
    lines = [str(design)]
    if before.fit is not None:
        lines += ["", f"{design.family.duration:g} s more are predicted to bring"]
        lines += [f"  {gain}" for gain in design.prediction.gains()]
    if (target := options.target) is not None:
        seconds = design.seconds_for(target / 100)
        lines.append(f"{target:g} % (--target) takes about {seconds:.3g} s of such motion")
    data: Callable[[], Any] = lambda: {
        "criterion": design.criterion,
        "value": design.value,
        "relative_errors": design.relative_errors(),
        "undetermined": design.undetermined,
        "collisions": design.collisions,
        "notes": design.notes,
    }
    return Output("\n".join(lines), data, paths)


def _bounds(arm: Manipulator, options: MotionOptions) -> Limits:
    stated = options.limits
    bounds = load_limits(stated, arm) if stated else Limits.of(arm, surroundings="usual")
    return bounds if options.floor else bounds.without_floor()


@dataclasses.dataclass(frozen=True)
class _Before:
    """Knowledge from earlier recordings."""

    network: CSLC
    knowledge: Knowledge
    fit: Identification | None = None
    settings: Settings | None = None
    sampling: Sampling | None = None

    def rate(self, default: float) -> float:
        """Return the sampling rate [Hz]."""
        return default if self.sampling is None else 1.0 / self.sampling.interval

    def carrying(self, mass: float) -> "_Before":
        """Return the knowledge of the arm with a payload of about that mass [kg]."""
        network = self.network.with_payload()
        knowledge = self.knowledge.with_payload(network, mass)
        return dataclasses.replace(self, network=network, knowledge=knowledge)


def _before(
    arm: Manipulator,
    options: MotionOptions,
    columns: Path | None,
    derived: Callable[[], CSLC],
    step: Callable[[str], None],
) -> _Before:
    if options.previous is not None:
        report = load_report(options.previous, arm)
        network = report.network
        sampling = None if report.settings is None else report.settings.chosen_on
    elif options.recorded:
        network = derived()
        recordings = recordings_of(
            options.recorded, lambda path: recording_of(path, network.robot, columns)
        )
        report = identify(network, recordings, possible="never", progress=step)
        sampling = Sampling.of(next(iter(recordings.values())))
    else:
        network = derived()
        return _Before(network, Knowledge.of_robot(network))
    knowledge = Knowledge.of_fit(network, report.fit)
    return _Before(network, knowledge, report.fit, report.settings, sampling)


def _noise(before: _Before, limits: Limits, stated: dict[str, Any]) -> Noise:
    """Return noise as stated, or as earlier recordings had it, or a guess."""
    if before.fit is not None:
        cutoff = None if before.settings is None else before.settings.solver.cutoff
        return Noise.of_fit(before.fit, before.sampling, cutoff=cutoff, **stated)
    if "torque" not in stated:
        if not np.isfinite(limits.torque).all():
            raise ValueError("--torque-noise: expected it, as not all joints have a torque limit")
        stated["torque"] = tuple((_TORQUE_NOISE * limits.torque).tolist())
    # Between directions a torque differs, never by nothing, and by how much is unknown before a
    # first recording. Where the model has a coefficient for it, it is no error: no motion tells it
    # from the coefficient, and a criterion that counts both sees less of the others.
    torque, kinds = stated["torque"], before.network.friction_per_joint
    torque = torque if len(torque) > 1 else torque * len(kinds)
    pairs = zip(kinds, torque, strict=False)
    offset = tuple(0.0 if _CONSTANTS & set(terms) else value for terms, value in pairs)
    defaults: dict[str, Any] = {"resolution": _ENCODER, "offset": offset}
    return Noise(**(defaults | stated))


def _reached(
    before: _Before, names: list[str] | None, target: float | None, limits: Limits, noise: Noise
) -> str | None:
    """Return the message that nothing need be recorded, if so."""
    if target is None:
        return None
    network, n = before.network, before.network.joint_count
    # Any states within the limits show what a coefficient is for the torque.
    states = np.random.default_rng(0).uniform(-1.0, 1.0, (3, _STATES, n))
    low, high = np.clip([limits.low, limits.high], -np.pi, np.pi)
    speed = np.where(np.isfinite(limits.velocity), limits.velocity, 1.0)
    states *= np.stack([0.5 * (high - low), speed, speed**2])[:, None]
    states[0] += 0.5 * (low + high)
    torque = np.where(np.isfinite(limits.torque), limits.torque, 100 * noise.torque_deviation(n))
    motion = (states[0], states[1], states[2])
    size = coefficient_sizes(network, before.knowledge.k, motion, torque)
    indices = wanted_indices(network, names)
    relative = 100 * before.knowledge.standard_error[indices] / size[indices]
    if np.all(relative <= target):
        return f"nothing to record: --target is met, {np.max(relative):.3g} % or less"
    return None
