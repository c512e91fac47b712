import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..machine import Machine, MachineError
from ._models import rubbing


@dataclass(frozen=True, eq=False)
class Plan:
    """How the time between two demands is divided into steps of the integrator."""

    steps: int
    """How many."""

    step: float
    """How long each is [s]."""

    stale: Float[np.ndarray, "machines steps"]
    """Which share of each step still has the torque demanded before (`Machine.torque_delay`)."""

    @classmethod
    def of(cls, machines: Sequence[Machine], interval: float) -> "Plan":
        """The plan for machines side by side, with a given time between demands [s].

        **Raises**

        - `MachineError`: machines that do not go together; a torque delay as long as the interval.
        """
        if len({structure(machine) for machine in machines}) != 1:
            raise MachineError(
                "the machines of a plant differ in their number of joints, in where they have"
                " friction or a transmission that gives way, or in their time step; expected them"
                " alike"
            )
        steps = max(1, math.ceil(interval / machines[0].time_step - 1e-9))
        late = np.array([machine.torque_delay for machine in machines])
        if np.any(late >= interval):
            raise MachineError(
                f"torque_delay is {late.max():g} s; expected less than the interval between"
                f" demands, {interval:g} s"
            )
        step = interval / steps
        return cls(steps, step, np.clip(late[:, None] / step - np.arange(steps), 0.0, 1.0))


def structure(machine: Machine) -> tuple[object, ...]:
    """What machines must have in common to be simulated side by side."""
    sticks = tuple((rubbing(machine).static > 0).tolist())
    return machine.joint_count, machine.flexible, sticks, machine.time_step
