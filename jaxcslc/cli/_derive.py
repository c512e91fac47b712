"""The command `jaxcslc derive`."""

from pathlib import Path
from typing import Annotated

import typer

from ..report import DerivationReport, check_output_folder
from ._common import (
    CommandContext,
    LengthsOption,
    RobotOrSystemArgument,
    check_no_robot_options,
    is_system,
    one_line_errors,
    with_notes,
)
from ._robot_options import Drives, RobotPart
from ._spread import spread


@spread
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
    with one_line_errors():
        if output is not None:
            check_output_folder(output)
        if is_system(robot):
            check_no_robot_options(context, robot)
            _derive_system(robot, output)
            return
        network = drives.network(part.read(robot), lengths)
        report = DerivationReport.of(network)
        typer.echo(with_notes(report, network.robot))
        if output is not None:
            typer.echo("\nwrote " + ", ".join(str(path) for path in report.save(output)))


def _derive_system(name: str, output: Path | None) -> None:
    from ..systems import load_system, save_derivation  # robots need not wait for it

    system = load_system(name)
    typer.echo(system)
    if output is not None:
        paths = save_derivation(system, output)
        typer.echo("\nwrote " + ", ".join(str(path) for path in paths))
