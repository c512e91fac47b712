from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from jaxcslc.motion import Recording

from ._circumstances import Circumstances
from ._encoders import Encoders
from ._machine import Machine
from ._plant import Plant
from ._stacking import stacked
from ._trajectories import Trajectory
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
) -> list[SimulatedRecording | SimulationError]:
    """Lets machines of one structure perform a trajectory side by side.

    **Arguments**

    - `machines`, `seeds`: one of each a recording.
    - `trajectory`: what they are asked to do.
    - `threads`: how many to use.
    - `advanced`: called now and then with the number of samples simulated since the last time.

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
    plant = Plant(machines, chance.start, interval=trajectory.sample_interval, threads=threads)
    controller, samples = trajectory.controller, trajectory.samples
    shape = (*chance.start.shape, samples)
    time = sample_times(trajectory)

    reading, demand = np.empty((2, samples, *chance.start.shape))
    told = {
        name: np.empty(reading.shape, dtype=bool if name == "apart" else float) for name in TOLD
    }
    state = controller.begin(encoders.read(chance.start))
    for sample in range(samples):
        late = chance.jitter[:, sample, None]
        reading[sample] = encoders.read(plant.rotor_position + late * plant.rotor_velocity)
        demand[sample], state = controller.demand(state, time[sample], reading[sample])
        plant.drive(demand[sample])
        for name, values in told.items():
            values[sample] = getattr(plant, name)
        if sample + 1 < samples:
            plant.advance()
        if advanced is not None:
            advanced(shape[0])
    return assembled(machines, trajectory, reading, demand, told)


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
    if not within.all():
        sample, joint = np.argwhere(~within)[0]
        return SimulationError(
            f"{trajectory.name} trajectory, {time[sample]:.4g} s: joint {joint + 1} is at"
            f" {told['position'][sample, joint]:.4g}, outside its range from {low[joint]:.4g} to"
            f" {high[joint]:.4g}"
        )
    own = {name: np.ascontiguousarray(values) for name, values in told.items()}
    return SimulatedRecording(
        Recording(time, np.ascontiguousarray(reading), np.ascontiguousarray(demand)),
        Truth(time=time, **own),
    )
