from pathlib import Path
from typing import Annotated

import typer

from ..identification import check
from ._common import (
    BaseOption,
    ColumnsOption,
    FixOption,
    FrictionOption,
    MimicOption,
    RobotArgument,
    TipOption,
    network_of,
    one_line_errors,
    progress,
    robot_named,
    robot_notes,
)
from ._recording_options import (
    BetweenOption,
    DespikeOption,
    DropStaleOption,
    EveryOption,
    PeriodOption,
    RecordingOptions,
)


def check_command(
    robot: RobotArgument,
    recordings: Annotated[
        list[Path], typer.Argument(metavar="RECORDING...", help="Recordings of the robot.")
    ],
    base: BaseOption = None,
    tip: TipOption = None,
    fix: FixOption = None,
    mimic: MimicOption = None,
    friction: FrictionOption = None,
    columns: ColumnsOption = None,
    between: BetweenOption = None,
    every: EveryOption = None,
    period: PeriodOption = None,
    drop_stale: DropStaleOption = False,
    despike: DespikeOption = False,
) -> None:
    """Check recordings for wrong units, signs, times and samples, before anything is identified.

    Prints what was read, and what looks wrong, with the likely cause and what to do about it.
    Exit code 0: nothing looks wrong; 1: something does; 2: wrong input.
    """
    with one_line_errors(), progress("reading") as step:
        manipulator = robot_named(robot, base, tip, fix, mimic)
        options = RecordingOptions(columns, between, every, period, drop_stale, despike)
        read = [options.read(path, manipulator) for path in recordings]
        step("deriving")
        network = network_of(
            manipulator, "numeric" if manipulator.has_all_lengths else "symbolic", friction
        )
        names = [str(path) for path in recordings]
        page = check(network, read, names, progress=step)
        notes = robot_notes(manipulator) + [
            f"note: {name}: {note}"
            for name, recording in zip(names, read, strict=True)
            for note in recording.notes
        ]
    typer.echo("\n".join([str(page), *notes]))
    if page.findings:
        raise typer.Exit(1)
