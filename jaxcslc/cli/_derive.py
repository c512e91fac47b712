"""The command `jaxcslc derive`."""

from pathlib import Path
from typing import Annotated

from ..report import DerivationReport, coefficient_rows
from ._common import Context, Output, OverwriteOption, command
from ._inputs import (
    Drives,
    LengthsOption,
    RobotOrSystemArgument,
    RobotPart,
    is_system,
    with_notes,
)
from ._options import option


@command("robots", "derive arm.urdf", "derive panda --friction viscous,dry,static -o tables")
def derive_command(
    context: Context,
    robot: RobotOrSystemArgument,
    part: RobotPart,
    drives: Drives,
    lengths: LengthsOption = "auto",
    output: Annotated[
        Path | None,
        option("-o", "--output", metavar="FOLDER", help="Folder for the tables, as files."),
    ] = None,
    overwrite: OverwriteOption = False,
) -> Output:
    """Derive a robot's inverse dynamics: its inputs, links and named coefficients.

    Or separate the unknown constants of another system from its variables.
    """
    del overwrite
    if output is not None:
        names = ("coefficients.csv", "identifiability.csv", "constants.csv")
        written = [output / name for name in (*names, "tables.json", "system.json")]
        context.check_output(written, folder=output)
    if is_system(robot):
        from ..systems import load_system, save_derivation  # robots need not wait for it

        context.check_no_robot_options(robot)
        system = load_system(robot)
        network, text = system.network, str(system)
        paths = () if output is None else save_derivation(system, output)
    else:
        network = drives.network(part.read(robot), lengths)
        report = DerivationReport.of(network)
        text = with_notes(report, network.robot)
        paths = () if output is None else report.save(output)
    return Output(
        text, lambda: {"name": network.name, "coefficients": coefficient_rows(network)}, paths
    )
