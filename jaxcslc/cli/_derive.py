from pathlib import Path
from typing import Annotated

import typer

from ..assessment import (
    all_or_nothing,
    coefficient_rows,
    coefficient_text,
    derivation_document,
    write_csv,
    write_json,
)
from ._common import (
    BaseOption,
    LengthsOption,
    RobotArgument,
    TipOption,
    network_of,
    one_line_errors,
    robot_named,
    usable,
)


def derive_command(
    robot: RobotArgument,
    lengths: LengthsOption = "auto",
    base: BaseOption = None,
    tip: TipOption = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder for the tables, as files.")
    ] = None,
) -> None:
    """Derive a robot's inverse dynamics: its inputs, links and named coefficients."""
    with one_line_errors():
        network = network_of(robot_named(robot, base, tip), lengths)
        typer.echo(network)
        counts = network.counts
        for name in ("mass", "velocity", "gravity"):
            count = counts[name]
            typer.echo(
                f"{name}: {count['inputs']} inputs, {count['links']} links,"
                f" {count['coefficients']} coefficients"
            )
        per_joint = ", ".join(str(order) for order in network.order_per_joint)
        typer.echo(f"network order {network.order}; per joint {per_joint}\n")
        rows = coefficient_rows(network)
        typer.echo(coefficient_text(rows))
        if output is not None:
            usable(output)
            with all_or_nothing(output) as folder:
                write_csv(folder / "coefficients.csv", rows)
                write_json(folder / "tables.json", derivation_document(network))
            typer.echo(f"\nwrote {output / 'coefficients.csv'} and {output / 'tables.json'}")
