"""The command `jaxcslc constants`."""

from pathlib import Path
from typing import Annotated

import typer

from ..identification import identify_torque_constants
from ..report import load_settings
from ._common import (
    ColumnsOption,
    RobotArgument,
    SettingsOption,
    one_line_errors,
    progress,
    recording_of,
    recordings_of,
    with_notes,
)
from ._robot_options import Drives, RobotPart
from ._spread import spread


@spread
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
    with one_line_errors(), progress("reading") as step:
        manipulator = part.read(robot)
        read = recordings_of(
            (unloaded, loaded), lambda path: recording_of(path, manipulator, columns)
        )
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
