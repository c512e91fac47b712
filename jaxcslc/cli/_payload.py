"""The commands `jaxcslc payload` and `jaxcslc torque-constants`: of arms that carry a payload."""

import json
from pathlib import Path
from typing import Annotated

from ..identification import identify_torque_constants
from ..payload import identify_payload
from ..report import load_report, load_settings
from ._common import Context, Output, OverwriteOption, command
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
from ._options import argument, option


@command("payload", "payload arm.urdf loaded.csv --previous results")
def payload_command(
    context: Context,
    robot: RobotArgument,
    loaded: Annotated[Path, argument("LOADED", "Recording of the arm carrying the payload.")],
    previous: Annotated[Path, option(help="Result of identify for the arm without the payload.")],
    part: RobotPart,
    unloaded: Annotated[
        Path | None,
        option(
            help="Recording of the arm without it. The arm's coefficients are then fitted to both"
            " recordings, instead of taken from --previous."
        ),
    ] = None,
    output: OutputOption = Path("payload"),
    overwrite: OverwriteOption = False,
    settings: SettingsOption = None,
    columns: ColumnsOption = None,
) -> Output:
    """Identify a payload: its mass, centre of gravity and inertia, in the last link's frame."""
    del overwrite
    with context.progress("reading") as step:
        written = [output / "payload.csv", output / "payload.json"]
        context.check_output(written, folder=output)
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
    return Output(text, lambda: json.loads(paths[1].read_text(encoding="utf-8")), paths)


@command(
    "recordings", "torque-constants arm.urdf empty.csv loaded.csv --mass 2 --columns columns.toml"
)
def torque_constants_command(
    context: Context,
    robot: RobotArgument,
    unloaded: Annotated[Path, argument("UNLOADED", "Recording of the arm without payload.")],
    loaded: Annotated[Path, argument("LOADED", "Recording of the arm carrying the payload.")],
    mass: Annotated[float, option(metavar="KG", above=0.0, help="Mass of the payload.")],
    part: RobotPart,
    drives: Drives,
    columns: ColumnsOption = None,
    settings: SettingsOption = None,
) -> Output:
    """Identify torque constants from motor currents and a payload of known mass.

    The recordings hold currents as torques: constant = 1 in [torque] of the file of --columns.
    """
    with context.progress("reading") as step:
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
    text = with_notes(report, manipulator, unloaded=alone, loaded=carrying)
    return Output(text, lambda: {"torque_constants": report.rows()})
