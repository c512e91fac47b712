from ._activations import (
    HARD_LIMITER as HARD_LIMITER,
    HYPERBOLIC_TANGENT as HYPERBOLIC_TANGENT,
    LINEAR_COMBINER as LINEAR_COMBINER,
    LOGISTIC as LOGISTIC,
    Activation as Activation,
    decreasing as decreasing,
)
from ._build import Preprocessed as Preprocessed, fully_connected as fully_connected
from ._compact import compact as compact
from ._inverse_dynamics import (
    InverseDynamicsInputs as InverseDynamicsInputs,
    inverse_dynamics as inverse_dynamics,
    signed_start as signed_start,
    subnetwork_masks as subnetwork_masks,
)
from ._layers import ContextLayer as ContextLayer, Layer as Layer
from ._linear_combiner import (
    RegressorInputs as RegressorInputs,
    linear_combiner as linear_combiner,
)
from ._links import Links as Links
from ._network import (
    AdaptiveNetwork as AdaptiveNetwork,
    Passage as Passage,
    Signals as Signals,
    Subnetwork as Subnetwork,
)
from ._order import network_order as network_order, order_per_output as order_per_output
from ._preprocessing import PolynomialTerms as PolynomialTerms, RadialBasis as RadialBasis
