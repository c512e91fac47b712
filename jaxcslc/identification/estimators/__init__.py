from ._with_instruments import with_instruments as with_instruments
from ._with_likelihood import (
    EstimatorChoice as EstimatorChoice,
    check_estimator as check_estimator,
    with_likelihood as with_likelihood,
)
