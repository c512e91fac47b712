from pathlib import Path
from typing import Annotated

import typer

from ..identification.report import DerivationReport, check_output_folder
from ._common import (
    BaseOption,
    CommandContext,
    CoupledOption,
    FixOption,
    FrictionOption,
    LengthsOption,
    MimicOption,
    RobotOrSystemArgument,
    TipOption,
    check_no_robot_options,
    is_system,
    network_of,
    one_line_errors,
    robot_named,
    with_notes,
)


def derive_command(
    context: CommandContext,
    robot: RobotOrSystemArgument,
    lengths: LengthsOption = "auto",
    base: BaseOption = None,
    tip: TipOption = None,
    fix: FixOption = None,
    mimic: MimicOption = None,
    friction: FrictionOption = None,
    coupled: CoupledOption = None,
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
        network = network_of(robot_named(robot, base, tip, fix, mimic), lengths, friction, coupled)
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
