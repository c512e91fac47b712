from ._bodies import possible_links as possible_links, tilted_links as tilted_links
from ._disturbances import (
    DISTURBANCES as DISTURBANCES,
    disturbed as disturbed,
    undisturbed as undisturbed,
)
from ._drives import Drives as Drives
from ._encoders import Encoders as Encoders
from ._faults import Fault as Fault, Faults as Faults
from ._friction import Friction as Friction
from ._loads import Carried as Carried, Load as Load, carrying as carrying, during as during
from ._machine import Machine as Machine
from ._machine_error import MachineError as MachineError
from ._nearest_links import nearest_links as nearest_links
from ._puma560 import puma560 as puma560
from ._specimen import specimen as specimen
from ._thesis_machines import (
    ThesisCoefficients as ThesisCoefficients,
    puma_a as puma_a,
    puma_b as puma_b,
    thesis_coefficients as thesis_coefficients,
)
from ._transmission import Transmission as Transmission
