from ._horizon import (
    HorizonError as HorizonError,
    applied_torque as applied_torque,
    file_coefficients as file_coefficients,
    prediction_error as prediction_error,
)
from ._poses import link_poses as link_poses
from ._simulation import State as State, held_step as held_step, simulate as simulate
