"""Least-squares fits of torque equations, which are linear in the coefficients.

In: a network and patterns (motion and torque). Out: an `Identification`: coefficients,
covariance, and what the patterns do not determine.

    patterns ─┬─► columns ──► equations ──► triangles ─┬─► joined ──► minimum ──► errors
              │   _columns    _equations    _factors   │   _factors   _minimum    _errors
              └─► blocks ───► products ──► triangles ──┘
                  _blocks     _products

There are four routes to one triangle per joint. `_factors` factorises short recordings on the host.
`_host_kernel` multiplies columns of long ones on the host, and `_gpu_kernel` or JAX on a device.
Triangles are joined. Streams, shards, files of a cluster and folds are other blocks; filtered and
weighted equations are other rows.

- `_columns` also finds columns of which nothing but rounding is left.
- `_settings`: from a recording to coefficients; `_least_squares`: the estimator and its options.
- `_identification`: the result.
- `_errors`, `_losses`: a second pass over the equations, for correlated errors and robust losses.
- `_cluster`: recordings of many files, on many machines.
"""

from ._blocks import (
    pattern_factors as pattern_factors,
    shard_patterns as shard_patterns,
)
from ._cluster import (
    Derivation as Derivation,
    Fleet as Fleet,
    Work as Work,
    block_factors as block_factors,
    fit_fleet_on_cluster as fit_fleet_on_cluster,
    fit_on_cluster as fit_on_cluster,
)
from ._columns import (
    HostColumns as HostColumns,
    check_joints as check_joints,
    columns_of as columns_of,
    computed_on_host as computed_on_host,
    friction_averaged_at_rest as friction_averaged_at_rest,
    masked_rms as masked_rms,
    regressor_of as regressor_of,
    rows_of as rows_of,
    torque_by as torque_by,
    torque_of as torque_of,
    traced as traced,
)
from ._equations import (
    Equations as Equations,
    dense_factors as dense_factors,
    equations_of as equations_of,
    unknowns_of as unknowns_of,
)
from ._errors import (
    ERRORS as ERRORS,
    LEAST_LEFT as LEAST_LEFT,
    CosineSums as CosineSums,
    Errors as Errors,
    Rows as Rows,
    components_for as components_for,
    correlated_covariance as correlated_covariance,
    effective_counts as effective_counts,
)
from ._factors import (
    JointFactors as JointFactors,
    Unknowns as Unknowns,
    joined_factors as joined_factors,
    triangle_of as triangle_of,
)
from ._gpu_kernel import (
    fused_gram_matrices as fused_gram_matrices,
    fused_kernel_of as fused_kernel_of,
    gram_kernel as gram_kernel,
    packed_inverses as packed_inverses,
    unpacked_products as unpacked_products,
)
from ._host_kernel import host_kernel_of as host_kernel_of
from ._identification import (
    MEANINGLESS_CONDITION as MEANINGLESS_CONDITION,
    RESULTS as RESULTS,
    Identification as Identification,
)
from ._least_squares import (
    LeastSquares as LeastSquares,
    WeightedEquations as WeightedEquations,
    changes_of as changes_of,
    gauss_newton as gauss_newton,
    settled as settled,
)
from ._losses import (
    Loss as Loss,
    robust_weights as robust_weights,
    weights_of_scales as weights_of_scales,
)
from ._minimum import (
    UNDETERMINED_SHARE as UNDETERMINED_SHARE,
    Fixed as Fixed,
    FoldFit as FoldFit,
    JointWeights as JointWeights,
    Previous as Previous,
    Solution as Solution,
    fold_coefficients as fold_coefficients,
    hidden_noise as hidden_noise,
    joint_weights_of as joint_weights_of,
    minimum as minimum,
    minimum_coefficients as minimum_coefficients,
    residual_weights as residual_weights,
    weights_by_residual as weights_by_residual,
)
from ._products import (
    Preconditioner as Preconditioner,
    corrected as corrected,
    factors_of as factors_of,
    kernel_of as kernel_of,
    needs_correction as needs_correction,
    residual_sums as residual_sums,
)
from ._settings import (
    Settings as Settings,
    reidentify as reidentify,
    settings_document as settings_document,
    settings_from as settings_from,
    static_friction_joints as static_friction_joints,
)


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
