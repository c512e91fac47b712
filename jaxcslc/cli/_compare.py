"""The command `jaxcslc compare`."""

from pathlib import Path
from typing import Annotated

import typer

from ..report import compare_reports
from ._common import command, wrote


@command
def compare_command(
    first: Annotated[
        Path,
        typer.Argument(
            metavar="A", help="Folder that identify wrote, or the identification.json in it."
        ),
    ],
    second: Annotated[Path, typer.Argument(metavar="B", help="The other.")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="HTML file to write.")
    ] = None,
) -> None:
    """Compare two identifications: coefficients, errors and settings side by side.

    Differences of coefficients are in standard errors, systematic errors included.
    """
    if output is not None:
        if output.suffix.lower() not in (".html", ".htm"):
            raise ValueError(f"{output}: expected a name that ends in .html")
        if not output.absolute().parent.is_dir() or output.is_dir():
            raise ValueError(f"{output}: expected an HTML file in a folder that exists")
    comparison = compare_reports(first, second)
    if output is not None:
        comparison.save(output)
    typer.echo(str(comparison) + ("" if output is None else f"\n\n{wrote([output])}"))
