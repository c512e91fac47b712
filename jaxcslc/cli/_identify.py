"""The command `jaxcslc identify`: its options, and identification on a cluster."""

import contextlib
import dataclasses
import functools
import glob
import json
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from .._environment import ExplainedError, require
from .._processes import processes_beside
from ..bodies import load_prior
from ..identification import (
    BODIES,
    ESTIMATORS,
    LIKELIHOOD,
    OFFSETS,
    PREVIOUS,
    SEVERAL,
    identify,
)
from ..least_squares import fit_fleet_on_cluster, fit_on_cluster
from ..likelihood import MaximumLikelihood
from ..manipulator import Manipulator
from ..network import CSLC
from ..report import Report, all_or_nothing, load_report, load_settings, replaced_files
from ..selection import choose_settings
from ._common import Context, Output, OverwriteOption, command, names_in
from ._inputs import (
    Drives,
    LengthsOption,
    OutputOption,
    PriorOption,
    RecordingOptions,
    RobotOrSystemArgument,
    RobotPart,
    SettingsOption,
    TorqueLagOption,
    TorqueOption,
    is_system,
    recordings_of,
)
from ._options import UsageError, argument, option
from ._servo import SERVO_OPTIONS, ServoOptions, identify_servos


if TYPE_CHECKING:
    from ..systems import SystemReport


@dataclasses.dataclass(frozen=True)
class IdentifyOptions:
    """Recordings to fit and to judge on, the estimator, and what is known and asked for."""

    train: Annotated[list[Path], argument("TRAIN...", "Recording to fit, or several of one robot.")]
    validate: Annotated[
        Path | None,
        option(help="Recording to judge the fit on; it is not fitted."),
    ] = None
    output: OutputOption = Path("identified")
    overwrite: OverwriteOption = False
    quality: Annotated[
        Literal["fast", "best"],
        option(
            help="fast: least squares, 9 s of processor time for 10,000 samples of 7 joints. best,"
            " 29 s: also chooses friction per joint, and maximum likelihood where it predicts"
            " held-out data better.",
        ),
    ] = "fast"
    settings: SettingsOption = None
    lengths: LengthsOption = "auto"
    torque: TorqueOption = None
    torque_lag: TorqueLagOption = None
    check: Annotated[
        bool, option(group="recordings", help="Do not check the recordings first.")
    ] = True
    offsets: Annotated[
        bool,
        option(
            group="recordings",
            help="Also fit one torque offset per joint and recording, for sensors that drift.",
        ),
    ] = False
    estimator: Annotated[
        Literal["least-squares", "maximum-likelihood", "instrumental-variables", "auto"] | None,
        option(
            group="estimator",
            metavar="ESTIMATOR",
            help="least-squares on smoothed motion; maximum-likelihood, without smoothing;"
            " instrumental-variables, which test least squares for bias; auto: the one of the"
            " first two that predicts held-out data better (docs/choose.md). By default that of"
            " --quality.",
        ),
    ] = None
    physical: Annotated[
        Literal["auto", "always", "never"],
        option(
            "--physical",
            "--possible",
            group="estimator",
            help="Physically consistent parameters: use them if they predict held-out data better"
            " (auto), always, or never.",
        ),
    ] = "auto"
    loss: Annotated[
        Literal["squared", "huber", "bisquare"] | None,
        option(
            group="estimator",
            help="Loss of the fit; huber and bisquare bound the effect of outliers. By default"
            " that of --settings, or squared.",
        ),
    ] = None
    folds: Annotated[
        int | None,
        option(
            group="estimator",
            least=2,
            help="Parts of the recording for cross-validation. By default 8, or fewer if it is"
            " short.",
        ),
    ] = None
    memory: Annotated[
        float,
        option(
            group="estimator",
            metavar="GB",
            above=0.0,
            help="Memory budget. For longer recordings, settings are chosen on a part, which the"
            " report names.",
        ),
    ] = 2.0
    ml_spacing: Annotated[
        int | None,
        option(
            "--ml-spacing",
            "--likelihood-every",
            group="estimator",
            least=1,
            metavar="N",
            help="Maximum likelihood: each equation of motion spans 2 N samples, for arms with"
            " elastic joints. By default chosen by the noise of positions.",
        ),
    ] = None
    prior: PriorOption = None
    file_prior: Annotated[
        bool,
        option(
            group="knowledge",
            help="Ignore the masses and inertias of the robot's file. By default they are a prior:"
            " they decide what the motion leaves open.",
        ),
    ] = True
    reidentify: Annotated[
        str | None,
        option(
            group="knowledge",
            metavar="GROUPS",
            help="Fit only these coefficients, by group or name as in viscous,dry. The others are"
            " those of --previous.",
        ),
    ] = None
    previous: Annotated[
        Path | None,
        option(group="knowledge", help="Result of a previous run, for --reidentify."),
    ] = None
    systematic: Annotated[
        bool,
        option(
            group="output",
            help="Omit errors of smoothing and of missing terms from the intervals.",
        ),
    ] = True
    simulate: Annotated[
        bool,
        option(
            "--simulate",
            "--horizon",
            group="output",
            help="Also simulate the identified arm, and report the position error after 0.1 to"
            " 5 s.",
        ),
    ] = False
    dask: Annotated[
        str | None,
        option(
            group="cluster",
            metavar="ADDRESS|local",
            help="Fit many recordings on a Dask cluster, or on one that is started here. Quoted"
            " patterns are expanded, as 'logs/*.parquet'.",
        ),
    ] = None
    fleet: Annotated[
        bool, option(group="cluster", help="With --dask: treat every file as a different robot.")
    ] = False

    def __post_init__(self) -> None:
        if (self.reidentify is None) != (self.previous is None):
            raise UsageError(
                "--reidentify and --previous: got one of them; expected both or neither"
            )
        if self.fleet and self.dask is None:
            raise UsageError("--fleet: only with --dask")
        name, supported = _estimator(self), ESTIMATORS[_estimator(self)].supports
        for option_name, given, feature in (
            ("--offsets", self.offsets, OFFSETS),
            ("--ml-spacing", self.ml_spacing is not None, LIKELIHOOD),
            ("--physical always", self.physical == "always", BODIES),
            ("--previous", self.previous is not None, PREVIOUS),
            ("several recordings", len(self.train) > 1 and self.dask is None, SEVERAL),
        ):
            if given and feature not in supported:
                raise UsageError(f"{option_name}: cannot be combined with --estimator {name}")


