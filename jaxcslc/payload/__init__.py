from ._carrying_loop import CarryingLoop as CarryingLoop, CarryingState as CarryingState
from ._estimator import (
    PayloadEstimate as PayloadEstimate,
    PayloadEstimator as PayloadEstimator,
    PayloadState as PayloadState,
)
from ._noise import torque_noise as torque_noise
from ._offline import fit_payload as fit_payload
from ._payload_fit import PHYSICAL as PHYSICAL, PayloadFit as PayloadFit
from ._possible import possible_body as possible_body
