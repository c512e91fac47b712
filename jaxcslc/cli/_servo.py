"""`jaxcslc identify --drive servo` and `check --drive servo`: options, recordings and report."""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from ..checks import Finding
from ..manipulator import LinkParameters, Manipulator, seen_from
from ..servo import (
    SERVO_FILES,
    ServoRecording,
    Table,
    check_servos,
    identify_servo,
    load_servo_recordings,
    servo_report,
)
from ._common import Context, Output
from ._inputs import RecordingOptions, RobotPart, numbers, robot_notes, two_numbers
from ._options import UsageError, option


_GROUP = "servo"
# Of so many recordings, without --validate, the last fifth is held out.
_ENOUGH, _HELD_OUT = 5, 5
_OPTIONS = {
    *(field.name for field in dataclasses.fields(RobotPart)),
    *(
        "robot",
        "recordings",
        "train",
        "validate",
        "output",
        "overwrite",
        "columns",
        "between",
        "json",
        "quiet",
    ),
}


@dataclasses.dataclass(frozen=True)
class ServoReading:
    """Drive of the joints, and how recordings of servos are read."""

    drive: Annotated[
        Literal["torque", "servo"],
        option(
            group=_GROUP,
            help="torque: the recordings have torques. servo: they have commanded positions, of an"
            " arm of position servos (docs/servo.md).",
        ),
    ] = "torque"
    units: Annotated[
        Literal["radians", "degrees", "normalised"] | None,
        option(
            group=_GROUP,
            help="Units of a LeRobot data set; normalised: -100 to 100 of each joint's range. By"
            " default radians or degrees, where the values show which.",
        ),
    ] = None
    calibration: Annotated[
        Path | None,
        option(
            group=_GROUP,
            metavar="FILE",
            help="LeRobot's calibration file of the arm, for normalised units and grippers.",
        ),
    ] = None
    known: Annotated[
        list[str] | None,
        option(
            group=_GROUP,
            metavar="NAME=VALUE",
            help="Parameter of the drives that is known, in SI units: one value, or one per joint,"
            " as in gain=20 or damping=1.5,1.5,2. May be repeated. Wins over the robot file's"
            " [drive].",
        ),
    ] = None

    def __post_init__(self) -> None:
        self.known_parameters()

    def known_parameters(self) -> dict[str, float | list[float]]:
        """Return the parameters that are known, by name."""
        found: dict[str, float | list[float]] = {}
        for text in self.known or ():
            name, _, numbers = text.partition("=")
            try:
                values = [float(x) for x in numbers.split(",")]
            except ValueError:
                raise UsageError(
                    f"--known: expected NAME=VALUE, as in gain=20, got {text!r}"
                ) from None
            found[name.strip()] = values[0] if len(values) == 1 else values
        return found

    def read(
        self, paths: Sequence[Path], robot: Manipulator, recordings: RecordingOptions
    ) -> dict[str, ServoRecording]:
        """Read recordings by name, their joints in the robot's order."""
        found: dict[str, ServoRecording] = {}
        for path in paths:
            of_file = load_servo_recordings(
                path,
                [robot.joint_names[joint] for joint in robot.independent_joints],
                recordings.columns,
                units=self.units,
                calibration=self.calibration,
            )
            found |= {
                key if key == path.name else f"{path.name}: {key}": value
                for key, value in of_file.items()
            }
        if recordings.between is not None:
            start, end = two_numbers(recordings.between)
            found = {key: value.between(start, end) for key, value in found.items()}
        return found


