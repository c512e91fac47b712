from ._closed_loop import ClosedLoop as ClosedLoop, close_loop as close_loop
from ._film import film as film
from ._linearity import MotorLinearity as MotorLinearity, motor_linearity as motor_linearity
from ._mask_quality import MaskQuality as MaskQuality, mask_quality as mask_quality
from ._record import Job as Job, record as record, record_each as record_each
from ._scene import Scene as Scene
