"""The command `jaxcslc compare`."""

from pathlib import Path
from typing import Annotated

import typer

from ..report import compare_reports
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
        if output is not None:
            _check_page(output)
        comparison = compare_reports(first, second)
        if output is not None:
            comparison.save(output)
    typer.echo(str(comparison) + ("" if output is None else f"\n\nwrote {output}"))


def _check_page(path: Path) -> None:
    """**Raises** `ValueError` for what is no place for a page, as another file that it would
    replace."""
    if path.suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"{path}: expected a name that ends in .html")
    if not path.absolute().parent.is_dir() or path.is_dir():
        raise ValueError(f"{path}: expected an HTML file in a folder that exists")
