from ._c_code import CCode as CCode, c_code as c_code
from ._write_back import WrittenRobot as WrittenRobot, write_robot as write_robot
