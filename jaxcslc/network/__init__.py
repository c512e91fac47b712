from ._cslc import CSLC as CSLC
from ._derive import derive as derive
from ._evaluator import AbstractEvaluator as AbstractEvaluator
from ._friction import FrictionTerm as FrictionTerm, friction_terms as friction_terms
from ._inputs import input_layer as input_layer
from ._payload import PAYLOAD as PAYLOAD, carrier as carrier
from ._recursive import RecursiveEvaluator as RecursiveEvaluator
from ._tables import TableEvaluator as TableEvaluator
