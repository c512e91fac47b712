"""Options and helpers that several commands share: robots, recordings, errors, progress."""

import contextlib
import shlex
import sys
import tomllib
from collections.abc import Callable, Generator, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from .._environment import MissingExtraError
from ..manipulator import Manipulator, RobotError, panda, puma560, tx40
from ..recordings import Recording, RecordingError, load_recording
from ._progress_lines import PASSED, progress_lines


if TYPE_CHECKING:
    CommandContext = typer.Context
else:
    # What commands get is of the class below it, which a checker of annotations insists on.
    CommandContext = typer.Context.__mro__[1]

BUNDLED = {"puma560": puma560, "panda": panda, "tx40": tx40}
"""Robots that the library brings with it, by the name that the command takes."""

# What commands on systems that are not robots take.
_SYSTEM_PARAMETERS = {"robot", "train", "validate", "output", "settings"}

RobotArgument = Annotated[
    str,
    typer.Argument(
        metavar="ROBOT", help="A robot file (.toml, .urdf, .xml), or puma560, panda or tx40."
    ),
]
RobotOrSystemArgument = Annotated[
    str,
    typer.Argument(
        metavar="ROBOT",
        help="A robot file (.toml, .urdf, .xml), or puma560, panda or tx40; or a file of another"
        " system (.toml with [equations], docs/systems.md).",
    ),
]
LengthsOption = Annotated[
    str,
    typer.Option(
        metavar="auto|symbolic|numeric|NAMES",
        help="Keep lengths as symbols, put their values in, or keep some, as in a2,d4; auto:"
        " symbols up to 6 joints, and values for URDF and MJCF files.",
    ),
]


OutputOption = Annotated[Path, typer.Option("-o", "--output", help="Folder for the results.")]
SettingsOption = Annotated[
    Path | None,
    typer.Option(
        help="Settings from a previous identification.json, or a JSON file written by hand; those"
        " of --previous if omitted, or else chosen by cross-validation within the recording."
    ),
]


ColumnsOption = Annotated[
    Path | None,
    typer.Option(
        metavar="MAPPING.TOML",
        help="Names, units and torque constants of the recordings' columns, where their format"
        " does not say them (docs/recordings.md).",
    ),
]


def recording_of(path: Path, robot: Manipulator, columns: Path | None) -> Recording:
    """A recording of a robot, its joints in the robot's order."""
    names = [robot.joint_names[joint] for joint in robot.independent_joints]
    fixed = () if robot.source is None else robot.source.fixed_joints
    laws = () if robot.source is None else robot.source.mimics
    following = [(law.follower, law.leader, law.multiplier, law.offset) for law in laws]
    return load_recording(path, joints=names, columns=columns, fixed=fixed, following=following)


def recordings_of(paths: Sequence[Path], read: Callable[[Path], Recording]) -> dict[str, Recording]:
    """Recordings by the names of their files, or by their paths where names repeat."""
    names = [path.name for path in paths]
    if len(set(names)) < len(names):
        names = [str(path) for path in paths]
    if repeated := [name for name in names if names.count(name) > 1]:
        raise ValueError(f"{repeated[0]}: is given twice; expected different recordings")
    return dict(zip(names, map(read, paths), strict=True))


def with_notes(text: object, robot: Manipulator, **recordings: Recording | None) -> str:
    """Return the output of a command, followed by what was decided in reading its files."""
    lines = robot_notes(robot) + [
        f"warning: {name} recording: {note}"
        for name, recording in recordings.items()
        for note in (() if recording is None else recording.notes)
    ]
    return "\n\n".join([str(text), *(["\n".join(lines)] if lines else [])])


def names_in(text: str) -> list[str]:
    """The names of a list that is separated by commas."""
    return [name.strip() for name in text.split(",") if name.strip()]


