from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..machine import Machine, MachineError
from ..trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Circumstances:
    """What a seed decides about a recording."""

    phase: Float[np.ndarray, "*batch joints"]
    """Of the encoders, in counts."""

    start: Float[np.ndarray, "*batch joints"]
    """Where the joints rest at first [rad or m]."""

    jitter: Float[np.ndarray, "*batch samples"]
    """By how much each sample is read late [s]."""

    @classmethod
    def of(cls, machine: Machine, trajectory: Trajectory, seed: int) -> "Circumstances":
        """The circumstances under which a machine performs a trajectory.

        **Raises**

        - `MachineError`: the trajectory is for another number of joints.
        """
        n = machine.joint_count
        if trajectory.start.shape != (n,):
            raise MachineError(
                f"trajectory {trajectory.name!r} starts with {trajectory.start.size} joints;"
                f" the machine has {n}"
            )
        rng = np.random.default_rng(seed)
        phase = rng.uniform(0.0, 1.0, n)
        start = trajectory.start + machine.start_spread * rng.uniform(-1.0, 1.0, n)
        jitter = machine.timing_jitter * rng.uniform(-1.0, 1.0, trajectory.samples)
        return cls(phase, start, jitter)
