from ._horizon import (
    HorizonError as HorizonError,
    file_coefficients as file_coefficients,
    prediction_error as prediction_error,
)
from ._poses import link_poses as link_poses
from ._simulation import simulate as simulate