@dataclasses.dataclass(frozen=True)
class ServoOptions(ServoReading):
    """The same, and recordings with a payload."""

    loaded: Annotated[
        list[Path] | None,
        option(
            group=_GROUP,
            metavar="RECORDING",
            help="Recording of the arm with a payload of known mass, which fixes the unit of"
            " torque. May be repeated.",
        ),
    ] = None
    mass: Annotated[
        float | None, option(group=_GROUP, metavar="KG", help="Mass of that payload.")
    ] = None
    centre: Annotated[
        str,
        option(
            group=_GROUP,
            metavar="X,Y,Z",
            help="Its centre of mass, in the last body's frame of the robot file [m].",
        ),
    ] = "0,0,0"

    table: Annotated[
        str | None,
        option(
            group=_GROUP,
            metavar="BODY,X,Y,Z[,HEIGHT]",
            help="The hand may lean on a table: the body of the robot file that touches it, the"
            " point that does, in that body's frame [m], and the table's height in the base's frame"
            " [m], 0 by default.",
        ),
    ] = None

    def __post_init__(self) -> None:
        if (self.loaded is None) != (self.mass is None):
            raise UsageError("--loaded and --mass: got one of them; expected both or neither")
        if self.mass is not None and not 0.0 < self.mass < math.inf:
            raise UsageError(f"--mass: expected more than 0 kg, got {self.mass:g}")
        self._centre()
        self._table()
        super().__post_init__()

    def _centre(self) -> list[float]:
        expected = "X,Y,Z in m, as in 0,0,0.05"
        centre = numbers("--centre", self.centre, expected, 3)
        if not all(map(math.isfinite, centre)):
            raise UsageError(f"--centre: expected {expected}, got {self.centre!r}")
        return list(centre)

    def _table(self) -> tuple[str, list[float]] | None:
        if self.table is None:
            return None
        body, _, point = self.table.partition(",")
        expected = "BODY,X,Y,Z or BODY,X,Y,Z,HEIGHT in m, as in gripper_link,0,0,-0.1"
        values = numbers("--table", point, expected, 4 if point.count(",") == 3 else 3)
        if not body or not all(map(math.isfinite, values)):
            raise UsageError(f"--table: expected {expected}, got {self.table!r}")
        return body, [*values, 0.0][:4]

    def table_of(self, robot: Manipulator) -> Table | None:
        """Return the table in the frames of the links.

        **Raises** `ValueError`: a body that is none of the robot's.
        """
        stated = self._table()
        if stated is None:
            return None
        body, (*point, height) = stated
        source = robot.source
        of_file = source is not None and source.format != "toml"
        names = source.links if source is not None and of_file else robot.joint_names
        if body not in names:
            raise ValueError(f"--table: {body!r} is no moved body; expected of {', '.join(names)}")
        link = list(names).index(body)
        pose = source.placements[link] if source is not None and of_file else np.eye(4)
        x, y, z = (float(value) for value in (pose @ [*point, 1.0])[:3])
        return Table(link, (x, y, z), height)

    def payload(self, robot: Manipulator) -> LinkParameters:
        """Return the payload in the frame of the last link."""
        assert self.mass is not None
        body = LinkParameters(self.mass, np.array(self._centre()), np.zeros((3, 3)))
        source = robot.source
        if source is None or source.format == "toml":
            return body
        return seen_from(body, source.placements[-1])


SERVO_READING = {field.name for field in dataclasses.fields(ServoReading)} - {"drive"}
SERVO_OPTIONS = {field.name for field in dataclasses.fields(ServoOptions)} - {"drive"}
"""Options that are of servos alone."""


def check_servo_recordings(
    context: Context,
    name: str,
    options: ServoReading,
    paths: Sequence[Path],
    part: RobotPart,
    recordings: RecordingOptions,
    step: Callable[[str], None],
) -> Output:
    """Say whether the base moved in recordings of servos.

    **Raises** `ValueError`: options that are of torques, and as `check_servos`.
    """
    _refuse_others(context, SERVO_READING)
    robot = part.read(name)
    read = options.read(paths, robot, recordings)
    known = dict(robot.drive or {}) | options.known_parameters()
    step("regressing")
    lines: list[str] = []
    findings: list[Finding] = []
    for label, recording in read.items():
        seconds = float(recording.time[-1] - recording.time[0])
        lines.append(f"{label}: {recording.samples} samples in {seconds:.4g} s")
        found = check_servos(robot, recording, known)
        findings += [
            dataclasses.replace(x, recording=label if len(read) > 1 else "") for x in found
        ]
    lines += ["", *(f"warning: {x}" for x in findings)] if findings else ["nothing looks wrong"]
    return Output(
        "\n".join([*lines, *robot_notes(robot)]),
        lambda: {"findings": [dataclasses.asdict(x) for x in findings]},
        status=1 if findings else 0,
    )


def _refuse_others(context: Context, own: set[str]) -> None:
    if others := sorted(context.typed - _OPTIONS - own - {"drive"}):
        raise ValueError(f"--{others[0].replace('_', '-')}: not with --drive servo")


def identify_servos(
    context: Context,
    name: str,
    options: ServoOptions,
    train: Sequence[Path],
    validate: Path | None,
    output: Path,
    part: RobotPart,
    recordings: RecordingOptions,
    step: Callable[[str], None],
) -> Output:
    """Identify the drives of an arm of position servos, and write a report.

    **Raises** `ValueError`: options that are of torques, and as `identify_servo`.
    """
    _refuse_others(context, SERVO_OPTIONS)
    context.check_output([output / file for file in SERVO_FILES], folder=output)
    robot = part.read(name)
    table = options.table_of(robot)

    def read(paths: Sequence[Path]) -> dict[str, ServoRecording]:
        return options.read(paths, robot, recordings)

    training = read(train)
    held_out: Mapping[str, ServoRecording] = {} if validate is None else read([validate])
    if validate is None and len(training) >= _ENOUGH:
        names = list(training)
        kept = len(names) - max(1, len(names) // _HELD_OUT)
        held_out = {key: training.pop(key) for key in names[kept:]}
    loaded = read(options.loaded or ())
    body = options.payload(robot) if loaded else None
    step("identifying servos")
    fit = identify_servo(
        robot,
        [*training.values(), *loaded.values()],
        payloads=[*[None] * len(training), *[body] * len(loaded)],
        known=dict(robot.drive or {}) | options.known_parameters(),
        table=table,
        progress=step,
    )
    report = servo_report(fit, training, held_out, progress=step)
    step("writing")
    files = report.save(output, command=context.text())
    text = "\n".join([str(report), *robot_notes(robot)])
    return Output(text, report.document, files)
