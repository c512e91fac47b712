from ._compiled import (
    filled_up as filled_up,
    regressor_of as regressor_of,
)
from ._correlated import ERRORS as ERRORS, Errors as Errors, effective_counts as effective_counts
from ._equations import Equations as Equations, equations_of as equations_of
from ._factors import JointFactors as JointFactors, factorise as factorise
from ._fixed import Fixed as Fixed, Previous as Previous
from ._identification import Identification as Identification
from ._least_squares import (
    JointWeights as JointWeights,
    LeastSquares as LeastSquares,
)
from ._losses import LOSSES as LOSSES, Loss as Loss
from ._solution import RESULTS as RESULTS
