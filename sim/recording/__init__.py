from sim.recording._closed_loop import ClosedLoop as ClosedLoop, close_loop as close_loop
from sim.recording._film import film as film
from sim.recording._linearity import (
    MotorLinearity as MotorLinearity,
    motor_linearity as motor_linearity,
)
from sim.recording._mask_quality import MaskQuality as MaskQuality, mask_quality as mask_quality
from sim.recording._record import Job as Job, record as record, record_each as record_each
from sim.recording._scene import Scene as Scene
