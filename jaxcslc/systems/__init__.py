from ._description import Constant as Constant, Variable as Variable
from ._errors import DescriptionError as DescriptionError
from ._identifiability import ConstantIdentifiability as ConstantIdentifiability
from ._network import SystemNetwork as SystemNetwork, SystemTerm as SystemTerm
from ._patterns import system_derivatives as system_derivatives, system_patterns as system_patterns
from ._recording import (
    SystemRecording as SystemRecording,
    load_system_recording as load_system_recording,
)
from ._separation import Separation as Separation
from ._system import System as System
