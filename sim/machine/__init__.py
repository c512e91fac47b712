"""Simulated machines, with all disturbances of Section 7.2.

- `_machine`: `Machine`, whose fields are off by default.
- `_bodies`, `_nearest_links`: links that exist, and links with given dynamics.
- `_drivetrain`: drives, encoders, transmission, friction.
- `_events`: loads and faults.
- `_puma560`, `_thesis_machines`, `_disturbances`: machines and disturbances by name.
"""

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
    Friction as Friction,
    Transmission as Transmission,
    friction_of as friction_of,
)
from sim.machine._events import (
    Carried as Carried,
    Fault as Fault,
    Faults as Faults,
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
