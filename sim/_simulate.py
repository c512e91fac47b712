import numpy as np

from jaxcslc.motion import Recording

from ._encoders import Encoders
from ._machine import Machine, MachineError
from ._plant import Plant
from ._trajectories import Trajectory
from ._truth import SimulatedRecording, Truth


class SimulationError(RuntimeError):
    """A motion that the machine cannot make; the message names the joint and the time."""


def simulate(machine: Machine, trajectory: Trajectory, *, seed: int = 0) -> SimulatedRecording:
    """Lets a machine perform a trajectory and records it.

    At each sample the controller is given the encoders' readings, and what it demands is held
    until the next (7.4). Row n of the recording has reading n and the demand made upon it, so that
    the motion that leads to row n is the work of the demand in row n − 1.

    **Arguments**

    - `machine`: the machine.
    - `trajectory`: what it is asked to do.
    - `seed`: of the encoders' phases, and of where within `machine.start_spread` the joints rest
        at first. The same seed gives the same recording, bit for bit.

    **Returns**

    The recording and the truth.

    **Raises**

    - `MachineError`: the trajectory is for another number of joints.
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
    n = machine.joint_count
    if trajectory.start.shape != (n,):
        raise MachineError(
            f"trajectory {trajectory.name!r} starts with {trajectory.start.size} joints;"
            f" the machine has {n}"
        )
    rng = np.random.default_rng(seed)
    encoders = Encoders.of(machine, rng.uniform(0.0, 1.0, n))
    start = trajectory.start + machine.start_spread * rng.uniform(-1.0, 1.0, n)
    plant = Plant(machine, start, interval=trajectory.sample_interval)
    controller = trajectory.controller

    time = trajectory.sample_interval * np.arange(trajectory.samples)
    reading, demand, position, velocity, acceleration, torque, friction = np.empty(
        (7, trajectory.samples, n)
    )
    state = controller.begin(encoders.read(start))
    for sample in range(trajectory.samples):
        position[sample], velocity[sample] = plant.position, plant.velocity
        _check_range(machine, trajectory, position[sample], float(time[sample]))
        reading[sample] = encoders.read(position[sample])
        demand[sample], state = controller.demand(state, float(time[sample]), reading[sample])
        plant.drive(demand[sample])
        acceleration[sample], torque[sample] = plant.acceleration, plant.torque
        friction[sample] = plant.friction
        if sample + 1 < trajectory.samples:
            plant.advance()
    return SimulatedRecording(
        Recording(time, reading, demand),
        Truth(time, position, velocity, acceleration, torque, friction),
    )


def _check_range(
    machine: Machine, trajectory: Trajectory, position: np.ndarray, time: float
) -> None:
    for i, (q, (low, high)) in enumerate(
        zip(position.tolist(), machine.position_range, strict=True), start=1
    ):
        if not low <= q <= high:  # NaN is not within
            raise SimulationError(
                f"{trajectory.name} trajectory, {time:.4g} s: joint {i} is at {q:.4g},"
                f" outside its range from {low:.4g} to {high:.4g}"
            )
