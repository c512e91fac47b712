from ._carrying_loop import CarryingLoop as CarryingLoop, CarryingState as CarryingState
from ._estimator import (
    PayloadEstimate as PayloadEstimate,
    PayloadEstimator as PayloadEstimator,
    PayloadState as PayloadState,
)
from ._noise import torque_noise as torque_noise
from ._possible import possible_body as possible_body
