from ._cslc import CSLC as CSLC
from ._derive import derive as derive
from .terms import (
    PAYLOAD as PAYLOAD,
    AbstractEvaluator as AbstractEvaluator,
    FrictionTerm as FrictionTerm,
    RecursiveEvaluator as RecursiveEvaluator,
    TableEvaluator as TableEvaluator,
    carrier as carrier,
    friction_terms as friction_terms,
    input_layer as input_layer,
)
