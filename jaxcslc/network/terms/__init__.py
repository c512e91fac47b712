from ._evaluator import AbstractEvaluator as AbstractEvaluator
from ._friction import (
    FrictionTerm as FrictionTerm,
    coupling_matrix as coupling_matrix,
    friction_coefficients as friction_coefficients,
    friction_inputs as friction_inputs,
    friction_regressor as friction_regressor,
    friction_rows as friction_rows,
    friction_terms as friction_terms,
    friction_torque as friction_torque,
    static_slopes as static_slopes,
)
from ._inputs import input_layer as input_layer
from ._link_values import coefficient_values as coefficient_values
from ._payload import (
    PAYLOAD as PAYLOAD,
    carrier as carrier,
    payload_coefficients as payload_coefficients,
    payload_evaluator as payload_evaluator,
)
from ._recursive import RecursiveEvaluator as RecursiveEvaluator
from ._tables import TableEvaluator as TableEvaluator
