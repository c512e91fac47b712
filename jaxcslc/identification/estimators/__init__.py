from ._calibration import calibrated as calibrated
from ._checks import EstimatorChoice as EstimatorChoice, check_estimator as check_estimator
from ._with_instruments import with_instruments as with_instruments
from ._with_likelihood import with_likelihood as with_likelihood
