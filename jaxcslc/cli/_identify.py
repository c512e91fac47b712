from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from ..identification import identify
from ..identification.report import check_output_folder, load_report, load_settings
from ._common import (
    BaseOption,
    ColumnsOption,
    CommandContext,
    CoupledOption,
    FrictionOption,
    LengthsOption,
    RobotOrSystemArgument,
    SettingsOption,
    TipOption,
    check_no_robot_options,
    command_text,
    is_system,
    names_in,
    network_of,
    one_line_errors,
    progress,
    recordings_of,
    robot_named,
    with_drives,
)
from ._recording_options import (
    BetweenOption,
    DespikeOption,
    DropStaleOption,
    EveryOption,
    PeriodOption,
    RecordingOptions,
)


def identify_command(
    context: CommandContext,
    robot: RobotOrSystemArgument,
    train: Annotated[
        list[Path],
        typer.Argument(metavar="TRAIN...", help="Recording to fit, or several of one robot."),
    ],
    validate: Annotated[
        Path | None, typer.Option(help="Recording to judge the fit on; it is not fitted.")
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the results.")] = Path(
        "identified"
    ),
    lengths: LengthsOption = "auto",
    base: BaseOption = None,
    tip: TipOption = None,
    friction: FrictionOption = None,
    coupled: CoupledOption = None,
    settings: SettingsOption = None,
    columns: ColumnsOption = None,
    offsets: Annotated[
        bool,
        typer.Option(
            "--offsets", help="Fit a constant torque of each joint in each recording along."
        ),
    ] = False,
    between: BetweenOption = None,
    every: EveryOption = None,
    period: PeriodOption = None,
    drop_stale: DropStaleOption = False,
    despike: DespikeOption = False,
    torque_lag: Annotated[
        float | None,
        typer.Option(help="How much later than positions torques were measured [s]."),
    ] = None,
    loss: Annotated[
        str | None,
        typer.Option(
            metavar="squared|huber|bisquare",
            help="Loss of the fit; huber and bisquare bound what outliers do to it.",
        ),
    ] = None,
    folds: Annotated[
        int | None,
        typer.Option(help="Stretches that settings are chosen by; 8, or fewer if it is short."),
    ] = None,
    check: Annotated[
        bool, typer.Option(help="Check the recordings first, as jaxcslc check does.")
    ] = True,
    reidentify: Annotated[
        str | None,
        typer.Option(
            metavar="GROUPS",
            help="Fit only these coefficients, by group or name as in viscous,dry; all others are"
            " fixed at those of --previous.",
        ),
    ] = None,
    previous: Annotated[
        Path | None,
        typer.Option(help="The identification.json of a previous run, for --reidentify."),
    ] = None,
    systematic: Annotated[
        bool,
        typer.Option(help="Widen a robot's intervals by errors of smoothing and of missing terms."),
    ] = True,
) -> None:
    """Identify a robot's coefficients from recordings of positions and torques.

    Or those of another system, from a recording with a column for each of its variables.
    """
    with one_line_errors(), progress("reading") as step:
        check_output_folder(output)
        if is_system(robot):
            check_no_robot_options(
                robot,
                lengths=lengths,
                base=base,
                tip=tip,
                friction=friction,
                coupled=coupled,
                reidentify=reidentify,
                previous=previous,
                columns=columns,
                between=between,
                every=every,
                period=period,
                torque_lag=torque_lag,
                loss=loss,
                folds=folds,
            )
            if len(train) > 1 or offsets:
                raise ValueError(f"several recordings are of robots; {robot} is another system")
            command = command_text(context)
            text = _identify_system(robot, train[0], validate, output, settings, command, step)
            typer.echo(text)
            return
        if (reidentify is None) != (previous is None):
            raise ValueError("--reidentify and --previous: expected both or neither")
        if previous is not None and (lengths != "auto" or friction is not None or coupled):
            raise ValueError(
                "--lengths, --friction and --coupled: not with --previous, which has them"
            )
        manipulator = robot_named(robot, base, tip)
        saved = None if previous is None else load_report(previous, manipulator)
        if saved is None:
            network = network_of(with_drives(manipulator, friction, coupled), lengths)
        else:
            network = saved.network
        options = saved.settings if saved is not None else None
        reading = RecordingOptions(columns, between, every, period, drop_stale, despike)
        changes = {"torque_lag": torque_lag, "loss": loss}
        report = identify(
            network,
            recordings_of(train, lambda path: reading.read(path, network.robot)),
            None if validate is None else reading.read(validate, network.robot),
            options if settings is None else load_settings(settings),
            offsets=offsets,
            previous=None if saved is None else saved.fit,
            groups=None if reidentify is None else names_in(reidentify),
            options={name: value for name, value in changes.items() if value is not None},
            folds=folds,
            checks=check,
            systematic=systematic,
            progress=step,
        )
        step("writing")
        paths = report.save(output, command=command_text(context))
    typer.echo(f"{report}\n\nwrote " + ", ".join(str(path) for path in paths))


def _identify_system(
    name: str,
    train: Path,
    validate: Path | None,
    output: Path,
    settings: Path | None,
    command: str,
    step: Callable[[str], None],
) -> str:
    """What is printed of a system's identification."""
    from ..systems import (  # robots need not wait for it
        identify_system,
        load_system,
        load_system_recording,
    )

    system = load_system(name)
    report = identify_system(
        system,
        load_system_recording(train, system),
        None if validate is None else load_system_recording(validate, system),
        None if settings is None else load_settings(settings),
        progress=step,
    )
    step("writing")
    paths = report.save(output, command=command)
    return f"{report}\n\nwrote " + ", ".join(str(path) for path in paths)
