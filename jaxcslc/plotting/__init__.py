from ._budget_picture import budget_picture as budget_picture
from ._control_pictures import (
    control_error_picture as control_error_picture,
    joint_error_picture as joint_error_picture,
    traced_path_picture as traced_path_picture,
)
from ._friction_pictures import (
    friction_picture as friction_picture,
    hysteresis_picture as hysteresis_picture,
)
from ._generalisation_picture import generalisation_picture as generalisation_picture
from ._learning_pictures import Learning as Learning, learning_picture as learning_picture
from ._motor_pictures import (
    motor_curve_picture as motor_curve_picture,
    motor_response_picture as motor_response_picture,
)
from ._network_pictures import (
    decision_picture as decision_picture,
    fitted_curves_picture as fitted_curves_picture,
    overtraining_picture as overtraining_picture,
)
from ._payload_pictures import (
    PayloadCurve as PayloadCurve,
    Spread as Spread,
    hand_error_picture as hand_error_picture,
    payload_picture as payload_picture,
)
from ._pictures import save_picture as save_picture, torque_picture as torque_picture
from ._relearning_picture import relearning_picture as relearning_picture
from ._smoothing_pictures import (
    averaged_spline_picture as averaged_spline_picture,
    spline_subsets_picture as spline_subsets_picture,
)
from ._trajectory_pictures import (
    motion_picture as motion_picture,
    reversal_picture as reversal_picture,
)
