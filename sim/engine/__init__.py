"""Two engines: C MuJoCo and MJX.

     Machine, Trajectory --> plan --> computer --> hardware --> plant --> SimulatedRecording

- `_simulate`: entry, and the recording with the true motion.
- `_plan`: sample times and random draws; `_computer`: the controller's side.
- `_hardware`: disturbances of a step; `_mjcf`, `_models`: mechanics for MuJoCo.
- `_plant`: C MuJoCo in batches; `_mjx`: one compiled program.
"""

from sim.engine._mjcf import mjcf as mjcf
from sim.engine._plan import structure as structure
from sim.engine._plant import Plant as Plant
from sim.engine._simulate import (
    SimulatedRecording as SimulatedRecording,
    SimulationError as SimulationError,
    Truth as Truth,
    perform as perform,
    simulate as simulate,
    thread_count as thread_count,
)
