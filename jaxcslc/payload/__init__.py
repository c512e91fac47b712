from ._compensation import (
    PayloadCompensation as PayloadCompensation,
    PayloadCompensationState as PayloadCompensationState,
)
from ._estimator import (
    PayloadEstimate as PayloadEstimate,
    PayloadEstimator as PayloadEstimator,
    PayloadState as PayloadState,
)
from ._noise import torque_noise as torque_noise
from ._possible_body import possible_body as possible_body
