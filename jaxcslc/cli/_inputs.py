"""Options of commands that say which robot and which recordings they read, and their reading."""

import dataclasses
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, cast, get_args

import typer

from ..checks import without_outliers
from ..manipulator import Manipulator, Mimics, RobotError, load_robot, panda, puma560, tx40
from ..network import CSLC, derive
from ..recordings import (
    Recording,
    fresh_rows,
    load_recording,
    restore_clock,
    without_stale_rows,
)
from ._common import choice_of, names_in


BUNDLED = {"puma560": puma560, "panda": panda, "tx40": tx40}
"""Robots that the library brings with it, by the name that the command takes."""

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


@dataclasses.dataclass(frozen=True)
class RobotPart:
    """The part of a robot file that a command is about; the whole robot if nothing is said."""

    base: Annotated[
        str | None,
        typer.Option(
            help="Body of a URDF or MJCF file that the robot stands on; the file's first if"
            " omitted.",
        ),
    ] = None
    tip: Annotated[
        list[str] | None,
        typer.Option(
            help="Body of a URDF or MJCF file that the robot ends with; may be repeated, for"
            " several arms; everything on --base if omitted.",
        ),
    ] = None
    fix: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAMES",
            help="Joints of a URDF or MJCF file to fix at zero, or bodies, with all joints on them"
            " and beyond, as in gripper or 'left_*'; may be repeated.",
        ),
    ] = None
    mimic: Annotated[
        str | None,
        typer.Option(
            metavar="fix|couple",
            help="Joints of a URDF or MJCF file that mimic others: fixed at zero with what they"
            " follow, or moved with it; an error if omitted and a file has some (docs/robots.md).",
        ),
    ] = None

    def read(self, name: str) -> Manipulator:
        """Read a bundled robot, or the part of a robot file."""
        if self.mimic is not None:
            choice_of("--mimic", self.mimic, get_args(Mimics))
        fixed = [part for names in self.fix or () for part in names_in(names)]
        if name not in BUNDLED:
            mimic = cast(Any, self.mimic)
            return load_robot(name, base=self.base, tip=self.tip or (), fix=fixed, mimic=mimic)
        if self.base is not None or self.tip or fixed or self.mimic:
            raise RobotError(
                f"{name}: base, tip, fix and mimic choose a part of a file; {name} is one robot"
            )
        return BUNDLED[name]()


@dataclasses.dataclass(frozen=True)
class Drives:
    """Friction and couplings that a robot's file does not say, or says otherwise.

    - `friction`: `"auto"` leaves what the file says.
    """

    friction: Annotated[
        str | None,
        typer.Option(
            metavar="TERMS",
            help="Friction terms of every joint in place of the file's, as in viscous,dry,static"
            " (docs/friction.md); identify also takes auto, which chooses them joint by joint.",
        ),
    ] = None
    coupled: Annotated[
        list[str] | None,
        typer.Option(
            metavar="I,J",
            help="Two joints that share a motor's inertia and friction, as in 5,6 or 5,6,-1; may"
            " be repeated.",
        ),
    ] = None

    def network(self, robot: Manipulator, lengths: str) -> CSLC:
        """Derive the network of a robot; `lengths`: as `LengthsOption` describes them."""
        if self.friction not in (None, "auto"):
            robot = robot.with_friction(*names_in(self.friction))
        pairs = [_pair(text) for text in self.coupled or ()]
        robot = robot.with_coupling(*pairs) if pairs else robot
        if lengths == "auto" or lengths == "symbolic" or lengths == "numeric":
            return derive(robot, lengths=lengths)
        return derive(robot, lengths=names_in(lengths))


@dataclasses.dataclass(frozen=True)
class RecordingOptions:
    """Treatment of a recording once it is read, in this order.

    **Attributes**

    - `columns`: a file with a mapping of its columns.
    - `between`: as text, start and end [s from its start].
    - `drop_stale`, `every`, `period`, `despike`: as the options of the command say.
    """

    columns: ColumnsOption = None
    between: Annotated[
        str | None,
        typer.Option(
            metavar="START,END", help="Only this stretch of the recordings [s from their start]."
        ),
    ] = None
    every: Annotated[
        int | None, typer.Option(min=1, help="Only every so many rows: those with new positions.")
    ] = None
    period: Annotated[
        float | None,
        typer.Option(help="Restore the times of samples of an even clock of this period [s]."),
    ] = None
    drop_stale: Annotated[
        bool, typer.Option("--drop-stale", help="Leave out rows that repeat the row before.")
    ] = False
    despike: Annotated[
        bool,
        typer.Option(
            "--despike", help="Replace single outliers by the median of the seven samples around."
        ),
    ] = False

    def read(self, path: Path, robot: Manipulator, measured: bool | None = None) -> Recording:
        """Read a recording, its joints in the robot's order.

        - `measured`: whether torques are measurements; None for what the format says.

        **Raises**

        - `ValueError`: in one line, for a file that cannot be read, and for options that leave too
          little of it.
        """
        recording = recording_of(path, robot, self.columns)
        if measured is not None:
            recording = dataclasses.replace(recording, torque_measured=measured)
        for option, change in self._changes().items():
            try:
                recording = change(recording)
            except ValueError as error:
                spent = float(recording.time[-1] - recording.time[0])
                raise ValueError(
                    f"{path}, {option} of {recording.samples} samples in {spent:.4g} s: {error}"
                ) from error
        return without_outliers(recording) if self.despike else recording

    def _changes(self) -> dict[str, Callable[[Recording], Recording]]:
        """Return changes of a recording by the options that ask for them."""
        changes: dict[str, Callable[[Recording], Recording]] = {}
        if self.between is not None:
            start, end = _two_numbers(self.between)
            changes[f"--between {self.between}"] = lambda recording: recording.between(start, end)
        if self.drop_stale:
            changes["--drop-stale"] = without_stale_rows
        if (every := self.every) is not None:
            changes[f"--every {every}"] = lambda recording: fresh_rows(recording, every)
        if (period := self.period) is not None:
            changes[f"--period {period:g}"] = lambda recording: restore_clock(recording, period)
        return changes


def _two_numbers(text: str) -> tuple[float, float]:
    try:
        start, end = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"--between: expected START,END in s, as in 0,8.5, got {text!r}") from None
    return start, end


def _pair(text: str) -> tuple[int | float, ...]:
    """Two joints that share a motor's inertia and friction, and their ratio if it is said."""
    try:
        first, second, *ratio = text.split(",")
        return (int(first), int(second), *map(float, ratio))
    except ValueError:
        raise RobotError(
            f"--coupled: expected two joints, as in 5,6, or 5,6,-1, got {text!r}"
        ) from None


def is_system(name: str) -> bool:
    """Return whether a file describes a system by its equations, and not a robot."""
    if name in BUNDLED or Path(name).suffix.lower() != ".toml":
        return False
    try:
        return "equations" in tomllib.loads(Path(name).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError):
        return False  # whoever reads it as a robot says what is wrong


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


def robot_notes(robot: Manipulator) -> list[str]:
    """Return notes on what was not taken from the robot's file as it stands, a line each."""
    return [f"note: {note}" for note in robot.notes]
