"""Estimators that use simulated motion: IDIM-IV, DIDIM, and prediction of motion.

    coefficients ──► simulated motion ──► equations ──► new coefficients
         ▲                                                   │
         └───────────────────────────────────────────────────┘

- `_estimators`: `InstrumentalVariables` (IDIM-IV) and `DirectDynamics` (DIDIM).
- `_simulation_fit`: the loop above, and a test of exogeneity.
- `_projected_equations`: two-stage least squares.
- `_simulated_motion`, `_simulation`: the arm under its controller or a correction, with friction.
- `_prediction`, `_poses`: errors of open-loop simulation, and poses of links.
"""

from ._estimators import (
    DirectDynamics as DirectDynamics,
    InstrumentalVariables as InstrumentalVariables,
)
from ._poses import link_poses as link_poses
from ._prediction import (
    HorizonError as HorizonError,
    file_coefficients as file_coefficients,
    prediction_error as prediction_error,
)
from ._simulated_motion import (
    AbstractSimulatedMotion as AbstractSimulatedMotion,
    ControlledMotion as ControlledMotion,
    CorrectedMotion as CorrectedMotion,
)
from ._simulation import simulate as simulate
from ._simulation_fit import ExogeneityTest as ExogeneityTest, SimulationFit as SimulationFit


__all__ = [
    "AbstractSimulatedMotion",
    "ControlledMotion",
    "CorrectedMotion",
    "DirectDynamics",
    "ExogeneityTest",
    "HorizonError",
    "InstrumentalVariables",
    "SimulationFit",
    "prediction_error",
]
