import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxcslc.motion import Recording

from ..machine import Carried, Encoders, Faults, Machine
from ..trajectory import Trajectory
from ._circumstances import Circumstances
from ._plant import Plant
from ._stacking import stacked
from ._truth import SimulatedRecording, Truth


# What a plant tells at each sample, by the name it has in the truth.
TOLD = (
    "position",
    "velocity",
    "acceleration",
    "torque",
    "friction",
    "rotor_position",
    "rotor_velocity",
    "rotor_acceleration",
    "link_friction",
    "transmitted",
    "apart",
)


class SimulationError(RuntimeError):
    """A motion that the machine cannot make; the message names the joint and the time."""


def simulate(machine: Machine, trajectory: Trajectory, *, seed: int = 0) -> SimulatedRecording:
    """Lets a machine perform a trajectory and records it.

    At each sample the controller is given the encoders' readings, and what it demands is held
    until the next (7.4, Fig. 7.4-1). Row n of the recording has reading n and the demand made upon
    it, so that the motion that leads to row n is the work of the demand in row n − 1.

    **Arguments**

    - `machine`: the machine.
    - `trajectory`: what it is asked to do.
    - `seed`: of the encoders' phases, of where within `machine.start_spread` the joints rest at
        first, and of the timing's jitter. The same seed gives the same recording, bit for bit,
        alone or among others (see `record`).

    **Returns**

    The recording and the truth.

    **Raises**

    - `MachineError`: the trajectory is for another number of joints, or the machine cannot hold
        itself up.
    - `SimulationError`: a joint leaves its range.

    ```python
    >>> import sim
    >>> recording, truth = sim.simulate(sim.puma560(), sim.training(samples=100), seed=1)
    >>> recording.position.shape, truth.acceleration.shape
    ((100, 6), (100, 6))
    >>> bool(abs(recording.position - truth.position).max() < 1.2e-4)
    True

    ```
    """
    (result,) = perform([machine], trajectory, [seed])
    if isinstance(result, SimulationError):
        raise result
    return result


def perform(
    machines: Sequence[Machine],
    trajectory: Trajectory,
    seeds: Sequence[int],
    *,
    threads: int = 1,
    advanced: Callable[[int], object] | None = None,
    observe: Callable[[Any], object] | None = None,
) -> list[SimulatedRecording | SimulationError]:
    """Lets machines of one structure perform a trajectory side by side.

    **Arguments**

    - `machines`, `seeds`: one of each a recording.
    - `trajectory`: what they are asked to do.
    - `threads`: how many to use.
    - `advanced`: called now and then with the number of samples simulated since the last time.
    - `observe`: called at each sample with what the controller remembers after it.

    **Returns**

    For each machine its recording and truth, or what went wrong with it.
    """
    given = [
        Circumstances.of(machine, trajectory, seed)
        for machine, seed in zip(machines, seeds, strict=True)
    ]
    chance = stacked(given)
    encoders = stacked(
        [Encoders.of(machine, one.phase) for machine, one in zip(machines, given, strict=True)]
    )
    controller, samples = trajectory.controller, trajectory.samples
    time = sample_times(trajectory)
    faults = Faults.of(trajectory.faults, machines[0].joint_count, time)
    carried = Carried.of(trajectory.loads, time)
    plant = Plant(machines, chance.start, interval=trajectory.sample_interval, threads=threads)
    for body in carried.bodies:  # so that what cannot be is refused before anything moves
        plant.carry(body)

    recorded, demand = np.empty((2, samples, *chance.start.shape))
    told = {
        name: np.empty(recorded.shape, dtype=bool if name == "apart" else float) for name in TOLD
    }
    shown = received = encoders.read(chance.start)
    state = controller.begin(received)
    for sample in range(samples):
        if sample == 0 or carried.which[sample] != carried.which[sample - 1]:
            plant.carry(carried.bodies[carried.which[sample]])
        late = chance.jitter[:, sample, None]
        reading = encoders.read(plant.rotor_position + late * plant.rotor_velocity)
        wrong = faults.at(sample)
        reading, shown, received = wrong.read(reading, shown, received)
        recorded[sample] = received
        demand[sample], state = controller.demand(state, time[sample], reading)
        # A demand that is no number ends in an error below; MuJoCo would also log it in a file.
        plant.drive(wrong.sense * np.where(np.isfinite(demand[sample]), demand[sample], 0.0))
        for name, values in told.items():
            values[sample] = getattr(plant, name)
        if observe is not None:
            observe(state)
        if sample + 1 < samples:
            plant.advance()
        if advanced is not None:
            advanced(len(machines))
    return assembled(machines, trajectory, recorded, demand, told)


def thread_count(threads: int | None, machines: int) -> int:
    """How many threads to use: as many as the process has cores, if not said otherwise.

    **Raises**

    - `ValueError`: fewer than one.
    """
    count = len(os.sched_getaffinity(0)) if threads is None else threads
    if count < 1:
        raise ValueError(f"threads is {count}; expected 1 or more")
    return min(count, machines)


def sample_times(trajectory: Trajectory) -> Float[np.ndarray, " samples"]:
    """When a trajectory's samples are taken [s]."""
    return trajectory.sample_interval * np.arange(trajectory.samples)


def assembled(
    machines: Sequence[Machine],
    trajectory: Trajectory,
    reading: Float[np.ndarray, "samples machines joints"],
    demand: Float[np.ndarray, "samples machines joints"],
    told: Mapping[str, np.ndarray],
) -> list[SimulatedRecording | SimulationError]:
    """What each machine has to say, from arrays over samples, machines and joints."""
    return [
        _assembled(
            machine,
            trajectory,
            reading[:, i],
            demand[:, i],
            {name: values[:, i] for name, values in told.items()},
        )
        for i, machine in enumerate(machines)
    ]


def _assembled(
    machine: Machine,
    trajectory: Trajectory,
    reading: Float[np.ndarray, "samples joints"],
    demand: Float[np.ndarray, "samples joints"],
    told: dict[str, np.ndarray],
) -> SimulatedRecording | SimulationError:
    """Recording and truth of one machine, or the error of a joint that left its range."""
    time = sample_times(trajectory)
    low, high = np.array(machine.position_range).T
    within = (told["position"] >= low) & (told["position"] <= high)  # NaN is not
    demanded = np.isfinite(demand)
    if not (within & demanded).all():
        sample, joint = np.argwhere(~(within & demanded))[0]
        where = f"{trajectory.name} trajectory, {time[sample]:.4g} s: joint {joint + 1}"
        if within[sample, joint]:
            return SimulationError(
                f"{where}: its controller demands {demand[sample, joint]}; expected a torque"
            )
        return SimulationError(
            f"{where} is at {told['position'][sample, joint]:.4g}, outside its range from"
            f" {low[joint]:.4g} to {high[joint]:.4g}"
        )
    own = {name: np.ascontiguousarray(values) for name, values in told.items()}
    faults = Faults.of(trajectory.faults, machine.joint_count, time)
    carried = Carried.of(trajectory.loads, time)
    return SimulatedRecording(
        Recording(time, np.ascontiguousarray(reading), np.ascontiguousarray(demand)),
        Truth(time=time, **own, carried=carried.mass, lost=faults.lost),
    )
