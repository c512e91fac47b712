"""Examples: small robots for docstrings, and whole arms with files to try the command on.

- `_arms`: pendulum, turntable and planar arm, and exact motions of them; robot files, and simulated
  logs with noise, written by `jaxcslc example`.
- `_servo_arm`: the same of an arm of position servos.
"""

from ._arms import (
    ARMS as ARMS,
    Example as Example,
    pendulum as pendulum,
    planar_arm as planar_arm,
    read_truth as read_truth,
    swing as swing,
    swing_recording as swing_recording,
    tank as tank,
    turntable as turntable,
    write_example as write_example,
)


__all__ = [
    "ARMS",
    "Example",
    "pendulum",
    "planar_arm",
    "read_truth",
    "swing",
    "swing_recording",
    "tank",
    "turntable",
    "write_example",
]
