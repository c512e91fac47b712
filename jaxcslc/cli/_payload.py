"""The commands `jaxcslc payload` and `jaxcslc constants`: of arms that carry a payload."""

from pathlib import Path
from typing import Annotated

import typer

from ..identification import identify_torque_constants
from ..payload import identify_payload
from ..report import load_report, load_settings
from ._common import CommandContext, check_output, command, progress, wrote
from ._inputs import (
    ColumnsOption,
    Drives,
    OutputOption,
    RobotArgument,
    RobotPart,
    SettingsOption,
    recording_of,
    recordings_of,
    with_notes,
)


@command
def payload_command(
    context: CommandContext,
    robot: RobotArgument,
    loaded: Annotated[
        Path, typer.Argument(metavar="LOADED", help="Recording of the arm carrying the payload.")
    ],
    previous: Annotated[
        Path,
        typer.Option(help="The identification.json of the arm without payload, from identify."),
    ],
    part: RobotPart,
    unloaded: Annotated[
        Path | None,
        typer.Option(
            help="Recording of the arm without it: the arm's coefficients are then fitted to both"
            " recordings, in place of those of --previous."
        ),
    ] = None,
    output: OutputOption = Path("payload"),
    settings: SettingsOption = None,
    columns: ColumnsOption = None,
) -> None:
    """Identify a payload: its mass, centre of gravity and inertia, in the last link's frame."""
    with progress("reading") as step:
        check_output(context, output, [output / "payload.csv", output / "payload.json"])
        saved = load_report(previous, part.read(robot))
        arm = saved.network.robot
        carrying = recording_of(loaded, arm, columns)
        alone = None if unloaded is None else recording_of(unloaded, arm, columns)
        report = identify_payload(
            saved.network,
            carrying,
            alone,
            saved.settings if settings is None else load_settings(settings),
            previous=saved.fit if unloaded is None else None,
            progress=step,
        )
        step("writing")
        paths = report.save(output)
    text = with_notes(report, arm, loaded=carrying, unloaded=alone)
    typer.echo(f"{text}\n\n{wrote(paths)}")


@command
def constants_command(
    robot: RobotArgument,
    unloaded: Annotated[
        Path, typer.Argument(metavar="UNLOADED", help="Recording of the arm without payload.")
    ],
    loaded: Annotated[
        Path, typer.Argument(metavar="LOADED", help="Recording of the arm carrying the payload.")
    ],
    mass: Annotated[float, typer.Option(help="Mass of the payload [kg].")],
    part: RobotPart,
    drives: Drives,
    columns: ColumnsOption = None,
    settings: SettingsOption = None,
) -> None:
    """Identify torque constants from motor currents and a payload of known mass.

    The recordings hold currents as torques: constant = 1 in [torque] of the file of --columns.
    """
    with progress("reading") as step:
        manipulator = part.read(robot)
        paths = (unloaded, loaded)
        read = recordings_of(paths, lambda path: recording_of(path, manipulator, columns))
        alone, carrying = read.values()
        report = identify_torque_constants(
            drives.network(manipulator, "numeric"),
            alone,
            carrying,
            mass,
            None if settings is None else load_settings(settings),
            progress=step,
        )
    typer.echo(with_notes(report, manipulator, unloaded=alone, loaded=carrying))
