from pathlib import Path
from typing import Annotated

import typer

from ..identification.report import DerivationReport, check_output_folder
from ._common import (
    BaseOption,
    CoupledOption,
    FrictionOption,
    LengthsOption,
    RobotArgument,
    TipOption,
    network_of,
    one_line_errors,
    robot_named,
    with_drives,
)


def derive_command(
    robot: RobotArgument,
    lengths: LengthsOption = "auto",
    base: BaseOption = None,
    tip: TipOption = None,
    friction: FrictionOption = None,
    coupled: CoupledOption = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder for the tables, as files.")
    ] = None,
) -> None:
    """Derive a robot's inverse dynamics: its inputs, links and named coefficients."""
    with one_line_errors():
        if output is not None:
            check_output_folder(output)
        network = network_of(with_drives(robot_named(robot, base, tip), friction, coupled), lengths)
        report = DerivationReport.of(network)
        typer.echo(report)
        if output is not None:
            typer.echo("\nwrote " + ", ".join(str(path) for path in report.save(output)))
