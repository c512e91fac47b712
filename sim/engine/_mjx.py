import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from ..machine import (
    Carried,
    Drives,
    Encoders,
    Faults,
    Friction,
    Machine,
    MachineError,
    Transmission,
    carrying,
)
from ..trajectory import AbstractController, Trajectory
from ._circumstances import Circumstances
from ._models import check_time_step, model_of, rubbing
from ._plan import Plan
from ._simulate import SimulationError, assembled, sample_times
from ._stacking import stacked
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
    given = [
        Circumstances.of(machine, trajectory, seed)
        for machine, seed in zip(machines, seeds, strict=True)
    ]
    plan = Plan.of(machines, trajectory.sample_interval)
    time = sample_times(trajectory)
    faults = Faults.of(trajectory.faults, machines[0].joint_count, time)
    carried = Carried.of(trajectory.loads, time)
    models: list[list[mujoco.MjModel]] = []  # a row for each body carried
    for body in carried.bodies:
        each = {id(machine): carrying(machine, body) for machine in machines}
        compiled = {key: model_of(machine, plan.step) for key, machine in each.items()}
        for machine, one in zip(machines, given, strict=True):
            check_time_step(machine, compiled[id(machine)], one.start)
        models.append([compiled[id(machine)] for machine in machines])
    chance = stacked(given)
    parts = _Parts(
        stacked(
            [Encoders.of(machine, one.phase) for machine, one in zip(machines, given, strict=True)]
        ),
        stacked([Drives.of(machine) for machine in machines]),
        stacked([rubbing(machine) for machine in machines]),
        np.array([machine.backlash for machine in machines]),
        np.array([machine.link_share for machine in machines]),
        np.array([[float(link.motor_inertia) for link in machine.links] for machine in machines]),
        plan.stale,
        np.array(plan.step),
    )
    # MJX broadcasts across ranks inside.
    with jax.numpy_rank_promotion("allow"):
        model, differing = _side_by_side(models)
        told = _run(
            model,
            differing,
            mjx.make_data(models[0][0]),
            parts,
            chance.start,
            (time, chance.jitter.T, faults, carried.which),
            controller=trajectory.controller,
            flexible=machines[0].flexible,
        )
    host = {name: np.asarray(values) for name, values in told.items()}
    reading, demand = host.pop("reading"), host.pop("demand")
    if advanced is not None:
        advanced(len(machines) * trajectory.samples)
    return assembled(machines, trajectory, reading, demand, host)


class _Parts(NamedTuple):
    """What the machines are made of, besides their mechanics; arrays with a leading machine."""

    encoders: Encoders
    drives: Drives
    friction: Friction
    backlash: Any
    link_share: Any
    motor_inertia: Any
    stale: Any
    step: Any


for _part in (Encoders, Drives, Friction):
    jax.tree_util.register_dataclass(
        _part, data_fields=[field.name for field in dataclasses.fields(_part)], meta_fields=[]
    )


@partial(jax.jit, static_argnames=("controller", "flexible"))
def _run(
    model: mjx.Model,
    differing: dict[str, jax.Array],
    data: mjx.Data,
    parts: _Parts,
    start: jax.Array,
    samples: tuple[Any, ...],
    *,
    controller: AbstractController,
    flexible: tuple[bool, ...],
) -> dict[str, jax.Array]:
    """The signals of every sample, each (samples, machines, joints): what `perform` and `Plant`
    do, over arrays of all machines."""
    n, soft = len(flexible), np.array(flexible)
    transmission = Transmission(soft, np.zeros(n))
    rotor = transmission.rotor
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
        q, qd, warm, before, shown, received, memory = carry
        time, late, wrong, which = at
        now = model.tree_replace({name: rows[which] for name, rows in differing.items()})
        reading = parts.encoders.read(q[:, rotor] + late[:, None] * qd[:, rotor])
        reading, shown, received = wrong.read(reading, shown, received)
        demand, memory = controller.demand(memory, time, reading)
        torque = parts.drives.torque(wrong.sense * demand)

        def acting(share: Any) -> Any:
            return share[:, None] * before + (1 - share[:, None]) * torque

        given = acting(parts.stale[:, 0])
        helped = parts.friction.help(qd)
        acceleration, held, warm = over(forward)(now, (q, qd, warm, given, helped))
        taken = parts.friction.viscous * qd - helped - held
        on_rotor = jnp.where(soft, taken[:, rotor], (1 - parts.link_share) * taken[:, :n])
        on_link = jnp.where(soft, taken[:, :n], parts.link_share * taken[:, :n])
        inertial = parts.motor_inertia * acceleration[:, rotor]
        told = {
            "reading": received,
            "demand": demand,
            "position": q[:, :n],
            "velocity": qd[:, :n],
            "acceleration": acceleration[:, :n],
            "torque": given,
            "friction": on_rotor + on_link,
            "rotor_position": q[:, rotor],
            "rotor_velocity": qd[:, rotor],
            "rotor_acceleration": acceleration[:, rotor],
            "link_friction": on_link,
            "transmitted": given - on_rotor - inertial,
            "apart": jnp.abs(q[:, rotor] - q[:, :n]) < parts.backlash / 2,
        }

        def one_step(moving: Any, share: Any) -> tuple[Any, None]:
            q, qd, warm, acceleration = moving
            applied = parts.friction.help(qd + 0.5 * parts.step * acceleration)
            q, faster, warm = over(step)(now, (q, qd, warm, acting(share), applied))
            return (q, faster, warm, (faster - qd) / parts.step), None

        moving, _ = jax.lax.scan(one_step, (q, qd, warm, acceleration), parts.stale.T)
        return (*moving[:3], torque, shown, received, memory), told

    at_rest = jnp.zeros((start.shape[0], transmission.freedoms))
    begun = parts.encoders.read(start)
    first = (
        at_rest.at[:, :n].set(start).at[:, rotor].set(start),
        at_rest,
        at_rest,
        jnp.zeros_like(start),
        begun,
        begun,
        controller.begin(begun),
    )
    _, told = jax.lax.scan(sample, first, samples)
    return told


def _side_by_side(
    models: Sequence[Sequence[mujoco.MjModel]],
) -> tuple[mjx.Model, dict[str, jax.Array]]:
    """An MJX model, and the constants in which the models differ, by name: stacked, with an axis
    for the rows given and one for the models of a row."""
    first, every = models[0][0], [model for row in models for model in row]
    model = mjx.put_model(first)
    differing: dict[str, jax.Array] = {}
    for field in dataclasses.fields(model):
        shared = getattr(model, field.name)
        if not isinstance(shared, jax.Array) or not hasattr(first, field.name):
            continue
        values = [np.asarray(getattr(each, field.name)) for each in every]
        if any(not np.array_equal(values[0], value) for value in values[1:]):
            rows = np.stack([value.reshape(shared.shape) for value in values])
            rows = rows.reshape(len(models), len(models[0]), *shared.shape)
            differing[field.name] = jnp.asarray(rows, shared.dtype)
    return model, differing
