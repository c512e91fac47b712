"""The command `jaxcslc derive`."""

from pathlib import Path
from typing import Annotated

import typer

from ..report import DerivationReport
from ._common import CommandContext, check_no_robot_options, check_output, command, wrote
from ._inputs import (
    Drives,
    LengthsOption,
    RobotOrSystemArgument,
    RobotPart,
    is_system,
    with_notes,
)


@command
def derive_command(
    context: CommandContext,
    robot: RobotOrSystemArgument,
    part: RobotPart,
    drives: Drives,
    lengths: LengthsOption = "auto",
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder for the tables, as files.")
    ] = None,
) -> None:
    """Derive a robot's inverse dynamics: its inputs, links and named coefficients.

    Or separate the unknown constants of another system from its variables.
    """
    if output is not None:
        check_output(context, output, ())
    if is_system(robot):
        from ..systems import load_system, save_derivation  # robots need not wait for it

        check_no_robot_options(context, robot)
        system = load_system(robot)
        typer.echo(system)
        paths = () if output is None else save_derivation(system, output)
    else:
        network = drives.network(part.read(robot), lengths)
        report = DerivationReport.of(network)
        typer.echo(with_notes(report, network.robot))
        paths = () if output is None else report.save(output)
    if paths:
        typer.echo(f"\n{wrote(paths)}")
