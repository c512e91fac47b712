from pathlib import Path
from typing import Annotated

import typer

from ..identification.report import compare_reports
from ._common import one_line_errors


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
    with one_line_errors():
        comparison = compare_reports(first, second)
        if output is not None:
            if not output.absolute().parent.is_dir() or output.is_dir():
                raise ValueError(f"{output}: expected an HTML file in a folder that exists")
            comparison.save(output)
    typer.echo(str(comparison) + ("" if output is None else f"\n\nwrote {output}"))