# Fits of a fleet that are printed; all are in the file.
_PRINTED = 20
# What `identify` does on a cluster besides fitting is to read, prepare and settings.
_OF_CLUSTER = {
    *(field.name for kind in (RobotPart, Drives, RecordingOptions) for field in fields(kind)),
    *("robot", "lengths", "train", "output", "overwrite", "settings", "torque", "dask", "fleet"),
    *("json", "quiet"),
}


@command(
    "report",
    "identify arm.urdf log.csv --validate other.csv -o results",
    "identify arm.urdf log.csv --quality best",
    "identify arm.urdf morning.csv noon.csv --columns columns.toml --fix gripper",
    "identify arm.urdf log.csv --drive servo",
)
def identify_command(
    context: Context,
    robot: RobotOrSystemArgument,
    options: IdentifyOptions,
    servo: ServoOptions,
    part: RobotPart,
    drives: Drives,
    recordings: RecordingOptions,
) -> Output:
    """Identify a robot's parameters from recordings of positions and torques.

    Or those of another system, from a recording with a column for each of its variables. Or the
    drives of an arm of position servos, from commands and positions (--drive servo).
    """
    if servo.drive == "servo":
        with context.progress("reading") as step:
            files = options.train, options.validate, options.output
            return identify_servos(context, robot, servo, *files, part, recordings, step)
    if others := sorted(context.typed & SERVO_OPTIONS):
        raise UsageError(f"--{others[0]}: only with --drive servo")
    if options.quality == "best" and options.previous is None and drives.friction is None:
        drives = dataclasses.replace(drives, friction="auto")
    known = _estimator(options) == "least-squares"  # the time that it takes
    with context.progress("reading", estimated=known) as step, processes_beside():
        if options.dask is not None:
            _check_cluster_options(context, robot, options)
            paths = _recordings_of(options.train)
            name = "fleet.csv" if options.fleet else "fit.json"
            context.check_output([options.output / name], folder=options.output, read=paths)
            arm = part.read(robot)
            network = drives.network(arm, options.lengths)
            return _identified_on_cluster(network, paths, name, options, recordings, step)
        context.check_output(replaced_files(options.output), folder=options.output)
        if is_system(robot):
            context.check_no_robot_options(robot)
            report = _identified_system(robot, options, step)
        else:
            report = _identified(context, part.read(robot), options, drives, recordings, step)
        step("writing")
        paths = report.save(options.output, command=context.text())

    def data() -> dict[str, Any]:
        (document,) = report.documents(charts=False).values()
        return {"verdict": report.verdict, **document}

    return Output(str(report), data, paths)


def _estimator(options: IdentifyOptions) -> str:
    return options.estimator or ("auto" if options.quality == "best" else "least-squares")


def _friction(options: IdentifyOptions, drives: Drives) -> Literal["auto", "offset"] | None:
    """Return the choice of friction: offsets, unless terms are named."""
    if drives.friction == "auto":
        return "auto"
    unnamed = drives.friction is None and options.previous is None and not options.offsets
    return "offset" if unnamed else None


