from ._costs import (
    Cost as Cost,
    half_rms as half_rms,
    half_square as half_square,
    mean_modulus as mean_modulus,
)
from ._delta_rules import Backpropagation as Backpropagation, PerceptronRule as PerceptronRule
from ._epoch import Record as Record, State as State
from ._examples import Examples as Examples, examples as examples
from ._history import (
    ENDINGS as ENDINGS,
    OUTCOMES as OUTCOMES,
    History as History,
    Training as Training,
)
from ._normal_equations import (
    NormalEquations as NormalEquations,
    normal_equations as normal_equations,
    with_normal_equations as with_normal_equations,
)
from ._peral import PERAL as PERAL, IdealPERAL as IdealPERAL, check_sign_rank as check_sign_rank
from ._plan import Plan as Plan, Schedule as Schedule
from ._pruning import LinkEnds as LinkEnds, Pruning as Pruning, prune as prune
from ._rates import (
    AbstractRates as AbstractRates,
    AdaptedRates as AdaptedRates,
    FixedRates as FixedRates,
)
from ._rules import AbstractRule as AbstractRule
from ._switching import SwitchWhen as SwitchWhen
from ._train import train as train, training_steps as training_steps
