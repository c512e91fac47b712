from sim.machine._bodies import (
    MachineError as MachineError,
    possible_links as possible_links,
    tilted_links as tilted_links,
)
from sim.machine._disturbances import (
    DISTURBANCES as DISTURBANCES,
    disturbed as disturbed,
    undisturbed as undisturbed,
)
from sim.machine._drivetrain import (
    Drives as Drives,
    Encoders as Encoders,
    Transmission as Transmission,
)
from sim.machine._faults import Fault as Fault, Faults as Faults
from sim.machine._friction import Friction as Friction, friction_of as friction_of
from sim.machine._loads import (
    Carried as Carried,
    Load as Load,
    carrying as carrying,
    during as during,
)
from sim.machine._machine import Machine as Machine
from sim.machine._nearest_links import nearest_links as nearest_links
from sim.machine._puma560 import puma560 as puma560, specimen as specimen
from sim.machine._thesis_machines import (
    ThesisCoefficients as ThesisCoefficients,
    puma_a as puma_a,
    puma_b as puma_b,
    thesis_coefficients as thesis_coefficients,
)