def _identified(
    context: Context,
    arm: Manipulator,
    options: IdentifyOptions,
    drives: Drives,
    recordings: RecordingOptions,
    step: Callable[[str], None],
) -> Report:
    saved = None if options.previous is None else load_report(options.previous, arm)
    if saved is None:
        network = drives.network(arm, options.lengths)
    elif context.typed & {"lengths", "friction", "coupled"}:
        raise ValueError("--lengths, --friction and --coupled: not with --previous, which has them")
    else:
        network = saved.network
    settings = None if saved is None else saved.settings
    prior = None if options.prior is None else load_prior(options.prior)
    every = options.ml_spacing
    stated = {"torque_lag": options.torque_lag, "loss": options.loss}
    read = functools.partial(recordings.read, robot=network.robot, torque=options.torque)
    return identify(
        network,
        recordings_of(options.train, read),
        None if options.validate is None else read(options.validate),
        settings if options.settings is None else load_settings(options.settings),
        estimator=_estimator(options),
        likelihood=None if every is None else MaximumLikelihood(every=every),
        offsets=options.offsets,
        previous=None if saved is None else saved.fit,
        groups=None if options.reidentify is None else names_in(options.reidentify),
        friction=_friction(options, drives),
        options={name: value for name, value in stated.items() if value is not None},
        folds=options.folds,
        checks=options.check,
        systematic=options.systematic,
        possible=options.physical,
        prior=prior,
        file_prior=options.file_prior,
        memory=options.memory,
        simulate=options.simulate,
        progress=step,
    )


def _check_cluster_options(context: Context, robot: str, options: IdentifyOptions) -> None:
    """**Raises** `ValueError` for what there is not on a cluster."""
    if is_system(robot):
        raise ExplainedError(
            "--dask: expected a robot; other systems are identified in one process", "scale"
        )
    if others := sorted(context.typed - _OF_CLUSTER):
        raise ExplainedError(
            f"--{others[0].replace('_', '-')}: not with --dask, which reads each file once, for one"
            " fit by least squares",
            "scale",
        )


def _identified_system(
    name: str, options: IdentifyOptions, step: Callable[[str], None]
) -> "SystemReport":
    from ..systems import identify_system, load_system, load_system_recording

    if len(options.train) > 1:
        raise ExplainedError(
            f"{name}: a system takes one recording, got {len(options.train)}", "systems"
        )
    system = load_system(name)
    judging = options.validate
    return identify_system(
        system,
        load_system_recording(options.train[0], system),
        None if judging is None else load_system_recording(judging, system),
        None if options.settings is None else load_settings(options.settings),
        progress=step,
    )


def _recordings_of(patterns: list[Path]) -> list[Path]:
    """Return the files that patterns name."""
    paths: list[Path] = []
    for pattern in map(str, patterns):
        if not (matching := sorted(glob.glob(pattern))):
            raise ValueError(f"{pattern}: no such file; expected recordings")
        paths += map(Path, matching)
    return paths


def _identified_on_cluster(
    network: CSLC,
    paths: list[Path],
    name: str,
    options: IdentifyOptions,
    recordings: RecordingOptions,
    step: Callable[[str], None],
) -> Output:
    """Identify from many recordings on a cluster, and write the result."""
    file = options.output / name
    read = functools.partial(recordings.read, robot=network.robot, torque=options.torque)
    if options.settings is None:
        step("choosing settings on the first recording")
        settings = choose_settings(network, read(paths[0])).settings
    else:
        settings = load_settings(options.settings)
    with contextlib.ExitStack() as stack:
        client = None  # of a cluster that is started here
        if options.dask != "local":
            client = stack.enter_context(require("distributed", "cluster").Client(options.dask))
        arguments: dict[str, Any] = {"client": client, "read": read, "progress": step}
        if options.fleet:
            fit = fit_fleet_on_cluster(network, paths, settings, **arguments)
            text = _fleet_text(fit.rows())
            data: Callable[[], Any] = lambda: {"fits": fit.rows()}
        else:
            fit = fit_on_cluster(network, paths, settings, **arguments)
            text = f"{fit}\n\n{settings}\n{len(paths)} recordings"
            data = lambda: json.loads(file.read_text(encoding="utf-8"))
    with all_or_nothing(options.output) as scratch:
        fit.save(scratch / name)
    return Output(text, data, [file])


def _fleet_text(rows: list[dict[str, Any]]) -> str:
    lines = [
        f"{row['file']}  {row['result']}, rank {row['rank']}, condition {row['condition']:.3g}"
        for row in rows[:_PRINTED]
    ]
    hidden = len(rows) - len(lines)
    return "\n".join([*lines, *([f"and {hidden} others"] if hidden else [])])
