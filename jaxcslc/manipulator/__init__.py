"""Description of a robot: kinematics, inertial terms, friction model, limits; readers of files.

`load_robot` reads TOML, URDF or MJCF; `Manipulator.from_modified_dh` takes rows of parameters.
Either gives a `Manipulator`, all that `jaxcslc.derivation` needs to know of a robot.

     TOML ------------------------------------------+
     URDF, MJCF --> MuJoCo --> part --> placement --+--> Manipulator --> derivation
                                        (mod. DH)

Modules, in reading order:

- `_joint`: one row of modified Denavit-Hartenberg parameters, lengths, numberings; errors.
- `_link_parameters`: inertial terms of a link, and measurable parameters of links and motors.
- `_friction`: names of friction terms, coupled joints, and their checks.
- `_manipulator`: the robot itself, and the file that it was read from.
- `_placement`: frames of links at a pose, and modified Denavit-Hartenberg rows of any axes.
- `files`: readers of robot files, and the bundled robots.
"""

from ._friction import (
    FRICTION_TERMS as FRICTION_TERMS,
    STATIC_SLOPE as STATIC_SLOPE,
    Coupling as Coupling,
    check_friction as check_friction,
)
from ._joint import (
    Joint as Joint,
    Length as Length,
    Numbering as Numbering,
    RobotError as RobotError,
    Subnumbering as Subnumbering,
)
from ._link_parameters import (
    TENSOR_ENTRIES as TENSOR_ENTRIES,
    LinkInertia as LinkInertia,
    LinkParameters as LinkParameters,
    fixed_together as fixed_together,
    motor_inertia as motor_inertia,
    seen_from as seen_from,
)
from ._manipulator import (
    JointLimits as JointLimits,
    Manipulator as Manipulator,
    Mimic as Mimic,
    Mimics as Mimics,
    Source as Source,
)
from ._placement import (
    Axis as Axis,
    LinkPoses as LinkPoses,
    joint_lines as joint_lines,
    link_poses as link_poses,
    modified_dh as modified_dh,
    steps_at_zero as steps_at_zero,
)
from .files import (
    START_TAG as START_TAG,
    UNUSED_LINKS as UNUSED_LINKS,
    Element as Element,
    load_robot as load_robot,
    mujoco_spec as mujoco_spec,
    panda as panda,
    parse_xml as parse_xml,
    puma560 as puma560,
    read_xml as read_xml,
    tx40 as tx40,
)


__all__ = [
    "FRICTION_TERMS",
    "STATIC_SLOPE",
    "Axis",
    "Coupling",
    "Element",
    "Joint",
    "JointLimits",
    "Length",
    "LinkInertia",
    "LinkParameters",
    "Manipulator",
    "Mimic",
    "Mimics",
    "Numbering",
    "RobotError",
    "Source",
    "Subnumbering",
    "fixed_together",
    "joint_lines",
    "link_poses",
    "load_robot",
    "modified_dh",
    "motor_inertia",
    "panda",
    "parse_xml",
    "puma560",
    "read_xml",
    "seen_from",
    "tx40",
]
