from collections.abc import Sequence
from pathlib import Path
from textwrap import fill
from typing import Annotated

import typer

from ..derivation import StructuralIdentifiability, structural_identifiability
from ..identification.report import (
    all_or_nothing,
    coefficient_rows,
    coefficient_text,
    derivation_document,
    write_csv,
    write_json,
)
from ..network import CSLC
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
    usable,
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
        network = network_of(with_drives(robot_named(robot, base, tip), friction, coupled), lengths)
        if output is not None:
            usable(output)
        typer.echo(network)
        tables = _have_practical_tables(network)
        typer.echo(_sizes(network) if tables else _NO_TABLES)
        rows = coefficient_rows(network)
        typer.echo(f"\n{coefficient_text(rows)}\n")
        told = structural_identifiability(network.algebra)
        typer.echo(_told(told))
        if network.robot.coupled:
            typer.echo(
                "  (coupled joints: what they share is not part of this list, and may stand in for"
                " motor inertias)"
            )
        if output is not None:
            written = ["coefficients.csv", "identifiability.csv"]
            with all_or_nothing(output) as folder:
                write_csv(folder / written[0], rows)
                write_csv(folder / written[1], [_told_row(one) for one in told])
                if tables:
                    written.append("tables.json")
                    write_json(folder / written[2], derivation_document(network))
            typer.echo("\nwrote " + ", ".join(str(output / name) for name in written))


_NO_TABLES = (
    "closed-form tables are left out: of twists other than multiples of 90° they have tens of"
    " thousands of links; torque is computed by recursion"
)


def _have_practical_tables(network: CSLC) -> bool:
    return all(0 in link.twist and 0 in link.branch for link in network.algebra.chain.links)


def _sizes(network: CSLC) -> str:
    counts = network.counts
    lines = [
        f"{name}: {counts[name]['inputs']} inputs, {counts[name]['links']} links,"
        f" {counts[name]['coefficients']} coefficients"
        for name in ("mass", "velocity", "gravity")
    ]
    per_joint = ", ".join(str(order) for order in network.order_per_joint)
    return "\n".join([*lines, f"network order {network.order}; per joint {per_joint}"])


def _told(rows: Sequence[StructuralIdentifiability]) -> str:
    """What any motion could tell of the link parameters, in a few lines."""
    verdicts: dict[str, list[str]] = {"alone": [], "only in combinations": [], "not at all": []}
    for row in rows:
        verdicts[row.verdict].append(row.parameter)
    text = "what motion and torque can tell of link parameters:"
    for verdict, names in verdicts.items():
        listed = fill(", ".join(names), 96, initial_indent="    ", subsequent_indent="    ")
        text += f"\n  {verdict} ({len(names)})" + (f"\n{listed}" if names else "")
    return text


def _told_row(row: StructuralIdentifiability) -> dict[str, str | int]:
    return {
        "parameter": row.parameter,
        "link": row.link,
        "verdict": row.verdict,
        "coefficients": " ".join(row.coefficients),
    }
