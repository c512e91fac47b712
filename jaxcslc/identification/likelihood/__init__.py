"""Maximum likelihood: positions and coefficients estimated together, without a smoothing.

```
recordings ──► problem, start ──► search ──► minimum ──► LikelihoodFit
               readings, equations   step, test, stages      standard errors
               what is known         on a sum of residual blocks
```
"""

from ._comparison import (
    Estimator as Estimator,
    EstimatorComparison as EstimatorComparison,
    estimator_text as estimator_text,
    lengths_line as lengths_line,
)
from ._left_out import LeftOut as LeftOut
from ._likelihood_fit import LikelihoodFit as LikelihoodFit, Misfit as Misfit
from ._maximum_likelihood import MaximumLikelihood as MaximumLikelihood
from ._signs import runs as runs
from ._spacing import NoiseExcitation as NoiseExcitation, SpacingChoice as SpacingChoice
from .torque import TorqueSampling as TorqueSampling
from .transmission import Transmission as Transmission, transmission_lines as transmission_lines
