"""The command `jaxcslc identify`: its options, and identification on a cluster."""

import contextlib
import dataclasses
import functools
import glob
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer

from .._environment import require
from .._processes import processes_beside
from ..bodies import Choice, load_prior
from ..identification import ESTIMATORS, identify
from ..least_squares import fit_fleet_on_cluster, fit_on_cluster
from ..likelihood import MaximumLikelihood
from ..manipulator import Manipulator
from ..network import CSLC
from ..report import Report, load_report, load_settings, replaced_files
from ..selection import choose_settings
from ._common import (
    CommandContext,
    check_no_robot_options,
    check_output,
    choice_of,
    command,
    command_text,
    names_in,
    progress,
    typed_options,
    wrote,
)
from ._inputs import (
    Drives,
    LengthsOption,
    OutputOption,
    RecordingOptions,
    RobotOrSystemArgument,
    RobotPart,
    SettingsOption,
    is_system,
    recordings_of,
)


if TYPE_CHECKING:
    from ..systems import SystemReport


@dataclasses.dataclass(frozen=True)
class IdentifyOptions:
    """Recordings to fit and to judge on, the estimator, and what is known and asked for."""

    train: Annotated[
        list[Path],
        typer.Argument(metavar="TRAIN...", help="Recording to fit, or several of one robot."),
    ]
    validate: Annotated[
        Path | None, typer.Option(help="Recording to judge the fit on; it is not fitted.")
    ] = None
    output: OutputOption = Path("identified")
    lengths: LengthsOption = "auto"
    settings: SettingsOption = None
    estimator: Annotated[
        str,
        typer.Option(
            metavar="|".join(ESTIMATORS),
            help="Regression on smoothed motion; or positions and coefficients estimated together,"
            " without a smoothing; or instruments from simulated motion, which say whether"
            " regression is biased; or the one of the first two that predicts motion that was not"
            " fitted better.",
        ),
    ] = "least-squares"
    likelihood_every: Annotated[
        int | None,
        typer.Option(
            help="Maximum likelihood: equations of motion over two times so many samples, for arms"
            " whose transmission vibrates. By the noise of estimated positions if omitted.",
        ),
    ] = None
    measured: Annotated[
        bool | None,
        typer.Option(
            "--measured/--demanded",
            help="Torques were measured at the samples, or are demands that drives hold to the"
            " next sample; by default what the file's format says. It counts where the recording"
            " itself does not show which torque belongs to a sample.",
            show_default=False,
        ),
    ] = None
    offsets: Annotated[
        bool,
        typer.Option(
            "--offsets", help="Fit a constant torque of each joint in each recording along."
        ),
    ] = False
    torque_lag: Annotated[
        float | None,
        typer.Option(
            help="How much later than positions torques were measured [s]; that of --settings, or"
            " 0, if omitted.",
        ),
    ] = None
    loss: Annotated[
        str | None,
        typer.Option(
            metavar="squared|huber|bisquare",
            help="Loss of the fit; huber and bisquare bound what outliers do to it; that of"
            " --settings, or squared, if omitted.",
        ),
    ] = None
    folds: Annotated[
        int | None,
        typer.Option(help="Stretches that settings are chosen by; 8, or fewer if it is short."),
    ] = None
    check: Annotated[
        bool, typer.Option(help="Check the recordings first, as jaxcslc check does.")
    ] = True
    reidentify: Annotated[
        str | None,
        typer.Option(
            metavar="GROUPS",
            help="Fit only these coefficients, by group or name as in viscous,dry; all others are"
            " fixed at those of --previous.",
        ),
    ] = None
    previous: Annotated[
        Path | None,
        typer.Option(help="The identification.json of a previous run, for --reidentify."),
    ] = None
    systematic: Annotated[
        bool,
        typer.Option(help="Widen a robot's intervals by errors of smoothing and of missing terms."),
    ] = True
    possible: Annotated[
        str,
        typer.Option(
            metavar="auto|always|never",
            help="Fit physically possible bodies along, and use their coefficients where they"
            " predict motion that was left out better than the free fit; or always; or do not.",
        ),
    ] = "auto"
    prior: Annotated[
        Path | None,
        typer.Option(
            metavar="PRIORS.TOML",
            help="What is known of coefficients and links: fixed, bounded, or with an error"
            " (docs/uncertainty.md).",
        ),
    ] = None
    memory: Annotated[
        float,
        typer.Option(
            metavar="GB",
            help="Memory to use, about: in a longer recording, settings are chosen and fits judged"
            " on a part that is said; coefficients are fitted to all of it.",
        ),
    ] = 2.0
    horizon: Annotated[
        bool,
        typer.Option(
            "--horizon",
            help="Simulate the identified arm open loop from recorded states, beside that of the"
            " file and one with pre-sliding that was used, and report how far positions are off"
            " after 0.1 to 5 s.",
        ),
    ] = False
    dask: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS|local",
            help="Fit many recordings on the workers of a Dask cluster, or of one that is started"
            " here. Quoted patterns are expanded, as 'logs/*.parquet'.",
        ),
    ] = None
    fleet: Annotated[
        bool,
        typer.Option("--fleet", help="With --dask: fit each recording by itself, as of a robot."),
    ] = False


