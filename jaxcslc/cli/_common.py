import contextlib
import sys
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from ..manipulator import Manipulator, RobotError, load_robot, panda, puma560
from ..motion import RecordingError
from ..network import CSLC, derive


BUNDLED = {"puma560": puma560, "panda": panda}

RobotArgument = Annotated[
    str,
    typer.Argument(metavar="ROBOT", help="A robot file (.toml, .urdf, .xml), or puma560 or panda."),
]
LengthsOption = Annotated[
    str,
    typer.Option(
        metavar="auto|symbolic|numeric|NAMES",
        help="Keep lengths as symbols, put their values in, or keep some, as in a2,d4; auto:"
        " symbols up to 6 joints, and values for URDF and MJCF files.",
    ),
]
BaseOption = Annotated[
    str | None, typer.Option(help="Body of a URDF or MJCF file that the robot stands on.")
]
TipOption = Annotated[
    str | None, typer.Option(help="Body of a URDF or MJCF file that the robot ends with.")
]


FrictionOption = Annotated[
    str | None,
    typer.Option(
        metavar="WORDS",
        help="Friction terms of every joint in place of the file's, as in viscous,dry,static"
        " (docs/friction.md).",
    ),
]
CoupledOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="I,J",
        help="Two joints that share a motor's inertia and friction, as in 5,6 or 5,6,-1;"
        " may be repeated.",
    ),
]


def with_drives(robot: Manipulator, friction: str | None, coupled: list[str] | None) -> Manipulator:
    """The robot with friction terms and couplings that its file has no words for."""
    if friction is not None:
        robot = robot.with_friction(*(word.strip() for word in friction.split(",") if word.strip()))
    pairs: list[tuple[int | float, ...]] = []
    for text in coupled or []:
        try:
            first, second, *ratio = (float(number) for number in text.split(","))
            pairs.append((int(first), int(second), *ratio))
        except ValueError:
            raise RobotError(
                f"--coupled: expected two joints, as in 5,6, or 5,6,-1, got {text!r}"
            ) from None
    return robot.with_coupling(*pairs) if pairs else robot


def robot_named(name: str, base: str | None = None, tip: str | None = None) -> Manipulator:
    if name not in BUNDLED:
        return load_robot(name, base=base, tip=tip)
    if base is not None or tip is not None:
        raise RobotError(f"{name}: base and tip choose a part of a file; {name} is one robot")
    return BUNDLED[name]()


def network_of(robot: Manipulator, lengths: str) -> CSLC:
    if lengths == "auto":
        drawn = robot.source is not None and robot.source.format != "toml"
        lengths = "numeric" if drawn or robot.joint_count > 6 else "symbolic"
    if lengths == "symbolic" or lengths == "numeric":
        return derive(robot, lengths=lengths)
    return derive(robot, lengths=[name.strip() for name in lengths.split(",")])


def usable(output: Path) -> None:
    if output.exists() and not output.is_dir():
        raise ValueError(f"{output}: expected a folder for the results, this is a file")


@contextlib.contextmanager
def one_line_errors() -> Generator[None]:
    """What a user can set right is one line on standard error, and exit code 2."""
    try:
        yield
    except BrokenPipeError:  # the reader has seen enough, as `head` has; typer ends quietly
        raise
    except (RobotError, RecordingError, ValueError, RuntimeError, OSError) as error:
        message = " ".join(str(error).split()) or type(error).__name__
        print(f"jaxcslc: {message}", file=sys.stderr)
        raise typer.Exit(2) from None


@contextlib.contextmanager
def progress(first: str) -> Generator[Callable[[str], None]]:
    """A line on standard error that says what is being done, on a terminal only."""
    console = Console(stderr=True)
    with console.status(first) as status:
        yield lambda text: status.update(text)
