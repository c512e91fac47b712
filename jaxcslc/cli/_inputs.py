"""Options of commands that say which robot and which recordings they read, and their reading."""

import dataclasses
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Literal

from .._processes import processes_beside
from ..checks import without_outliers
from ..manipulator import (
    Manipulator,
    RobotError,
    check_friction,
    load_robot,
    panda,
    puma560,
    tx40,
)
from ..network import CSLC, derive
from ..recordings import (
    ColumnMapping,
    Recording,
    fresh_rows,
    load_recording,
    restore_clock,
    without_stale_rows,
)
from ._common import names_in
from ._options import UsageError, argument, option, parameters_of


BUNDLED = {"puma560": puma560, "panda": panda, "tx40": tx40}
"""Robots that the library brings with it, by the name that the command takes."""

RobotArgument = Annotated[
    str,
    argument("ROBOT", "Robot file (.toml, .urdf, .xml), or puma560, panda or tx40."),
]
RobotOrSystemArgument = Annotated[
    str,
    argument(
        "ROBOT",
        "Robot file (.toml, .urdf, .xml), or puma560, panda or tx40; or the file of another"
        " system (.toml with [equations], docs/systems.md).",
    ),
]
LengthsOption = Annotated[
    str,
    option(
        group="robot",
        metavar="auto|symbolic|numeric|LENGTHS",
        help="Link lengths: symbols, numbers, or symbols for some, as in a2,d4. auto takes symbols"
        " up to 6 joints, and numbers for URDF and MJCF files.",
    ),
]
OutputOption = Annotated[
    Path, option("-o", "--output", metavar="FOLDER", help="Folder for the results.")
]
SettingsOption = Annotated[
    Path | None,
    option(
        help="Settings of a previous identification.json, or of a JSON file. By default those of"
        " --previous, or else chosen by cross-validation within the recording."
    ),
]
ColumnsOption = Annotated[
    Path | None,
    option(
        metavar="FILE",
        help="TOML file with names, units and torque constants of the recordings' columns"
        " (docs/recordings.md).",
    ),
]
LimitsOption = Annotated[
    Path | None,
    option(
        metavar="FILE",
        help="TOML file with limits of joints, and surroundings to keep away from. By default the"
        " limits of the robot file.",
    ),
]
PriorOption = Annotated[
    Path | None,
    option(
        group="knowledge",
        metavar="FILE",
        help="TOML file with known parameters of links: fixed, bounded, or with an error"
        " (docs/uncertainty.md).",
    ),
]
TorqueOption = Annotated[
    Literal["measured", "commanded"] | None,
    option(
        group="recordings",
        flags=(("--measured", "measured"), ("--demanded", "commanded")),
        help="Torques were measured at the samples, or are commands that drives hold to the next"
        " sample. By default what the format says.",
    ),
]
TorqueLagOption = Annotated[
    float | None,
    option(
        group="recordings",
        metavar="SECONDS",
        help="Delay of torques after positions. By default that of --settings, or 0.",
    ),
]


@dataclasses.dataclass(frozen=True)
class RobotPart:
    """The part of a robot file that a command is about; the whole robot if nothing is said."""

    base: Annotated[
        str | None,
        option(
            metavar="BODY",
            help="Body of a URDF or MJCF file that the robot stands on. By default the first.",
        ),
    ] = None
    tip: Annotated[
        list[str] | None,
        option(
            metavar="BODY",
            help="Body of a URDF or MJCF file that the robot ends with. May be repeated. By"
            " default everything on --base.",
        ),
    ] = None
    fix: Annotated[
        list[str] | None,
        option(
            metavar="JOINTS",
            help="Joints of a URDF or MJCF file to fix at zero. A body fixes all joints beyond it,"
            " as in gripper or 'left_*'. May be repeated.",
        ),
    ] = None
    mimic: Annotated[
        Literal["fix", "couple"] | None,
        option(
            group="robot",
            help="Joints that mimic others: fix them at zero with what they follow, or move them"
            " with it. Without it they are an error (docs/robots.md).",
        ),
    ] = None

    def read(self, name: str) -> Manipulator:
        """Read a bundled robot, or the part of a robot file."""
        fixed = [part for names in self.fix or () for part in names_in(names)]
        if name not in BUNDLED:
            with processes_beside():  # what crashes MuJoCo ends another process than this one
                return load_robot(
                    name, base=self.base, tip=self.tip or (), fix=fixed, mimic=self.mimic
                )
        if self.base is not None or self.tip or fixed or self.mimic:
            raise RobotError(
                f"{name}: base, tip, fix and mimic choose a part of a file; {name} is one robot"
            )
        return BUNDLED[name]()


