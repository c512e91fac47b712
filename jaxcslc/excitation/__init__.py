"""Design of the motion to record: the motion that predicts the smallest standard errors.

     network, limits, noise, knowledge --> Planner --> Search --> DenseCheck --> Design --> files
                                            |            ^
                             family, goal --+            +-- information of a motion

`design_motion` is the entry. The criterion is minimised under all limits. Then the motion is
scaled until a dense check finds every limit kept.

Modules, in reading order:

- `_limits`: limits of joints, and surroundings.
- `_families`: joint motions that are linear in their parameters.
- `_information`: noise, information of a motion about coefficients, and predicted errors.
- `_feasibility`: use of limits at all times.
- `_criteria`: criteria, prior knowledge, and motion to predict.
- `_collision`: distances of bodies.
- `_search`: the augmented Lagrangian.
- `_design`: planner and designs; `_output`: files and page of a design.
"""

from ._collision import CollisionBodies as CollisionBodies
from ._criteria import (
    CRITERIA as CRITERIA,
    EXPLANATIONS as EXPLANATIONS,
    Goal as Goal,
    Knowledge as Knowledge,
    random_parameters as random_parameters,
    wanted_indices as wanted_indices,
)
from ._design import (
    FAMILIES as FAMILIES,
    Effort as Effort,
    Planner as Planner,
    design_motion as design_motion,
    family_named as family_named,
)
from ._families import (
    AbstractFamily as AbstractFamily,
    BSplines as BSplines,
    FourierSeries as FourierSeries,
    MinimumJerkMoves as MinimumJerkMoves,
)
from ._feasibility import DenseCheck as DenseCheck, Use as Use
from ._information import (
    MotionInformation as MotionInformation,
    Noise as Noise,
    Prediction as Prediction,
    coefficient_sizes as coefficient_sizes,
)
from ._limits import Limits as Limits, Surroundings as Surroundings, load_limits as load_limits
from ._output import Design as Design, design_files as design_files, save_design as save_design


__all__ = [
    "CRITERIA",
    "EXPLANATIONS",
    "FAMILIES",
    "AbstractFamily",
    "BSplines",
    "DenseCheck",
    "Design",
    "Effort",
    "FourierSeries",
    "Goal",
    "Knowledge",
    "Limits",
    "MinimumJerkMoves",
    "MotionInformation",
    "Noise",
    "Planner",
    "Prediction",
    "Surroundings",
    "Use",
    "design_files",
    "design_motion",
    "family_named",
    "load_limits",
    "random_parameters",
    "save_design",
    "wanted_indices",
]
