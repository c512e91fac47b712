"""The command `jaxcslc payload`."""

from pathlib import Path
from typing import Annotated

import typer

from ..payload import identify_payload
from ..report import check_output_folder, load_report, load_settings
from ._common import (
    ColumnsOption,
    CommandContext,
    OutputOption,
    RobotArgument,
    SettingsOption,
    check_inputs_are_kept,
    one_line_errors,
    progress,
    recording_of,
    with_notes,
)
from ._robot_options import RobotPart
from ._spread import spread


@spread
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
    with one_line_errors(), progress("reading") as step:
        check_output_folder(output)
        check_inputs_are_kept(context, [output / "payload.csv", output / "payload.json"])
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
    typer.echo(f"{text}\n\nwrote " + ", ".join(str(path) for path in paths))
