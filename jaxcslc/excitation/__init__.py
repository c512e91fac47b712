from ._criteria import (
    CRITERIA as CRITERIA,
    EXPLANATIONS as EXPLANATIONS,
    wanted_indices as wanted_indices,
)
from ._design import (
    FAMILIES as FAMILIES,
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
from ._information import MotionInformation as MotionInformation, Prediction as Prediction
from ._knowledge import Knowledge as Knowledge
from ._limits import Limits as Limits, Surroundings as Surroundings, load_limits as load_limits
from ._noise import Noise as Noise
from ._output import design_files as design_files, save_design as save_design
from ._result import Design as Design
from ._task import random_parameters as random_parameters
