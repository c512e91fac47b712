from ._mjcf import mjcf as mjcf
from ._plan import structure as structure
from ._plant import Plant as Plant
from ._simulate import (
    SimulationError as SimulationError,
    perform as perform,
    simulate as simulate,
    thread_count as thread_count,
)
from ._truth import SimulatedRecording as SimulatedRecording, Truth as Truth