@dataclasses.dataclass(frozen=True)
class Drives:
    """Friction and couplings that a robot's file does not say, or says otherwise.

    - `friction`: `"auto"` leaves what the file says.

    **Raises** `ValueError`: friction terms that there are not, or a wrong pair of joints.
    """

    friction: Annotated[
        str | None,
        option(
            metavar="TERMS",
            help="Friction terms of every joint, as in viscous,dry,static (docs/friction.md); dry"
            " is Coulomb friction. identify also takes auto, which chooses them joint by joint. By"
            " default those of the robot file; identify adds torque offsets that help.",
        ),
    ] = None
    coupled: Annotated[
        list[str] | None,
        option(
            group="robot",
            metavar="I,J",
            help="Two joints that share the inertia and friction of a motor, as in 5,6 or 5,6,-1."
            " May be repeated.",
        ),
    ] = None

    def __post_init__(self) -> None:
        check_friction(self._terms() or (), "--friction")
        self._pairs()

    def network(self, robot: Manipulator, lengths: str) -> CSLC:
        """Derive the network of a robot; `lengths`: as `LengthsOption` describes them."""
        terms = self._terms()
        robot = robot if terms is None else robot.with_friction(*terms)
        robot = robot.with_coupling(*pairs) if (pairs := self._pairs()) else robot
        if lengths == "auto" or lengths == "symbolic" or lengths == "numeric":
            return derive(robot, lengths=lengths)
        return derive(robot, lengths=names_in(lengths))

    def _terms(self) -> list[str] | None:
        """Return the terms of every joint; None for those of the file."""
        if self.friction is None or self.friction == "auto":
            return None
        # What the field calls dry friction.
        return ["dry" if name == "coulomb" else name for name in names_in(self.friction)]

    def _pairs(self) -> list[tuple[int | float, ...]]:
        """Return pairs of joints that share a motor, with their ratio if it is said."""
        pairs: list[tuple[int | float, ...]] = []
        for text in self.coupled or ():
            try:
                first, second, *ratio = text.split(",")
                pairs.append((int(first), int(second), *map(float, ratio)))
            except ValueError:
                raise UsageError(
                    f"--coupled: expected two joints, as in 5,6, or 5,6,-1, got {text!r}"
                ) from None
        return pairs


