"""Findings about recordings: evidence, and one table of likely causes and remedies.

Functions of `_sample_findings` and `_motion_findings` look for evidence, and name a row of the
table.
"""

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any


@dataclasses.dataclass(frozen=True)
class Finding:
    """Fault that a recording seems to have.

    **Attributes**

    - `kind`: what it is about, such as `"time unit"`, `"sign"` or `"torque lag"`.
    - `joint`: name of the joint, or of several; empty where it is about all of them.
    - `evidence`: a sentence with numbers.
    - `cause`: the likeliest one.
    - `remedy`: what to do about it, with the option of the command if there is one.
    - `recording`: name of the recording; empty where there is one.

    >>> from jaxcslc.checks import Finding
    >>> print(Finding("gap", "", "no sample for 3 s from 8.2 s on", "lost rows", "record again"))
    gap: no sample for 3 s from 8.2 s on. Likely cause: lost rows. Remedy: record again
    """

    kind: str
    joint: str
    evidence: str
    cause: str
    remedy: str
    recording: str = ""

    def or_else(self, cause: str, remedy: str = "") -> "Finding":
        """Return the finding with a second cause that the recording cannot tell from the first."""
        remedies = f"{self.remedy}; or {remedy}" if remedy else self.remedy
        cause = f"{self.cause}; or, as likely, {cause}"
        return dataclasses.replace(self, cause=cause, remedy=remedies)

    def __str__(self) -> str:
        where = ", ".join(part for part in (self.recording, self.kind, self.joint) if part)
        return f"{where}: {self.evidence}. Likely cause: {self.cause}. Remedy: {self.remedy}"


AGREEMENT_KINDS = ("payload", "friction", "disagreement")
"""Kinds of findings that say that a recording is not of the same arm as the first."""

SPOILING_KINDS = (
    *("time unit", "angle unit", "torque unit", "sign", "swapped joints", "wrong robot"),
    *("torque scale", "zero position", "position scale", "mounting", "gravity compensation"),
    *("clock", "tool change", "contact", "unsigned torque", "wrapped angle", "stop"),
    *("constant torque", "length", "axis"),
)
"""Kinds of findings that hide all others: no model explains the torque."""

