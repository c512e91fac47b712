"""Arms of position servos: identification from commands and positions, without a torque signal.

     command, position --> ServoRecording --> identify_servo --> ServoFit --> drives, errors
                                                                 |
                                              command --> simulate --> position

Modules, in reading order:

- `_recording`: commands and positions, sampled in time.
- `_readers`, `_lerobot`: recordings from tables, bags and folders of data sets.
- `_drive`: the parameters of a servo and its joint.
- `_simulation`, `servo.c`: positions from commands; loads of one joint.
- `_fit`: the result of a fit.
"""

from ._drive import (
    DRIVE_UNITS as DRIVE_UNITS,
    TORQUES as TORQUES,
    ServoDrive as ServoDrive,
)
from ._fit import (
    ConfoundedParameters as ConfoundedParameters,
    ServoFit as ServoFit,
    ServoParameter as ServoParameter,
)
from ._readers import (
    load_servo_recording as load_servo_recording,
    load_servo_recordings as load_servo_recordings,
)
from ._recording import ServoRecording as ServoRecording
from ._simulation import LONGEST_STEP as LONGEST_STEP, simulate as simulate


__all__ = [
    "DRIVE_UNITS",
    "LONGEST_STEP",
    "TORQUES",
    "ConfoundedParameters",
    "ServoDrive",
    "ServoFit",
    "ServoParameter",
    "ServoRecording",
    "load_servo_recording",
    "load_servo_recordings",
    "simulate",
]
