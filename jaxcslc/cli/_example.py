"""The command `jaxcslc example`."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from ._common import one_line_errors


def example_command(
    arm: Annotated[
        Literal["panda", "puma560", "ur5"], typer.Argument(help="The arm.", metavar="ARM")
    ] = "panda",
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", help="New folder for the files; named as the arm if omitted."
        ),
    ] = None,
) -> None:
    """Write a robot file and two simulated logs to try the other commands on.

    The logs are in the format of the arm's own software. truth.json holds the true coefficients.
    """
    from ..examples import write_example

    folder = Path(arm) if output is None else output
    with one_line_errors():
        example = write_example(arm, folder)
    robot = example.robot.name
    files = ", ".join(
        path.name for path in (example.robot, example.train, example.validation, example.truth)
    )
    typer.echo(f"wrote {folder}: {files}\n\nTry:")
    for line in next_commands(folder, robot):
        typer.echo(f"  {line}")


def next_commands(folder: Path, robot: str) -> list[str]:
    """Return the commands to type after `jaxcslc example`."""
    stem, suffix = robot.rsplit(".", 1)
    return [
        f"cd {folder}",
        f"jaxcslc check {robot} train.csv",
        f"jaxcslc identify {robot} train.csv --validate validation.csv -o results",
        f"jaxcslc export {robot} results -o {stem}_identified.{suffix}",
        f"jaxcslc export {robot} results --c -o {stem}.c",
        f"jaxcslc excite {robot} --prior results --duration 10 -o next.csv",
    ]
