"""Learning rules for adaptive networks: perceptron rule, backpropagation, PERAL (thesis 3, 6, 7).

A CSLC, or any feedforward network, is trained from patterns instead of fitted by least squares.

     network, patterns --> examples --> train (plan: rules, rates, end) --> Training
                                          |
                                          +-- epoch: assess, choose a rule, learn

Modules, in reading order:

- `_network`: layers, links, and the network that they form.
- `_networks`: the CSLC and other networks as adaptive ones, and weights to start from.
- `_functions`: functions of nodes, and costs of errors.
- `_examples`: patterns as training takes them, and their normal equations.
- `_rules`: learning rules.
- `_plan`: schedule of rules, rates, and when to end.
- `_epoch`, `_train`: one epoch, a whole training, and its result.
- `_kernel_statements`, `_kernel`: CUDA kernels for many trainings side by side.
"""

from ._epoch import (
    ENDINGS as ENDINGS,
    OUTCOMES as OUTCOMES,
    History as History,
    Training as Training,
    TrainingState as TrainingState,
)
from ._examples import (
    Examples as Examples,
    NormalEquations as NormalEquations,
    examples as examples,
    normal_equations as normal_equations,
    with_normal_equations as with_normal_equations,
)
from ._functions import (
    HARD_LIMITER as HARD_LIMITER,
    HYPERBOLIC_TANGENT as HYPERBOLIC_TANGENT,
    LINEAR_COMBINER as LINEAR_COMBINER,
    LOGISTIC as LOGISTIC,
    Activation as Activation,
    Cost as Cost,
    decreasing as decreasing,
    half_rms as half_rms,
    half_square as half_square,
    mean_modulus as mean_modulus,
)
from ._kernel import batched_by as batched_by, summed_change as summed_change
from ._kernel_statements import RuleStatements as RuleStatements, rule_statements as rule_statements
from ._network import (
    AdaptiveNetwork as AdaptiveNetwork,
    ContextLayer as ContextLayer,
    Layer as Layer,
    Links as Links,
    Passage as Passage,
    PolynomialTerms as PolynomialTerms,
    RadialBasis as RadialBasis,
    Signals as Signals,
    Subnetwork as Subnetwork,
    network_order as network_order,
    order_per_output as order_per_output,
)
from ._networks import (
    InverseDynamicsInputs as InverseDynamicsInputs,
    Preprocessed as Preprocessed,
    RegressorInputs as RegressorInputs,
    fully_connected as fully_connected,
    inverse_dynamics as inverse_dynamics,
    linear_combiner as linear_combiner,
    subnetwork_masks as subnetwork_masks,
)
from ._plan import (
    AbstractRates as AbstractRates,
    AdaptedRates as AdaptedRates,
    FixedRates as FixedRates,
    Plan as Plan,
    Schedule as Schedule,
    SwitchWhen as SwitchWhen,
)
from ._rules import (
    PERAL as PERAL,
    AbstractRule as AbstractRule,
    Backpropagation as Backpropagation,
    IdealPERAL as IdealPERAL,
    PerceptronRule as PerceptronRule,
    Presentation as Presentation,
    check_sign_rank as check_sign_rank,
)
from ._train import train as train, training_steps as training_steps


__all__ = [
    "ENDINGS",
    "HARD_LIMITER",
    "HYPERBOLIC_TANGENT",
    "LINEAR_COMBINER",
    "LOGISTIC",
    "OUTCOMES",
    "PERAL",
    "AbstractRates",
    "AbstractRule",
    "Activation",
    "AdaptedRates",
    "AdaptiveNetwork",
    "Backpropagation",
    "ContextLayer",
    "Cost",
    "Examples",
    "FixedRates",
    "History",
    "IdealPERAL",
    "InverseDynamicsInputs",
    "Layer",
    "Links",
    "NormalEquations",
    "Passage",
    "PerceptronRule",
    "Plan",
    "PolynomialTerms",
    "Preprocessed",
    "Presentation",
    "RadialBasis",
    "RegressorInputs",
    "Schedule",
    "Signals",
    "Subnetwork",
    "SwitchWhen",
    "Training",
    "TrainingState",
    "check_sign_rank",
    "decreasing",
    "examples",
    "fully_connected",
    "half_rms",
    "half_square",
    "inverse_dynamics",
    "linear_combiner",
    "mean_modulus",
    "network_order",
    "normal_equations",
    "order_per_output",
    "subnetwork_masks",
    "train",
    "training_steps",
    "with_normal_equations",
]
