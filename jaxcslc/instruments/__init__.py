"""Estimators that use simulated motion: IDIM-IV, DIDIM, and prediction of motion.

    coefficients ──► simulated motion ──► equations ──► new coefficients
         ▲                                                   │
         └───────────────────────────────────────────────────┘

- `_estimators`: `InstrumentalVariables` (IDIM-IV) and `DirectDynamics` (DIDIM), by the loop above.
- `_simulation`: the arm without feedback, under its controller or with a correction.
- `_prediction`: errors of open-loop simulation, and poses of links.
"""

from ._estimators import (
    DirectDynamics as DirectDynamics,
    ExogeneityTest as ExogeneityTest,
    InstrumentalVariables as InstrumentalVariables,
    SimulationFit as SimulationFit,
)
from ._prediction import (
    HorizonError as HorizonError,
    file_coefficients as file_coefficients,
    prediction_error as prediction_error,
)
from ._simulation import (
    AbstractSimulatedMotion as AbstractSimulatedMotion,
    ControlledMotion as ControlledMotion,
    CorrectedMotion as CorrectedMotion,
    simulate as simulate,
)


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
    "simulate",
]