_CAUSES: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        # Times.
        "time unit": (
            "time is in {unit}{counter}",
            '[time] unit = "{symbol}" in a mapping file (--columns)',
        ),
        "rate: changes": (
            "the recorder changed its rate, or two recordings were joined",
            "cut it where the rate changes, with --between START,END",
        ),
        "rate: repeats": (
            "the source of {quantity} values is slower than the recorder",
            "--decimate {every} keeps the rows with new values",
        ),
        "rate: others": (
            "the recorder ran at another rate",
            "identify each by itself, or thin {faster} with --decimate {every}",
        ),
        "gap: long": (
            "the recorder stopped or rows were deleted",
            "--between {start:.12g},{end:.12g} takes the longest part without such a gap",
        ),
        "gap: rows": (
            "rows were lost",
            "none is needed for splines, the default smoothing; filters need a new recording",
        ),
        "jitter": (
            "rows were stamped when they arrived, not when they were measured",
            "--period {period:.6g} restores the times of an even clock",
        ),
        # Samples.
        "stale rows": (
            "the recorder polls faster than its source delivers, or messages were late",
            "--drop-stale leaves them out",
        ),
        "fixed joint": (
            "--fix, --tip or --base exclude a joint that the motion needs",
            "leave it free, or record the others with this joint at rest",
        ),
        "mimic joint": (
            "the file's multiplier or offset is not the arm's, or the joints have play",
            "compare <mimic> (or the equality) in the robot's file with the arm, or fix both"
            " joints and record with them at rest",
        ),
        "motionless joint": (
            "locked joints, a gripper that stood still, or columns of something else",
            "move them, or expect their own coefficients to be undetermined",
        ),
        "motionless joint: fixable": (
            "locked joints, a gripper that stood still, or columns of something else",
            "--fix {listed} if the joints are not to be identified; else move them",
        ),
        "constant torque": (
            "the torque of {joint} was not recorded",
            "record the torque of every joint",
        ),
        "clipping": (
            "the drive or the recorder limits the torque there: the motion had another one",
            "record a slower motion; --loss bisquare disregards what does not fit",
        ),
        "wrapped angle": (
            "the angle of {joint} is recorded modulo a turn",
            "unwrap its column, as numpy.unwrap does; the check has done so",
        ),
        "jump": (
            "rows were lost, and the times of the others were counted afterwards",
            "record again, or --between takes a part without jumps",
        ),
        "stop": (
            "{joint} ran against a stop, or another body",
            "keep the motion within the range that the arm has; exclude the rest with --between",
        ),
        "unsigned torque": (
            "the torque of {joint} is recorded without its sign",
            "record it with its sign: no setting restores it",
        ),
        "outliers: position": (
            "faults of transmission or of the sensor",
            "--despike replaces them by the median of their neighbours",
        ),
        "outliers: torque": (
            "faults of transmission or of the sensor",
            "--loss huber bounds what they do to the fit",
        ),
        # Columns.
        "sign": (
            "the sign of the {what} of {joint} is opposite to that in the robot's file",
            "{entries} in a mapping file (--columns)",
        ),
        "sign: of all joints": (
            "the sign of the {what} of all joints is opposite to that in the robot's file",
            "{entries} in a mapping file (--columns)",
        ),
        "swapped joints": (
            "the {what} of {pair} are swapped",
            "joints = {order} in a mapping file (--columns)",
        ),
        "swapped joints: of one quantity": (
            "the {what}s of {pair} are swapped",
            "[{what}] columns in the robot's order, in a mapping file (--columns)",
        ),
        "angle unit": (
            "positions are in degrees",
            '[position] unit = "deg" in a mapping file (--columns)',
        ),
        "angle unit: of one joint": (
            "the position of {joint} is in degrees",
            "name its column with its unit, as in q_{joint} [deg]",
        ),
        "torque unit: scale": (
            "torques are in mN m",
            '[torque] unit = "mN m" in a mapping file (--columns)',
        ),
        "torque unit: currents": (
            "the columns of torques are motor currents, or torques before the gears",
            '[torque] unit = "A", constant = [...], gear = [...] in a mapping file (--columns)',
        ),
        "torque lag": (
            "a filter or a delay between the two measurements",
            "identify with --torque-lag {lag:.4g}",
        ),
        # Motion and robot.
        "motion": (
            "the recording is too short or barely moves",
            "record a longer motion of all joints",
        ),
        "tame motion": (
            "the motion is too short or too uniform for so many coefficients",
            "record a longer motion of all joints at several speeds; --folds 3 lets short"
            " recordings choose settings",
        ),
        "limits": (
            "another robot, another zero position, or another unit",
            "compare the robot's file with the arm, and units and zero positions with the recorder",
        ),
        "robot file": (
            "a mistake in the masses or inertias of the robot's file",
            "correct the body in the robot's file, whose masses then help the fit",
        ),
        "wrong robot": (
            "the recording is of another robot, tool or mounting than the file's, or the model"
            " lacks a term",
            "compare the robot's file, its base, tip and gravity with the arm",
        ),
        # The model.
        "torque scale: of some joints": (
            "torque constants or gear ratios of some joints are others than the recorder took:"
            " {listed}",
            "[torque] unit, constant and gear in a mapping file (--columns)",
        ),
        "torque scale": (
            "the scale of the torques (torque constants, gear ratios), or the masses in the robot's"
            " file",
            "weigh a body that the arm carries with jaxcslc payload: its mass has the same factor",
        ),
        "torque limit": (
            "torques in another unit or scale, or limits in the robot's file that are not the"
            " arm's",
            "compare the recorder's units, torque constants and gear ratios with the arm",
        ),
        "model torque": (
            "a controller or a simulator computed these torques from a model of the arm",
            "record the motors' currents or measured torques: the fit finds the model, not the arm",
        ),
        "zero position": (
            "the zero of {joint} is not that of the robot's file: its positions are off by"
            " {offset}",
            "home the joint, or subtract {offset} from its column",
        ),
        "position scale": (
            "the gear ratio or the encoder ticks of {joint} are others than the recorder took",
            "divide its positions by {factor}",
        ),
        "mounting": (
            "the base is mounted in another way than in the robot's file",
            "set gravity to {gravity} m/s² in the robot's base frame (gravity in a TOML file,"
            " with_gravity in Python; in a URDF, turn the origin of the first joint)",
        ),
        "length": (
            "a length of the robot's file is not the arm's: {what} than in the file",
            "compare the joints' origins in the robot's file with the arm",
        ),
        "axis": (
            "the axis of {joint} in the robot's file is not the arm's",
            "set <axis> (or the DH rows) of {joint} to the axis that the arm turns about",
        ),
        "gravity compensation": (
            "the torques are those beyond gravity compensation: the controller subtracts a model's"
            " gravity",
            "record the motors' currents or torques themselves",
        ),
        "clock": (
            "the times are not those of the motion: the recorder counts with another period",
            "divide the times by {factor}",
        ),
        "drift": (
            "friction changes as the gears warm up, or the zero of the torque sensor drifts",
            "record after warming up, or identify parts of the recording with --between",
        ),
        "tool change": (
            "the arm took up or put down a tool or a payload",
            "--between {start:.4g},{end:.4g} takes the longer part alone",
        ),
        "contact": (
            "something touched the arm, or a brake or a limit acted",
            "identify the part before {start} s or after {end} s, with --between",
        ),
        # Other recordings.
        "payload": (
            "the arm carried another payload or tool",
            "identify {first} first, and the payload with jaxcslc payload",
        ),
        "friction": (
            "another temperature or state of the gears, or torques that the motors did not deliver",
            "--reidentify {groups} with the identification of {first}",
        ),
        "disagreement": (
            "another robot, another base, or joints and units in another order",
            "check it by itself, and identify it by itself",
        ),
    }
)


def finding(
    row: str, evidence: str, joint: str = "", /, *, recording: str = "", **values: Any
) -> Finding:
    """Return a finding whose cause and remedy are a row of the table.

    What stands before a colon is its kind; `values` are what cause and remedy name.

    >>> finding("clipping", "5 % of its torques are exactly 20", "elbow").kind
    'clipping'
    """
    cause, remedy = (text.format(**values) for text in _CAUSES[row])
    return Finding(row.partition(":")[0], joint, evidence, cause, remedy, recording)
