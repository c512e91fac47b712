"""The command `jaxcslc check`."""

from pathlib import Path
from typing import Annotated

from .._plain_data import record_document
from ..checks import check
from ._common import Context, Output, command
from ._inputs import Drives, RecordingOptions, RobotArgument, RobotPart, robot_notes
from ._options import UsageError, argument
from ._servo import SERVO_READING, ServoReading, check_servo_recordings


@command(
    "checks",
    "check arm.urdf log.csv",
    "check arm.urdf morning.csv noon.csv --fix gripper",
    "check legs.urdf log.csv --drive servo --known gain=20 --known damping=1.5",
)
def check_command(
    context: Context,
    robot: RobotArgument,
    recordings: Annotated[list[Path], argument("RECORDING...", "Recordings of the robot.")],
    part: RobotPart,
    drives: Drives,
    servo: ServoReading,
    options: RecordingOptions,
) -> Output:
    """Check recordings for wrong units, signs, times and samples, before anything is identified.

    Prints what was read, and what looks wrong, with the likely cause and what to do about it. Of
    position servos (--drive servo), it checks that the base does not move. Exit code 0: nothing
    looks wrong; 1: something does; 2: wrong input.
    """
    if servo.drive == "servo":
        with context.progress("reading") as step:
            return check_servo_recordings(context, robot, servo, recordings, part, options, step)
    if others := sorted(context.typed & SERVO_READING):
        raise UsageError(f"--{others[0]}: only with --drive servo")
    with context.progress("reading") as step:
        manipulator = part.read(robot)
        names = [str(path) for path in recordings]
        read = [options.read(path, manipulator) for path in recordings]
        step("deriving")
        lengths = "numeric" if manipulator.has_all_lengths else "symbolic"
        network = drives.network(manipulator, lengths)
        page = check(network, read, names, progress=step)
    named = zip(names, read, strict=True)
    found = {f"note: {one.evidence}" for one in page.findings}
    notes = [note for note in robot_notes(manipulator) if note not in found]
    notes += [f"note: {name}: {note}" for name, recording in named for note in recording.notes]
    return Output(
        "\n".join([str(page), *notes]),
        lambda: record_document(page),
        status=1 if page.findings else 0,
    )
