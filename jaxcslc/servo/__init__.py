"""Arms of position servos: identification from commands and positions, without a torque signal.

     command, position --> ServoRecording --> identify_servo --> ServoFit --> drives, errors
                                                                 |
                                              command --> simulate --> position

Modules, in reading order:

- `_recording`: commands and positions, sampled in time.
- `_readers`, `_lerobot`: recordings from tables, bags and folders of data sets.
- `_drive`: the parameters of a servo and its joint.
- `_table`: a table on which the hand may lean.
- `_simulation`, `joint.c`, `arm.c`: positions from commands; loads of one joint.
- `_search`: unknowns of a joint, and least squares of its simulated positions.
- `_start`: where the search starts: a regression of the whole arm.
- `_sensitivity`: derivatives of all joints' positions with respect to all unknowns.
- `_intervals`: covariance of all unknowns, and intervals of the parameters.
- `_identifiability`: what recordings cannot tell apart, and what would.
- `_base`, `_check`: whether the base moved; the same before anything is identified.
- `_current`: currents as readings of the torque.
- `_fit`: `identify_servo` and its result.
- `_mjcf`: MuJoCo models of an arm of servos, and replay of commands in them.
- `_feedforward`: commands for a wanted motion, in C.
- `_results`: a report on it: text, JSON, a page, and files for simulators.
"""

from ._check import check_servos as check_servos
from ._current import CurrentGain as CurrentGain
from ._drive import (
    DRIVE_UNITS as DRIVE_UNITS,
    TORQUES as TORQUES,
    ServoDrive as ServoDrive,
)
from ._feedforward import servo_feedforward as servo_feedforward
from ._fit import (
    ESTIMATED as ESTIMATED,
    MASS_ERROR as MASS_ERROR,
    ServoFit as ServoFit,
    identify_servo as identify_servo,
)
from ._identifiability import ConfoundedParameters as ConfoundedParameters
from ._intervals import ServoParameter as ServoParameter
from ._mjcf import (
    WrittenServoArm as WrittenServoArm,
    replay_in_mujoco as replay_in_mujoco,
    write_servo_mjcf as write_servo_mjcf,
)
from ._readers import (
    load_servo_recording as load_servo_recording,
    load_servo_recordings as load_servo_recordings,
)
from ._recording import ServoRecording as ServoRecording
from ._results import (
    SERVO_FILES as SERVO_FILES,
    ServoReport as ServoReport,
    servo_report as servo_report,
)
from ._simulation import LONGEST_STEP as LONGEST_STEP, simulate as simulate
from ._table import Table as Table


__all__ = [
    "DRIVE_UNITS",
    "ESTIMATED",
    "LONGEST_STEP",
    "MASS_ERROR",
    "TORQUES",
    "ConfoundedParameters",
    "CurrentGain",
    "ServoDrive",
    "ServoFit",
    "ServoParameter",
    "ServoRecording",
    "ServoReport",
    "Table",
    "WrittenServoArm",
    "check_servos",
    "identify_servo",
    "load_servo_recording",
    "load_servo_recordings",
    "replay_in_mujoco",
    "servo_feedforward",
    "servo_report",
    "simulate",
    "write_servo_mjcf",
]
