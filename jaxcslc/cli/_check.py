"""The command `jaxcslc check`."""

from pathlib import Path
from typing import Annotated

import typer

from ..checks import check
from ._common import command, progress
from ._inputs import Drives, RecordingOptions, RobotArgument, RobotPart, robot_notes


@command
def check_command(
    robot: RobotArgument,
    recordings: Annotated[
        list[Path], typer.Argument(metavar="RECORDING...", help="Recordings of the robot.")
    ],
    part: RobotPart,
    drives: Drives,
    options: RecordingOptions,
) -> None:
    """Check recordings for wrong units, signs, times and samples, before anything is identified.

    Prints what was read, and what looks wrong, with the likely cause and what to do about it.
    Exit code 0: nothing looks wrong; 1: something does; 2: wrong input.
    """
    with progress("reading") as step:
        manipulator = part.read(robot)
        names = [str(path) for path in recordings]
        read = [options.read(path, manipulator) for path in recordings]
        step("deriving")
        lengths = "numeric" if manipulator.has_all_lengths else "symbolic"
        network = drives.network(manipulator, lengths)
        page = check(network, read, names, progress=step)
    named = zip(names, read, strict=True)
    notes = [f"note: {name}: {note}" for name, recording in named for note in recording.notes]
    typer.echo("\n".join([str(page), *robot_notes(manipulator), *notes]))
    if page.findings:
        raise typer.Exit(1)
