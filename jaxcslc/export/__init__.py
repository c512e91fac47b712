"""Export of identified parameters: robot files and C code.

In: a network with an `Identification`. Out: a copy of the robot's file, or C99 source.

- `_robot_export`: entry points `export_robot` and `write_robot`.
- `_parameter_files`: text of URDF, MJCF and TOML files with other parameters.
- `_c_code`, `_rigid_body`: generated C, and its rigid-body part.
"""

from ._c_code import CCode as CCode, c_code as c_code, write_c as write_c
from ._parameter_files import (
    motor_file as motor_file,
    read_motor_inertias as read_motor_inertias,
    write_motor_inertias as write_motor_inertias,
)
from ._robot_export import (
    RobotExport as RobotExport,
    WrittenRobot as WrittenRobot,
    export_robot as export_robot,
    write_robot as write_robot,
)


__all__ = [
    "CCode",
    "RobotExport",
    "WrittenRobot",
    "c_code",
    "export_robot",
    "motor_file",
    "read_motor_inertias",
    "write_c",
    "write_motor_inertias",
    "write_robot",
]
