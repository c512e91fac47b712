"""Recordings of many simulated machines, and what is made of them.

- `_record`: many recordings in one call, and their files.
- `_closed_loop`: recordings with observations of the controller.
- `_film`, `_linearity`, `_mask_quality`: films, linearity of motors, quality of masks.
"""

from sim.recording._closed_loop import ClosedLoop as ClosedLoop, close_loop as close_loop
from sim.recording._film import Scene as Scene, film as film
from sim.recording._linearity import (
    MotorLinearity as MotorLinearity,
    motor_linearity as motor_linearity,
)
from sim.recording._mask_quality import MaskQuality as MaskQuality, mask_quality as mask_quality
from sim.recording._record import Job as Job, record as record, record_each as record_each
