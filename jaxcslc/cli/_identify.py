"""The command `jaxcslc identify`."""

from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import typer

from .._processes import processes_beside
from ..bodies import Choice, load_prior
from ..identification import ESTIMATORS, identify
from ..likelihood import MaximumLikelihood
from ..manipulator import Manipulator
from ..network import CSLC
from ..report import Report, check_output_folder, load_report, load_settings, replaced_files
from ._cluster import identified_on_cluster
from ._common import (
    CommandContext,
    RobotOrSystemArgument,
    check_inputs_are_kept,
    check_no_robot_options,
    choice_of,
    command_text,
    is_system,
    names_in,
    one_line_errors,
    progress,
    recordings_of,
    typed_options,
    without_none,
)
from ._identify_options import IdentifyOptions
from ._recording_options import RecordingOptions
from ._robot_options import Drives, RobotPart
from ._spread import spread


if TYPE_CHECKING:
    from ..systems import SystemReport


# What `identify` does on a cluster besides fitting is to read, prepare and settings.
_OF_CLUSTER = {
    *(field.name for kind in (RobotPart, Drives, RecordingOptions) for field in fields(kind)),
    *("robot", "lengths", "train", "output", "settings", "measured", "dask", "fleet"),
}


@spread
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
    with one_line_errors(), progress("reading", estimated=known) as step, processes_beside():
        check_output_folder(options.output)
        check_inputs_are_kept(context, replaced_files(options.output))
        if options.dask is not None or options.fleet:
            _check_cluster_options(context, robot, options)
            arm = part.read(robot)
            network = drives.network(arm, options.lengths)
            return typer.echo(identified_on_cluster(network, options, recordings, step))
        if is_system(robot):
            check_no_robot_options(context, robot)
            report = _identified_system(robot, options, step)
        else:
            arm = part.read(robot)
            saved = _previous_report(context, arm, options.previous)
            network = drives.network(arm, options.lengths) if saved is None else saved.network
            report = _identified(network, saved, options, drives, recordings, step)
        step("writing")
        paths = report.save(options.output, command=command_text(context))
    wrote = ", ".join(str(path) for path in paths)
    typer.echo(f"{report}\n\n{report.verdict}\n\nwrote {wrote}")


def _identified(
    network: CSLC,
    saved: Report | None,
    options: IdentifyOptions,
    drives: Drives,
    recordings: RecordingOptions,
    step: Callable[[str], None],
) -> Report:
    """The report of a robot; `saved`: that of which a part is fitted again."""
    settings = None if saved is None else saved.settings
    prior = None if options.prior is None else load_prior(options.prior)
    every = options.likelihood_every
    read: Callable[[Path], Any] = lambda path: recordings.read(
        path, network.robot, options.measured
    )
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
        options=without_none(torque_lag=options.torque_lag, loss=options.loss),
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


def _previous_report(
    context: CommandContext, robot: Manipulator, path: Path | None
) -> Report | None:
    """The identification that `--previous` names, of which a part is to be fitted again."""
    if path is None:
        return None
    if typed_options(context) & {"lengths", "friction", "coupled"}:
        raise ValueError("--lengths, --friction and --coupled: not with --previous, which has them")
    return load_report(path, robot)


def _identified_system(
    name: str, options: IdentifyOptions, step: Callable[[str], None]
) -> "SystemReport":
    """The report of another system."""
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
