from ._checks import (
    EstimatorChoice as EstimatorChoice,
    check_estimator as check_estimator,
    within_memory as within_memory,
)
from ._likelihood_fits import fits_beside as fits_beside
from ._with_instruments import with_instruments as with_instruments
from ._with_likelihood import with_likelihood as with_likelihood
