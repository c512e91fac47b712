from sim.engine._mjcf import mjcf as mjcf
from sim.engine._plan import structure as structure
from sim.engine._plant import Plant as Plant
from sim.engine._simulate import (
    SimulationError as SimulationError,
    perform as perform,
    simulate as simulate,
    thread_count as thread_count,
)
from sim.engine._truth import SimulatedRecording as SimulatedRecording, Truth as Truth