def command_text(context: CommandContext) -> str:
    """The command line that a command was called by: what was typed, defaults left out."""
    words = ["jaxcslc", context.info_name or ""]
    typed = typed_options(context)
    arguments_first = sorted(
        context.command.params, key=lambda parameter: parameter.param_type_name != "argument"
    )
    for parameter in arguments_first:
        name = parameter.name or ""
        if name not in typed:
            continue
        value = context.params[name]
        option = parameter.param_type_name == "option"
        if isinstance(value, bool):
            words.append((parameter.opts if value else parameter.secondary_opts)[0])
            continue
        for text in value if isinstance(value, list | tuple) else [value]:
            words += [parameter.opts[0], str(text)] if option else [str(text)]
    return shlex.join(words)


def choice_of(option: str, value: str, choices: tuple[Any, ...]) -> Any:
    """The value, one of the choices.

    **Raises** `ValueError` for another.
    """
    if value not in choices:
        raise ValueError(f"{option}: expected {', '.join(choices)}, got {value!r}")
    return value


def is_system(name: str) -> bool:
    """Return whether a file describes a system by its equations, and not a robot."""
    if name in BUNDLED or Path(name).suffix.lower() != ".toml":
        return False
    try:
        return "equations" in tomllib.loads(Path(name).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError):
        return False  # whoever reads it as a robot says what is wrong


def typed_options(context: CommandContext) -> set[str]:
    """Names of the parameters that stand on the command line, defaults left out."""
    sources = {name: context.get_parameter_source(name) for name in context.params}
    return {name for name, source in sources.items() if source and source.name == "COMMANDLINE"}


def check_no_robot_options(context: CommandContext, name: str) -> None:
    """**Raises** `ValueError` for an option of robots in a command on a system."""
    typed = typed_options(context) - _SYSTEM_PARAMETERS
    for parameter in context.command.params:
        if parameter.name in typed:
            value = context.params[parameter.name]
            options = parameter.secondary_opts if value is False else parameter.opts
            raise ValueError(f"{options[0]} is for robots; {name} describes another system")


def check_inputs_are_kept(context: CommandContext, written: Iterable[Path]) -> None:
    """**Raises** `ValueError` if a command would replace a file that it reads.

    - `written`: the files that it writes.
    """
    replaced = {path.resolve() for path in written}
    for name, value in context.params.items():
        if name == "output":
            continue
        for entry in value if isinstance(value, list | tuple) else [value]:
            if not isinstance(entry, Path) and name != "robot":
                continue
            path = Path(entry)
            if path.is_dir():  # stands for what identify wrote into it
                path /= "identification.json"
            if path.resolve() in replaced:
                raise ValueError(
                    f"{path}: is read, and the results would replace it; expected another --output"
                )


def without_none(**options: object) -> dict[str, object]:
    """The options that were set."""
    return {name: value for name, value in options.items() if value is not None}


def robot_notes(robot: Manipulator) -> list[str]:
    """Return notes on what was not taken from the robot's file as it stands, a line each."""
    return [f"note: {note}" for note in robot.notes]


@contextlib.contextmanager
def one_line_errors() -> Generator[None]:
    """Prints errors that a user can correct as one line on standard error, with exit code 2."""
    try:
        yield
    except BrokenPipeError:  # `head` closes the pipe early; typer exits quietly
        raise
    except (
        RobotError,
        RecordingError,
        MissingExtraError,
        ValueError,
        RuntimeError,
        OSError,
    ) as error:
        message = " ".join(str(error).split()) or type(error).__name__
        print(f"jaxcslc: {message}", file=sys.stderr)
        raise typer.Exit(2) from None


@contextlib.contextmanager
def progress(first: str, *, estimated: bool = True) -> Generator[Callable[[str], None]]:
    """Shows the current step on standard error: on a terminal as it changes, elsewhere a line now
    and then, from half a minute on.

    - `estimated`: whether such a line says what is left, as far as it is known.
    """
    console = Console(stderr=True)
    if console.is_terminal:
        with console.status(first) as status:
            yield lambda text: status.update(text)
        return
    write: Callable[[str], None] = lambda line: print(line, file=sys.stderr, flush=True)
    with progress_lines(first, write, passed=PASSED if estimated else {}) as step:
        yield step
