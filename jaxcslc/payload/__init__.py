from ._compensation import (
    PayloadCompensation as PayloadCompensation,
    PayloadCompensationState as PayloadCompensationState,
)
from ._estimator import PayloadEstimator as PayloadEstimator
from ._noise import torque_noise as torque_noise
from ._payload_state import PayloadEstimate as PayloadEstimate, PayloadState as PayloadState
from ._possible_body import possible_body as possible_body
