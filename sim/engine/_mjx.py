import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Float
from mujoco import mjx

from jaxcslc.control import AbstractController

from ..machine import Carried, Faults, Machine, MachineError, carrying
from ..trajectory import AbstractPath, Trajectory
from ._computer import Computer
from ._hardware import JointHardware
from ._models import check_time_step, model_of
from ._plan import Plan, RandomDraws, sample_times, stacked
from ._simulate import SimulationError, assembled
from ._truth import SimulatedRecording


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
        model, differing = _side_by_side(models)
        signals = _run(
            model,
            differing,
            mjx.make_data(models[0][0]),
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
    model: mjx.Model,
    differing: dict[str, jax.Array],
    data: mjx.Data,
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
    axes = jax.tree_util.tree_map(lambda _: None, model)
    over = partial(jax.vmap, in_axes=(axes.tree_replace(dict.fromkeys(differing, 0)), 0))

    def loaded(q: Any, qd: Any, warm: Any, torque: Any, applied: Any) -> mjx.Data:
        return data.replace(qpos=q, qvel=qd, qacc_warmstart=warm, ctrl=torque, qfrc_applied=applied)

    def forward(model: mjx.Model, state: tuple[Any, ...]) -> tuple[Any, ...]:
        after = mjx.forward(model, loaded(*state))
        return after.qacc, after.qfrc_constraint, after.qacc_warmstart

    def step(model: mjx.Model, state: tuple[Any, ...]) -> tuple[Any, ...]:
        after = mjx.step(model, loaded(*state))
        return after.qpos, after.qvel, after.qacc_warmstart

    def sample(carry: Any, at: Any) -> tuple[Any, dict[str, Any]]:
        q, qd, warm, before, state = carry
        time, late, fault, which = at
        now = model.tree_replace({name: rows[which] for name, rows in differing.items()})
        demand, state = computer.command(state, time, hardware.read(q, qd, late), fault)
        torque = hardware.drives.torque(fault.sense * demand)
        acting, assist = hardware.acting(0, before, torque), hardware.assist(qd)
        acceleration, constraint, warm = over(forward)(now, (q, qd, warm, acting, assist))
        observed = hardware.observed(q, qd, acceleration, acting, assist, constraint)

        def advance(moving: Any, stale: Any) -> tuple[Any, None]:
            q, qd, warm, acceleration = moving
            acting = hardware.mixed(stale, before, torque)
            applied = hardware.assist(qd, acceleration)
            q, after, warm = over(step)(now, (q, qd, warm, acting, applied))
            return (q, after, warm, (after - qd) / hardware.step), None

        moving, _ = jax.lax.scan(advance, (q, qd, warm, acceleration), hardware.stale.T)
        signals = {"reading": state.received, "demand": demand, **observed}
        return (*moving[:3], torque, state), signals

    at_rest = jnp.zeros((start.shape[0], hardware.friction.viscous.shape[1]))
    first = (
        at_rest.at[:, :n].set(start).at[:, rotor].set(start),
        at_rest,
        at_rest,
        jnp.zeros_like(start),
        computer.begin(hardware.encoders.read(jnp.asarray(start))),
    )
    _, signals = jax.lax.scan(sample, first, samples)
    return signals


def _side_by_side(
    models: Sequence[Sequence[mujoco.MjModel]],
) -> tuple[mjx.Model, dict[str, jax.Array]]:
    """An MJX model, and the constants in which the models differ, by name: stacked, with an axis
    for `models` and one for the models of a row."""
    first, every = models[0][0], [model for row in models for model in row]
    model = mjx.put_model(first)
    differing: dict[str, jax.Array] = {}
    for field in dataclasses.fields(model):
        shared = getattr(model, field.name)
        if not isinstance(shared, jax.Array) or not hasattr(first, field.name):
            continue
        values = [np.asarray(getattr(item, field.name)) for item in every]
        if any(not np.array_equal(values[0], value) for value in values[1:]):
            rows = np.stack([value.reshape(shared.shape) for value in values])
            rows = rows.reshape(len(models), len(models[0]), *shared.shape)
            differing[field.name] = jnp.asarray(rows, shared.dtype)
    return model, differing
