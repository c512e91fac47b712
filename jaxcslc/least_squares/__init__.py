"""Least-squares fits of torque equations, which are linear in the coefficients.

In: a network and patterns (motion and torque). Out: an `Identification`: coefficients,
covariance, and what the patterns do not determine.

    patterns ──► columns ──► equations ──► triangular factors ──► minimum ──► errors
                 _compiled   _equations    _factors, _streaming   _minimum    _standard_errors

- `_settings`: from a recording to coefficients; `_least_squares`: the estimator and its options.
- `_identification`: the result.
- `_equations`, `_factors`, `_minimum`: equations, one triangle per joint, and the solution.
- `_rows`, `_standard_errors`, `_losses`: a second pass for errors and robust losses.
- `_preconditioned`, `_streaming`, `_sharded`, `_cluster`: long recordings, devices, machines.
- `_kernel`, `_host_kernel`, `_products`: generated code that multiplies columns.
"""

from ._cluster import (
    Derivation as Derivation,
    Fleet as Fleet,
    Work as Work,
    block_factors as block_factors,
    fit_fleet_on_cluster as fit_fleet_on_cluster,
    fit_on_cluster as fit_on_cluster,
)
from ._compiled import (
    HostColumns as HostColumns,
    columns_of as columns_of,
    computed_on_host as computed_on_host,
    filled_up as filled_up,
    regressor_of as regressor_of,
    rows_of as rows_of,
    torque_by as torque_by,
    torque_of as torque_of,
    traced as traced,
)
from ._correction import (
    corrected as corrected,
    needs_correction as needs_correction,
    residual_sums as residual_sums,
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
from ._host_kernel import host_kernel_of as host_kernel_of
from ._identification import (
    MEANINGLESS_CONDITION as MEANINGLESS_CONDITION,
    RESULTS as RESULTS,
    Identification as Identification,
)
from ._kernel import gram_kernel as gram_kernel
from ._least_squares import LeastSquares as LeastSquares
from ._losses import Loss as Loss, robust_weights as robust_weights
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
from ._preconditioned import Preconditioner as Preconditioner, factors_of as factors_of
from ._products import (
    fused_gram_matrices as fused_gram_matrices,
    fused_kernel_of as fused_kernel_of,
    packed_inverses as packed_inverses,
    unpacked_products as unpacked_products,
)
from ._rows import CosineSums as CosineSums, KeptRows as KeptRows, PatternRows as PatternRows
from ._settings import (
    Settings as Settings,
    reidentify as reidentify,
    settings_document as settings_document,
    settings_from as settings_from,
    static_friction_joints as static_friction_joints,
)
from ._sharded import shard_patterns as shard_patterns
from ._standard_errors import (
    ERRORS as ERRORS,
    Errors as Errors,
    components_for as components_for,
    correlated_covariance as correlated_covariance,
    effective_counts as effective_counts,
)
from ._weighted_equations import WeightedEquations as WeightedEquations, changes_of as changes_of


__all__ = [
    "RESULTS",
    "Errors",
    "Fixed",
    "Fleet",
    "Identification",
    "JointWeights",
    "LeastSquares",
    "Loss",
    "Previous",
    "Settings",
    "fit_fleet_on_cluster",
    "fit_on_cluster",
    "reidentify",
    "settings_document",
    "settings_from",
    "shard_patterns",
]
