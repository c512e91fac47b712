"""Simulation of machines that perform a trajectory: `simulate` and `perform`, and the true motion.

Both engines return a `SimulatedRecording`: C MuJoCo's `_plant`, and `_mjx`."""

import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from jaxcslc.recordings import Recording
from sim.engine._computer import Computer
from sim.engine._hardware import JointHardware
from sim.engine._plan import Plan, RandomDraws, sample_times, stacked
from sim.engine._plant import Plant
from sim.machine._events import Carried, Faults
from sim.machine._machine import Machine
from sim.trajectory._trajectories import Trajectory


class Truth(eqx.Module):
    """True state of the machine at each sample of a recording, just after it.

    At each sample these values satisfy the links' equation (Eqn. 2.5-2 without the motors) and
    that of the rotors:

    `M'(position) acceleration + V(position, velocity) + G(position) + link_friction = transmitted`

    `motor_inertia * rotor_acceleration + friction - link_friction + transmitted = torque`

    Without a flexible transmission, rotors move as links do, and the sum of the two is

    `M(position) acceleration + V(position, velocity) + G(position) + friction = torque`.

    >>> import sim
    >>> _, truth = sim.simulate(sim.puma560(), sim.training(samples=5))
    >>> truth.velocity[0]
    array([0., 0., 0., 0., 0., 0.])
    """

    time: Float[np.ndarray, " samples"]
    """[s]."""

    position: Float[np.ndarray, "samples joints"]
    """Of the links [rad or m]."""

    velocity: Float[np.ndarray, "samples joints"]
    """Of the links [rad/s or m/s]."""

    acceleration: Float[np.ndarray, "samples joints"]
    """Of the links: the one that begins with the torque of this row. Where rotor and link are one
    body it jumps at each sample, as the torque does [rad/s² or m/s²]."""

    torque: Float[np.ndarray, "samples joints"]
    """Torque of the drives just after this sample [N m or N]."""

    friction: Float[np.ndarray, "samples joints"]
    """Friction torque [N m or N]: Eqn. 2.5-4 where the joint slides; the torque that balances the
    others where it sticks; within one step of the integrator before it stops or reverses, the
    torque that stops it."""

    rotor_position: Float[np.ndarray, "samples joints"]
    """Before the encoders, at the joint [rad or m]."""

    rotor_velocity: Float[np.ndarray, "samples joints"]
    """At the joint [rad/s or m/s]."""

    rotor_acceleration: Float[np.ndarray, "samples joints"]
    """At the joint [rad/s² or m/s²]."""

    link_friction: Float[np.ndarray, "samples joints"]
    """The part of `friction` that acts on the link [N m or N]."""

    transmitted: Float[np.ndarray, "samples joints"]
    """Torque through the gears from rotor to link [N m or N]."""

    apart: Bool[np.ndarray, "samples joints"]
    """Whether the gears are apart: whether the joint is experiencing backlash (2.5.3)."""

    carried: Float[np.ndarray, " samples"]
    """Mass of the loads that the last link carries (`Trajectory.loads`) [kg]."""

    lost: Bool[np.ndarray, "samples joints"]
    """Whether the controller got NaN instead of a reading (`Trajectory.faults`)."""


class SimulatedRecording(NamedTuple):
    """A recording as the machine's computer would make it, and the true state."""

    recording: Recording
    """Encoder readings, and the torques demanded in response."""

    truth: Truth


class SimulationError(RuntimeError):
    """A motion that the machine cannot perform; the message names the joint and the time."""