# Fits of a fleet that are printed; all are in the file.
_PRINTED = 20
# What `identify` does on a cluster besides fitting is to read, prepare and settings.
_OF_CLUSTER = {
    *(field.name for kind in (RobotPart, Drives, RecordingOptions) for field in fields(kind)),
    *("robot", "lengths", "train", "output", "settings", "measured", "dask", "fleet"),
}


@command
def identify_command(
    context: CommandContext,
    robot: RobotOrSystemArgument,
    options: IdentifyOptions,
    part: RobotPart,
    drives: Drives,
    recordings: RecordingOptions,
) -> None:
    """Identify a robot's coefficients from recordings of positions and torques.

    Or those of another system, from a recording with a column for each of its variables.
    """
    known = options.estimator == "least-squares"  # the time that it takes
    with progress("reading", estimated=known) as step, processes_beside():
        check_output(context, options.output, replaced_files(options.output))
        if options.dask is not None or options.fleet:
            _check_cluster_options(context, robot, options)
            arm = part.read(robot)
            network = drives.network(arm, options.lengths)
            return typer.echo(_identified_on_cluster(network, options, recordings, step))
        if is_system(robot):
            check_no_robot_options(context, robot)
            report = _identified_system(robot, options, step)
        else:
            report = _identified(context, part.read(robot), options, drives, recordings, step)
        step("writing")
        paths = report.save(options.output, command=command_text(context))
    typer.echo(f"{report}\n\n{wrote(paths)}")


def _identified(
    context: CommandContext,
    arm: Manipulator,
    options: IdentifyOptions,
    drives: Drives,
    recordings: RecordingOptions,
    step: Callable[[str], None],
) -> Report:
    saved = None if options.previous is None else load_report(options.previous, arm)
    if saved is None:
        network = drives.network(arm, options.lengths)
    elif typed_options(context) & {"lengths", "friction", "coupled"}:
        raise ValueError("--lengths, --friction and --coupled: not with --previous, which has them")
    else:
        network = saved.network
    settings = None if saved is None else saved.settings
    prior = None if options.prior is None else load_prior(options.prior)
    every = options.likelihood_every
    stated = {"torque_lag": options.torque_lag, "loss": options.loss}
    read = functools.partial(recordings.read, robot=network.robot, measured=options.measured)
    return identify(
        network,
        recordings_of(options.train, read),
        None if options.validate is None else read(options.validate),
        settings if options.settings is None else load_settings(options.settings),
        estimator=choice_of("--estimator", options.estimator, tuple(ESTIMATORS)),
        likelihood=None if every is None else MaximumLikelihood(every=every),
        offsets=options.offsets,
        previous=None if saved is None else saved.fit,
        groups=None if options.reidentify is None else names_in(options.reidentify),
        friction="auto" if drives.friction == "auto" else None,
        options={name: value for name, value in stated.items() if value is not None},
        folds=options.folds,
        checks=options.check,
        systematic=options.systematic,
        possible=choice_of("--possible", options.possible, get_args(Choice)),
        prior=prior,
        memory=options.memory,
        horizon=options.horizon,
        progress=step,
    )


def _check_cluster_options(context: CommandContext, robot: str, options: IdentifyOptions) -> None:
    """**Raises** `ValueError` for what there is not on a cluster."""
    if options.dask is None:
        raise ValueError("--fleet: only with --dask")
    if is_system(robot):
        raise ValueError("--dask: expected a robot; other systems are identified in one process")
    if others := sorted(typed_options(context) - _OF_CLUSTER):
        raise ValueError(f"--{others[0].replace('_', '-')}: not with --dask")


def _identified_system(
    name: str, options: IdentifyOptions, step: Callable[[str], None]
) -> "SystemReport":
    from ..systems import identify_system, load_system, load_system_recording

    if len(options.train) > 1:
        raise ValueError(f"several recordings are of robots; {name} is another system")
    system = load_system(name)
    judging = options.validate
    return identify_system(
        system,
        load_system_recording(options.train[0], system),
        None if judging is None else load_system_recording(judging, system),
        None if options.settings is None else load_settings(options.settings),
        progress=step,
    )


def _identified_on_cluster(
    network: CSLC,
    options: IdentifyOptions,
    recordings: RecordingOptions,
    step: Callable[[str], None],
) -> str:
    """Identify from many recordings on a cluster, write the result, and return what is printed."""
    paths: list[Path] = []
    for pattern in map(str, options.train):
        if not (matching := sorted(glob.glob(pattern))):
            raise ValueError(f"{pattern}: no such file; expected recordings")
        paths += map(Path, matching)
    read = functools.partial(recordings.read, robot=network.robot, measured=options.measured)
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
            file, text = options.output / "fleet.csv", _fleet_text(fit.rows())
        else:
            fit = fit_on_cluster(network, paths, settings, **arguments)
            file = options.output / "fit.json"
            text = f"{fit}\n\n{settings}\n{len(paths)} recordings"
    options.output.mkdir(parents=True, exist_ok=True)
    fit.save(file)
    return f"{text}\n\n{wrote([file])}"


def _fleet_text(rows: list[dict[str, Any]]) -> str:
    lines = [
        f"{row['file']}  {row['result']}, rank {row['rank']}, condition {row['condition']:.3g}"
        for row in rows[:_PRINTED]
    ]
    hidden = len(rows) - len(lines)
    return "\n".join([*lines, *([f"and {hidden} others"] if hidden else [])])
