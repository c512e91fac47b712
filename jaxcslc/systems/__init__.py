"""Identification of systems that are not manipulators (thesis 8.2.5, C.2).

    equations ──► System ──► separation ──► network ──► identify_system ──► SystemReport
    TOML, SymPy              algebra                        ▲
                             recording ──► patterns ────────┘

- `_description`: variables, constants and units; `_toml`: equations as text, systems in files.
- `_system`: the system and its stages; equations of mechanical systems.
- `_generators`, `_separation`: known variables apart from unknown constants, in exact algebra.
- `_network`, `_recording`: network, recording and patterns of a system.
- `_constants`: constants that follow from coefficients; `_search`: those that enter nonlinearly.
- `_noise_correction`: bias by measurement noise and by smoothing.
- `_simulation`: the identified system next to a recording.
- `_identify`: identification and its result.
"""

from ._constants import (
    ConstantEstimate as ConstantEstimate,
    ConstantIdentifiability as ConstantIdentifiability,
    constants_from as constants_from,
)
from ._description import (
    Constant as Constant,
    DescriptionError as DescriptionError,
    Variable as Variable,
)
from ._identify import (
    SystemReport as SystemReport,
    identify_system as identify_system,
    load_system_report as load_system_report,
    save_derivation as save_derivation,
    system_settings as system_settings,
)
from ._network import SystemNetwork as SystemNetwork, SystemTerm as SystemTerm
from ._noise_correction import (
    NoiseCorrection as NoiseCorrection,
    correct_for_noise as correct_for_noise,
)
from ._recording import (
    SystemRecording as SystemRecording,
    load_system_recording as load_system_recording,
    measurement_noise as measurement_noise,
    system_derivatives as system_derivatives,
    system_patterns as system_patterns,
)
from ._search import (
    ConstantMinimum as ConstantMinimum,
    ConstantSearch as ConstantSearch,
    search_constants as search_constants,
)
from ._separation import Separation as Separation
from ._simulation import Simulation as Simulation, simulate_system as simulate_system
from ._system import (
    System as System,
    lagrange_equations as lagrange_equations,
    mechanics_equations as mechanics_equations,
)
from ._toml import load_system as load_system, parse_equation as parse_equation


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
