"""The command `jaxcslc export`."""

from importlib.resources import files
from pathlib import Path
from typing import Annotated

import typer

from ..export import c_code, export_robot, write_c
from ..report import Report, load_report
from ._common import command, progress
from ._inputs import BUNDLED, RobotArgument, RobotPart, with_notes


@command
def export_command(
    robot: RobotArgument,
    identification: Annotated[
        Path,
        typer.Argument(
            metavar="IDENTIFICATION",
            help="Folder that identify wrote, or the identification.json in it.",
        ),
    ],
    part: RobotPart,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help="File to write: the robot's with _identified in its name if omitted, or with"
            " --c NAME.c and NAME.h.",
        ),
    ] = None,
    c: Annotated[
        bool, typer.Option("--c", help="Write C code for a controller instead of a robot file.")
    ] = False,
    motors: Annotated[
        bool,
        typer.Option(
            help="Keep motor inertias apart from bodies: as motor_inertia in TOML, armature in"
            " MJCF, in NAME.motors.toml beside a URDF; or put what they do into the bodies."
        ),
    ] = True,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Let the output be the robot's own file.")
    ] = False,
) -> None:
    """Write identified coefficients into the robot's own file, or as C code for a controller.

    Masses, centres of gravity and inertia tensors are the possible ones nearest to the identified
    coefficients; nothing else in the file changes. It is read again to prove that it predicts the
    same torques. C code has the identified coefficients as they are, and states of dry friction
    that yields before it slides, where identify used them.
    """
    with progress("reading") as step:
        bundled = files("jaxcslc.manipulator") / "robots" / f"{robot}.toml"
        file = Path(str(bundled)) if robot in BUNDLED else Path(robot)
        path = Path(f"{file.stem}_identified{file.suffix}") if output is None else output
        if not c and not overwrite and path.exists() and file.exists() and path.samefile(file):
            raise ValueError(f"{path}: is the robot's own file; expected another, or --overwrite")
        saved = load_report(identification, part.read(str(file)))
        if c:
            step("writing C")
            text = _written_c(saved, output)
        else:
            written = export_robot(
                saved.network,
                saved.fit,
                path,
                motion=saved.motion,
                motors=motors,
                systematic=saved.systematic,
                progress=step,
            )
            text = str(written) + _pre_sliding(saved, "is left out: dry friction is a step")
    typer.echo(with_notes(text, saved.network.robot))


def _written_c(saved: Report, output: Path | None) -> str:
    """Write C code, and return what is printed of it."""
    if (states := saved.pre_sliding) is None:
        code = c_code(saved.network, saved.fit.k)
    else:
        code = c_code(states.network, states.fit.k, presliding_distance=states.presliding_distance)
    source, header = write_c(code, output)
    counts = ", ".join(f"{name} {count}" for name, count in code.operations.items())
    note = _pre_sliding(
        saved,
        f"has a state, which {code.name}_pre_sliding updates; coefficients are of the fit with it",
    )
    return f"operations: {counts}\nwrote {source} and {header}{note}"


def _pre_sliding(saved: Report, what: str) -> str:
    """Return a line of what becomes of joints that yield before they slide, if any do."""
    if saved.pre_sliding is None:
        return ""
    return f"\nnote: pre-sliding of {', '.join(saved.pre_sliding.joint_names)} {what}"
