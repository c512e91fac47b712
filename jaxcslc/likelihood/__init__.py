"""Maximum likelihood: positions are estimated along with the coefficients.

recordings ──► problem, start ──► search: step, test, stages ──► fit, errors

- `_problem`, `_readings`: what is known, and where a search starts.
- `_blocks`, `_laws`, `_objective`: residual blocks (readings, equations of motion, rest, reversals,
  priors), and the sum of them.
- `_equations`, `_joint_friction`, `_pre_sliding_equations`: equations of motion with derivatives.
- `_equation_sums`, `_banded_solver`: elimination in time with a border.
- `_search`, `_search_state`, `_levenberg`: the search.
- `_likelihood_fit`, `_comparison`: the result and its uncertainty.
"""

from ._banded_solver import Spectrum as Spectrum, solved as solved
from ._blocks import ConstantBlock as ConstantBlock, Normal as Normal
from ._comparison import (
    Estimator as Estimator,
    EstimatorComparison as EstimatorComparison,
    LeftOut as LeftOut,
    estimator_text as estimator_text,
    presliding_line as presliding_line,
)
from ._equation_sums import (
    JointColumns as JointColumns,
    add_equations as add_equations,
    equation_changes as equation_changes,
    equation_gradients as equation_gradients,
)
from ._equations import (
    AbstractEquations as AbstractEquations,
    EquationPoint as EquationPoint,
    Linearisation as Linearisation,
    MotionEquations as MotionEquations,
)
from ._likelihood_fit import (
    LikelihoodFit as LikelihoodFit,
    Misfit as Misfit,
    RowSums as RowSums,
    border_errors as border_errors,
    eliminated_rows as eliminated_rows,
)
from ._maximum_likelihood import MaximumLikelihood as MaximumLikelihood
from ._point import Point as Point, Step as Step
from ._pre_sliding_equations import PreSlidingEquations as PreSlidingEquations
from ._problem import LikelihoodProblem as LikelihoodProblem, SearchStart as SearchStart
from ._readings import (
    TorqueRecord as TorqueRecord,
    TorqueSampling as TorqueSampling,
    triangle_mean as triangle_mean,
)
from ._search import Minimum as Minimum, search as search, search_on as search_on
from ._search_state import SearchState as SearchState
from ._signs import runs as runs
from ._spacing import NoiseExcitation as NoiseExcitation, SpacingChoice as SpacingChoice


__all__ = [
    "Estimator",
    "EstimatorComparison",
    "LikelihoodFit",
    "MaximumLikelihood",
    "Misfit",
    "NoiseExcitation",
    "SpacingChoice",
    "TorqueSampling",
]