def simulate(machine: Machine, trajectory: Trajectory, *, seed: int = 0) -> SimulatedRecording:
    """Lets a machine perform a trajectory and records it.

    At each sample the controller gets the encoders' readings, and its demand is constant until the
    next (7.4, Fig. 7.4-1). Row n of the recording has reading n and the demand computed from it,
    so that the demand in row n − 1 causes the motion up to row n.

    **Arguments**

    - `machine`: the machine.
    - `trajectory`: start, controller and desired motion.
    - `seed`: of the encoders' phases, of the initial positions within `machine.start_spread`,
        and of the timing's jitter. The same seed gives the same recording, bit for bit,
        alone or among others (see `record`).

    **Returns** the recording and the truth.

    **Raises**

    - `MachineError`: the trajectory is for another number of joints, or the machine cannot hold
        itself up.
    - `SimulationError`: a joint leaves its range.

    >>> import sim
    >>> recording, truth = sim.simulate(sim.puma560(), sim.training(samples=100), seed=1)
    >>> recording.position.shape, truth.acceleration.shape
    ((100, 6), (100, 6))
    >>> bool(abs(recording.position - truth.position).max() < 1.2e-4)
    True
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
    - `trajectory`: start, controller and desired motion of all of them.
    - `threads`: how many to use.
    - `advanced`: called repeatedly with the number of samples simulated since the last call.
    - `observe`: called at each sample with the controller's state after it.

    **Returns**

    For each machine its recording and truth, or its error.
    """
    draws = [
        RandomDraws.of(machine, trajectory, seed)
        for machine, seed in zip(machines, seeds, strict=True)
    ]
    start, jitter = stacked(draws).start, stacked(draws).jitter
    plan = Plan.of(machines, trajectory.sample_interval)
    hardware = JointHardware.of(machines, plan, draws)
    computer, samples = Computer.of(trajectory), trajectory.samples
    time = sample_times(trajectory)
    faults = Faults.of(trajectory.faults, machines[0].joint_count, time)
    carried = Carried.of(trajectory.loads, time)
    plant = Plant(
        machines, start, interval=trajectory.sample_interval, threads=threads, hardware=hardware
    )
    for body in carried.bodies:  # raises for impossible bodies before the simulation starts
        plant.carry(body)

    reading, demand = np.empty((2, samples, *start.shape))
    truth = {name: np.empty(reading.shape, values.dtype) for name, values in plant.observed.items()}
    state = computer.begin(hardware.encoders.read(start))
    for sample in range(samples):
        if sample == 0 or carried.which[sample] != carried.which[sample - 1]:
            plant.carry(carried.bodies[carried.which[sample]])
        fault = faults.at(sample)
        demand[sample], state = computer.command(
            state, time[sample], plant.read(jitter[:, sample]), fault
        )
        reading[sample] = state.received
        # A demand that is not finite ends in an error below; MuJoCo would also log it in a file.
        plant.drive(fault.sense * np.where(np.isfinite(demand[sample]), demand[sample], 0.0))
        for name, values in plant.observed.items():
            truth[name][sample] = values
        if observe is not None:
            observe(state.controller)
        if sample + 1 < samples:
            plant.advance()
        if advanced is not None:
            advanced(len(machines))
    return assembled(machines, trajectory, reading, demand, truth)


def thread_count(threads: int | None, machines: int) -> int:
    """Return how many threads to use: as many as the process has cores, unless specified.

    **Raises** `ValueError`: fewer than one.
    """
    count = len(os.sched_getaffinity(0)) if threads is None else threads
    if count < 1:
        raise ValueError(f"threads is {count}; expected 1 or more")
    return min(count, machines)


def assembled(
    machines: Sequence[Machine],
    trajectory: Trajectory,
    reading: Float[np.ndarray, "samples machines joints"],
    demand: Float[np.ndarray, "samples machines joints"],
    truth: Mapping[str, np.ndarray],
) -> list[SimulatedRecording | SimulationError]:
    """The recording and the truth of each machine, from arrays (samples, machines, joints)."""
    return [
        _assembled(
            machine,
            trajectory,
            reading[:, i],
            demand[:, i],
            {name: values[:, i] for name, values in truth.items()},
        )
        for i, machine in enumerate(machines)
    ]


def _assembled(
    machine: Machine,
    trajectory: Trajectory,
    reading: Float[np.ndarray, "samples joints"],
    demand: Float[np.ndarray, "samples joints"],
    truth: dict[str, np.ndarray],
) -> SimulatedRecording | SimulationError:
    """Recording and truth of one machine, or the error of a joint that left its range."""
    time = sample_times(trajectory)
    low, high = np.array(machine.position_range).T
    within = (truth["position"] >= low) & (truth["position"] <= high)  # NaN is not
    demanded = np.isfinite(demand)
    if not (within & demanded).all():
        sample, joint = np.argwhere(~(within & demanded))[0]
        where = f"{trajectory.name} trajectory, {time[sample]:.4g} s: joint {joint + 1}"
        if within[sample, joint]:
            return SimulationError(
                f"{where}: its controller demands {demand[sample, joint]}; expected a torque"
            )
        return SimulationError(
            f"{where} is at {truth['position'][sample, joint]:.4g}, outside its range from"
            f" {low[joint]:.4g} to {high[joint]:.4g}"
        )
    signals = {name: np.ascontiguousarray(values) for name, values in truth.items()}
    faults = Faults.of(trajectory.faults, machine.joint_count, time)
    carried = Carried.of(trajectory.loads, time)
    return SimulatedRecording(
        Recording(time, np.ascontiguousarray(reading), np.ascontiguousarray(demand)),
        Truth(time=time, **signals, carried=carried.mass, lost=faults.lost),
    )
