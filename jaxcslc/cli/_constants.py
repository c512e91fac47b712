from pathlib import Path
from typing import Annotated

import typer

from ..identification import identify_torque_constants
from ..identification.report import load_settings
from ._common import (
    BaseOption,
    ColumnsOption,
    CoupledOption,
    FixOption,
    FrictionOption,
    MimicOption,
    RobotArgument,
    SettingsOption,
    TipOption,
    network_of,
    one_line_errors,
    progress,
    recording_of,
    recordings_of,
    robot_named,
    with_notes,
)


def constants_command(
    robot: RobotArgument,
    unloaded: Annotated[
        Path, typer.Argument(metavar="UNLOADED", help="Recording of the arm without payload.")
    ],
    loaded: Annotated[
        Path, typer.Argument(metavar="LOADED", help="Recording of the arm carrying the payload.")
    ],
    mass: Annotated[float, typer.Option(help="Mass of the payload [kg].")],
    columns: ColumnsOption = None,
    base: BaseOption = None,
    tip: TipOption = None,
    fix: FixOption = None,
    mimic: MimicOption = None,
    friction: FrictionOption = None,
    coupled: CoupledOption = None,
    settings: SettingsOption = None,
) -> None:
    """Identify torque constants from motor currents and a payload of known mass.

    The recordings hold currents as torques: constant = 1 in [torque] of the file of --columns.
    """
    with one_line_errors(), progress("reading") as step:
        manipulator = robot_named(robot, base, tip, fix, mimic)
        read = recordings_of(
            (unloaded, loaded), lambda path: recording_of(path, manipulator, columns)
        )
        alone, carrying = read.values()
        report = identify_torque_constants(
            network_of(manipulator, "numeric", friction, coupled),
            alone,
            carrying,
            mass,
            None if settings is None else load_settings(settings),
            progress=step,
        )
    typer.echo(with_notes(report, manipulator, unloaded=alone, loaded=carrying))
