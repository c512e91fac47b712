from ._compiled import (
    HostColumns as HostColumns,
    columns_in as columns_in,
    columns_of as columns_of,
    computed_on_host as computed_on_host,
    filled_up as filled_up,
    regressor_of as regressor_of,
    rows_of as rows_of,
    stretches_of as stretches_of,
    torque_by as torque_by,
    torque_of as torque_of,
    traced as traced,
)
from ._equations import (
    Equations as Equations,
    equations_of as equations_of,
    pattern_factors as pattern_factors,
)
from ._factors import (
    JointFactors as JointFactors,
    Unknowns as Unknowns,
    factorise as factorise,
    joined_factors as joined_factors,
    triangle_of as triangle_of,
)
from ._fixed import Fixed as Fixed, Previous as Previous
from ._friction_at_rest import friction_averaged_at_rest as friction_averaged_at_rest
from ._gauss_newton import gauss_newton as gauss_newton, settled as settled
from ._identification import (
    MEANINGLESS_CONDITION as MEANINGLESS_CONDITION,
    RESULTS as RESULTS,
    Identification as Identification,
    result_of as result_of,
)
from ._least_squares import LeastSquares as LeastSquares
from ._losses import LOSSES as LOSSES, Loss as Loss, robust_scale as robust_scale, weight as weight
from ._minimum import (
    FoldFit as FoldFit,
    JointWeights as JointWeights,
    Solution as Solution,
    fold_coefficients as fold_coefficients,
    minimum as minimum,
    minimum_coefficients as minimum_coefficients,
    residual_weights as residual_weights,
    weighted_minimum as weighted_minimum,
)
from ._robust import robust_weights as robust_weights
from ._standard_errors import (
    ERRORS as ERRORS,
    Errors as Errors,
    components_for as components_for,
    correlated_covariance as correlated_covariance,
    effective_counts as effective_counts,
)
from ._weighted_equations import (
    WeightedEquations as WeightedEquations,
    changes_of as changes_of,
)
from .many import (
    Preconditioner as Preconditioner,
    corrected as corrected,
    factors_of as factors_of,
    factors_of_stream as factors_of_stream,
    needs_correction as needs_correction,
    residual_sums as residual_sums,
    shard_patterns as shard_patterns,
)
from .second_pass import CosineSums as CosineSums, KeptRows as KeptRows
