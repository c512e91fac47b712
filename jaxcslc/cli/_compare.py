"""The command `jaxcslc compare`."""

from pathlib import Path
from typing import Annotated

from ..report import compare_reports
from ._common import Context, Output, OverwriteOption, command
from ._options import UsageError, argument, option


@command("report", "compare before after", "compare before after -o compared.html")
def compare_command(
    context: Context,
    first: Annotated[
        Path, argument("A", "Folder that identify wrote, or the identification.json in it.")
    ],
    second: Annotated[Path, argument("B", "The other.")],
    output: Annotated[Path | None, option("-o", "--output", help="HTML file to write.")] = None,
    overwrite: OverwriteOption = False,
) -> Output:
    """Compare two identifications: coefficients, errors and settings side by side.

    Differences of coefficients are in standard errors, systematic errors included.
    """
    del overwrite
    if output is not None:
        if output.suffix.lower() not in (".html", ".htm"):
            raise UsageError(f"{output}: expected a name that ends in .html")
        if not output.absolute().parent.is_dir() or output.is_dir():
            raise ValueError(f"{output}: expected an HTML file in a folder that exists")
        context.check_output([output])
    comparison = compare_reports(first, second)
    if output is not None:
        comparison.save(output)
    return Output(
        str(comparison),
        lambda: {"verdict": comparison.verdict[1], "coefficients": comparison.rows},
        [] if output is None else [output],
    )