@dataclasses.dataclass(frozen=True)
class RecordingOptions:
    """Treatment of a recording once it is read, in this order.

    **Attributes**

    - `columns`: a file with a mapping of its columns.
    - `between`: as text, start and end [s from its start].
    - `drop_stale`, `decimate`, `period`, `despike`: as the options of the command say.
    """

    columns: ColumnsOption = None
    between: Annotated[
        str | None,
        option(
            group="recordings",
            metavar="START,END",
            help="Only this part of the recordings [s from their start].",
        ),
    ] = None
    decimate: Annotated[
        int | None,
        option(
            "--decimate",
            "--every",
            group="recordings",
            metavar="NUMBER",
            least=1,
            help="Take one row out of so many: those with new positions.",
        ),
    ] = None
    period: Annotated[
        float | None,
        option(
            group="recordings",
            metavar="SECONDS",
            above=0.0,
            help="Restore the times of samples, of an even clock of this period.",
        ),
    ] = None
    drop_stale: Annotated[
        bool, option(group="recordings", help="Omit rows that repeat the row before.")
    ] = False
    despike: Annotated[
        bool,
        option(
            group="recordings",
            help="Replace single outliers by the median of the seven samples around them.",
        ),
    ] = False

    def __post_init__(self) -> None:
        self._changes()  # what is wrong with options is said before files are read

    def read(
        self, path: Path, robot: Manipulator, torque: Literal["measured", "commanded"] | None = None
    ) -> Recording:
        """Read a recording, its joints in the robot's order.

        - `torque`: what torques are; None for what the format says.

        **Raises**

        - `ValueError`: in one line, for a file that cannot be read, and for options that leave too
          little of it.
        """
        recording = recording_of(path, robot, self.columns)
        if torque is not None:
            recording = dataclasses.replace(recording, torque_measured=torque == "measured")
        return self.treated(recording, path)

    def treated(self, recording: Recording, path: Path) -> Recording:
        """Return a recording as the options change it.

        **Raises** `ValueError`, which names the file, for options that leave too little of it.
        """
        for name, change in self._changes().items():
            try:
                recording = change(recording)
            except ValueError as error:
                spent = float(recording.time[-1] - recording.time[0])
                raise ValueError(
                    f"{path}, {name} of {recording.samples} samples in {spent:.4g} s: {error}"
                ) from error
        return without_outliers(recording) if self.despike else recording

    def _changes(self) -> dict[str, Callable[[Recording], Recording]]:
        """Return changes of a recording by the options that ask for them."""
        changes: dict[str, Callable[[Recording], Recording]] = {}
        if self.between is not None:
            start, end = two_numbers(self.between)
            changes[f"--between {self.between}"] = lambda recording: recording.between(start, end)
        if self.drop_stale:
            changes["--drop-stale"] = without_stale_rows
        if (every := self.decimate) is not None:
            changes[f"--decimate {every}"] = lambda recording: fresh_rows(recording, every)
        if (period := self.period) is not None:
            changes[f"--period {period:g}"] = lambda recording: restore_clock(recording, period)
        return changes


def numbers(shown: str, text: str, expected: str, count: int | None = None) -> tuple[float, ...]:
    """Parse numbers with commas between them: so many, or any number of them.

    **Raises** `UsageError`, which names the option as it is shown, and says what was expected.
    """
    try:
        parsed = tuple(map(float, text.split(",")))
    except ValueError:
        parsed = ()
    if not parsed or count not in (None, len(parsed)):
        raise UsageError(f"{shown}: expected {expected}, got {text!r}")
    return parsed


def two_numbers(text: str) -> tuple[float, float]:
    """Parse START,END.

    **Raises** `UsageError`.
    """
    start, end = numbers("--between", text, "START,END in s, as in 0,8.5", 2)
    if not start < end:
        raise UsageError(f"--between: expected START before END, got {text!r}")
    return start, end


@dataclasses.dataclass(frozen=True)
class _ProjectEntries:
    """Entries of a project file that are not of the dataclasses above."""

    robot: RobotOrSystemArgument
    lengths: LengthsOption
    settings: SettingsOption
    limits: LimitsOption
    prior: PriorOption
    torque: TorqueOption
    torque_lag: TorqueLagOption


PROJECT_PARAMETERS = tuple(
    parameter
    for record in (_ProjectEntries, RobotPart, Drives, RecordingOptions)
    for parameter in parameters_of(record)
)
"""Parameters that a project file may state."""


def is_system(name: str) -> bool:
    """Return whether a file describes a system by its equations, and not a robot."""
    if name in BUNDLED or Path(name).suffix.lower() != ".toml":
        return False
    try:
        return "equations" in tomllib.loads(Path(name).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError):
        return False  # whoever reads it as a robot says what is wrong


def recording_of(path: Path, robot: Manipulator, columns: Path | ColumnMapping | None) -> Recording:
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
