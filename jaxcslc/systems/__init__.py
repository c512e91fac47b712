from ._constants import ConstantEstimate as ConstantEstimate, constants_from as constants_from
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
from ._search_result import ConstantSearch as ConstantSearch, Minimum as Minimum
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
)
