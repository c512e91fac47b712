"""Identification of systems that are not manipulators (thesis 8.2.5, C.2).

    equations ──► System ──► separation ──► network ──► identify_system ──► SystemReport
    TOML, SymPy              algebra                        ▲
                             recording ──► patterns ────────┘

- `description`: variables, constants and equations; `_toml`: systems in files.
- `_system`: the system and its stages; `algebra`: known variables apart from unknown constants.
- `_network`, `_recording`, `_patterns`: network, recording and patterns of a system.
- `_identify`, `_report`: identification and its result.
- `_constants`, `_nonlinear`, `_projected_error`: physical constants, linear or searched.
- `_noise_correction` and its neighbours: bias by measurement noise and smoothing.
- `_simulation`: the identified system beside a recording.
"""

from ._constants import (
    ConstantEstimate as ConstantEstimate,
    ConstantMinimum as ConstantMinimum,
    ConstantSearch as ConstantSearch,
    constants_from as constants_from,
)
from ._identify import identify_system as identify_system, system_settings as system_settings
from ._measurement_noise import measurement_noise as measurement_noise
from ._network import SystemNetwork as SystemNetwork, SystemTerm as SystemTerm
from ._noise_correction import (
    NoiseCorrection as NoiseCorrection,
    correct_for_noise as correct_for_noise,
)
from ._nonlinear import search_constants as search_constants
from ._patterns import system_derivatives as system_derivatives, system_patterns as system_patterns
from ._recording import (
    SystemRecording as SystemRecording,
    load_system_recording as load_system_recording,
)
from ._report import (
    SystemReport as SystemReport,
    load_system_report as load_system_report,
    save_derivation as save_derivation,
)
from ._simulation import Simulation as Simulation, simulate_system as simulate_system
from ._system import System as System
from ._toml import load_system as load_system
from .algebra import ConstantIdentifiability as ConstantIdentifiability, Separation as Separation
from .description import (
    Constant as Constant,
    DescriptionError as DescriptionError,
    Variable as Variable,
    lagrange_equations as lagrange_equations,
    mechanics_equations as mechanics_equations,
    parse_equation as parse_equation,
)


__all__ = [
    "Constant",
    "ConstantEstimate",
    "ConstantIdentifiability",
    "ConstantMinimum",
    "ConstantSearch",
    "DescriptionError",
    "NoiseCorrection",
    "Separation",
    "Simulation",
    "System",
    "SystemNetwork",
    "SystemRecording",
    "SystemReport",
    "SystemTerm",
    "Variable",
    "constants_from",
    "correct_for_noise",
    "identify_system",
    "lagrange_equations",
    "load_system",
    "load_system_recording",
    "load_system_report",
    "measurement_noise",
    "mechanics_equations",
    "save_derivation",
    "search_constants",
    "simulate_system",
    "system_derivatives",
    "system_patterns",
    "system_settings",
]
