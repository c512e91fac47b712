from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Float

from jaxcslc.control import AbstractController
from sim.engine._computer import Computer
from sim.engine._hardware import JointHardware
from sim.engine._mjx_mechanics import Mechanics
from sim.engine._models import check_time_step, model_of
from sim.engine._plan import Plan, RandomDraws, sample_times, stacked
from sim.engine._simulate import SimulationError, assembled
from sim.engine._truth import SimulatedRecording
from sim.machine._bodies import MachineError
from sim.machine._faults import Faults
from sim.machine._loads import Carried, carrying
from sim.machine._machine import Machine
from sim.trajectory._paths import AbstractPath
from sim.trajectory._trajectories import Trajectory


def perform_mjx(
    machines: Sequence[Machine],
    trajectory: Trajectory,
    seeds: Sequence[int],
    *,
    advanced: Callable[[int], object] | None = None,
) -> list[SimulatedRecording | SimulationError]:
    """As `perform`, under MJX on JAX's default device.

    A whole recording is one compiled program; another trajectory or number of machines is
    compiled anew. The results agree with those of `perform` to rounding, which open-loop motion
    through stick and slip magnifies.

    **Raises**

    - `MachineError`: as `perform`; and if JAX's 64-bit mode is off.
    """
    if jnp.zeros(()).dtype != np.float64:
        raise MachineError("JAX's 64-bit mode is off; expected it on (jax_enable_x64) for MJX")
    draws = [
        RandomDraws.of(machine, trajectory, seed)
        for machine, seed in zip(machines, seeds, strict=True)
    ]
    start, jitter = stacked(draws).start, stacked(draws).jitter
    plan = Plan.of(machines, trajectory.sample_interval)
    time = sample_times(trajectory)
    faults = Faults.of(trajectory.faults, machines[0].joint_count, time)
    carried = Carried.of(trajectory.loads, time)
    models: list[list[mujoco.MjModel]] = []  # a row for each body carried
    for body in carried.bodies:
        loaded = {id(machine): carrying(machine, body) for machine in machines}
        compiled = {key: model_of(machine, plan.step) for key, machine in loaded.items()}
        for machine, one in zip(machines, draws, strict=True):
            check_time_step(machine, compiled[id(machine)], one.start)
        models.append([compiled[id(machine)] for machine in machines])
    # MJX broadcasts across ranks inside.
    with jax.numpy_rank_promotion("allow"):
        signals = _run(
            Mechanics.of(machines[0], models),
            JointHardware.of(machines, plan, draws),
            start,
            (time, jitter.T, faults, carried.which),
            trajectory.controller,
            trajectory.path,
            trajectory.sample_interval,
            trajectory.per_machine,
        )
    host = {name: np.asarray(values) for name, values in signals.items()}
    reading, demand = host.pop("reading"), host.pop("demand")
    if advanced is not None:
        advanced(len(machines) * trajectory.samples)
    return assembled(machines, trajectory, reading, demand, host)


@eqx.filter_jit
def _run(
    mechanics: Mechanics,
    hardware: JointHardware,
    start: Float[jax.Array | np.ndarray, "machines joints"],
    samples: tuple[Any, ...],
    controller: AbstractController,
    path: AbstractPath | None,
    interval: float,
    per_machine: bool,
) -> dict[str, jax.Array]:
    """The signals of every sample, each (samples, machines, joints): `perform` and `Plant` over
    arrays of all machines."""
    n, rotor = len(hardware.flexible), hardware.rotor
    computer = Computer(controller, path, interval, per_machine)

    def sample(carry: Any, at: Any) -> tuple[Any, dict[str, Any]]:
        q, qd, limits, before, state = carry
        time, late, fault, which = at
        now = mechanics.loaded(which)
        demand, state = computer.command(state, time, hardware.read(q, qd, late), fault)
        torque = hardware.drives.torque(fault.sense * demand)
        acting, assist = hardware.acting(0, before, torque), hardware.assist(qd)
        forces = assist.at[:, rotor].add(acting)
        qdd, constraint, limits = now.accelerations(q, qd, forces, limits)
        observed = hardware.observed(q, qd, qdd, acting, assist, constraint)

        def advance(moving: Any, stale: Any) -> tuple[Any, None]:
            q, qd, limits, qdd = moving
            applied = hardware.assist(qd, qdd)
            applied = applied.at[:, rotor].add(hardware.mixed(stale, before, torque))
            q, after, limits = now.step(q, qd, applied, limits)
            return (q, after, limits, (after - qd) / hardware.step), None

        moving, _ = jax.lax.scan(advance, (q, qd, limits, qdd), hardware.stale.T)
        signals = {"reading": state.received, "demand": demand, **observed}
        return (*moving[:3], torque, state), signals

    at_rest = jnp.zeros((start.shape[0], hardware.friction.viscous.shape[1]))
    first = (
        at_rest.at[:, :n].set(start).at[:, rotor].set(start),
        at_rest,
        jnp.zeros_like(start),
        jnp.zeros_like(start),
        computer.begin(hardware.encoders.read(jnp.asarray(start))),
    )
    _, signals = jax.lax.scan(sample, first, samples)
    return signals
