"""Plan of a recording: the structure of its machines, times of samples, random draws."""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float

from sim.machine._bodies import MachineError
from sim.machine._drivetrain import friction_of
from sim.machine._machine import Machine
from sim.trajectory._trajectories import Trajectory


Parts = TypeVar("Parts")


@dataclass(frozen=True, eq=False)
class RandomDraws:
    """The random draws of a recording, from its seed.

    **Attributes**

    - `phase`: of the encoders, (*batch, joints) [counts].
    - `start`: initial joint positions, at rest, (*batch, joints) [rad or m].
    - `jitter`: how late each sample is read, (*batch, samples) [s].
    """

    phase: Float[np.ndarray, "*batch joints"]
    start: Float[np.ndarray, "*batch joints"]
    jitter: Float[np.ndarray, "*batch samples"]

    @classmethod
    def of(cls, machine: Machine, trajectory: Trajectory, seed: int) -> "RandomDraws":
        """The draws of one recording.

        **Raises** `MachineError`: the trajectory is for another number of joints.
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


@dataclass(frozen=True, eq=False)
class Plan:
    """Division of the sampling interval into steps of the integrator.

    **Attributes**

    - `steps`: how many.
    - `step`: length of each [s].
    - `stale`: the part of each step in which the previous command still acts
      (`Machine.torque_delay`), (machines, steps).
    """

    steps: int
    step: float
    stale: Float[np.ndarray, "machines steps"]

    @classmethod
    def of(cls, machines: Sequence[Machine], interval: float) -> "Plan":
        """The plan for machines side by side and a sampling interval [s].

        **Raises** `MachineError`: machines of different structure; a torque delay as long as the
        interval.
        """
        if len({structure(machine) for machine in machines}) != 1:
            raise MachineError(
                "the machines of a plant differ in their number of joints, in which joints have"
                " friction or a flexible transmission, or in their time step; expected them alike"
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
    """Properties that machines must share to be simulated side by side."""
    sticks = tuple((friction_of(machine).static > 0).tolist())
    return machine.joint_count, machine.flexible, sticks, machine.time_step


def sample_times(trajectory: Trajectory) -> Float[np.ndarray, " samples"]:
    """Return the times at which a trajectory's samples are taken [s]."""
    return trajectory.sample_interval * np.arange(trajectory.samples)


def stacked(parts: Sequence[Parts]) -> Parts:
    """One dataclass of arrays from several: their arrays stacked along a new first axis."""
    first: Any = parts[0]
    return dataclasses.replace(
        first,
        **{
            field.name: np.stack([getattr(part, field.name) for part in parts])
            for field in dataclasses.fields(first)
        },
    )
