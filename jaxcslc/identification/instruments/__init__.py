from ._direct_dynamics import DirectDynamics as DirectDynamics
from ._exogeneity import ExogeneityTest as ExogeneityTest
from ._instrumental_variables import InstrumentalVariables as InstrumentalVariables
from ._simulated_motion import (
    AbstractSimulatedMotion as AbstractSimulatedMotion,
    ControlledMotion as ControlledMotion,
    CorrectedMotion as CorrectedMotion,
)
from ._simulation_fit import SimulationFit as SimulationFit
