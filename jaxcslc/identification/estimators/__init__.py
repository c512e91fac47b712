from ._comparison import (
    Estimator as Estimator,
    EstimatorComparison as EstimatorComparison,
)
