from ._c_code import CCode as CCode, c_code as c_code
from ._export_robot import (
    RobotExport as RobotExport,
    export_robot as export_robot,
    write_c as write_c,
)
from ._motor_file import (
    motor_file as motor_file,
    read_motor_inertias as read_motor_inertias,
    write_motor_inertias as write_motor_inertias,
)
from ._write_back import WrittenRobot as WrittenRobot, write_robot as write_robot
