"""Arms of position servos: identification from commanded and measured positions, without torques.

- `_recording`: commands and positions, sampled in time.
"""

from ._recording import ServoRecording as ServoRecording


__all__ = ["ServoRecording"]
