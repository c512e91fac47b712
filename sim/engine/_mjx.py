"""Recordings under MJX: accelerations of links and rotors, and a recording as one program.

`advance.c` does the same for C MuJoCo."""

import copy
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Float, Int
from mujoco import mjx

from jaxcslc.control import AbstractController
from sim.engine._computer import Computer
from sim.engine._hardware import JointHardware
from sim.engine._models import check_time_step, model_of, structure_of
from sim.engine._plan import Plan, RandomDraws, sample_times, stacked
from sim.engine._simulate import SimulatedRecording, SimulationError, assembled
from sim.machine._bodies import MachineError
from sim.machine._events import Carried, Faults, carrying
from sim.machine._machine import Machine
from sim.trajectory._paths import AbstractPath
from sim.trajectory._trajectories import Trajectory


Array = jax.Array | np.ndarray
# Newton's method ends when no joint changes between sliding and sticking: after one to three
# iterations as a rule.
_MOST_ITERATIONS = 50


class Accelerations(NamedTuple):
    """Accelerations of machines at a state, and what acts on them.

    **Attributes**

    - `qdd`: accelerations of the degrees of freedom, (machines, dofs).
    - `friction`: the force of MuJoCo's friction constraint, (machines, dofs).
    - `limits`: the sign of the friction's pull on each link where the link slides, 0 where it
      sticks, (machines, joints).
    """

    qdd: Array
    friction: Array
    limits: Array


class Mechanics(eqx.Module):
    """Links, rotors, transmissions and friction constraints of machines side by side.

    To rounding the accelerations are those of MuJoCo's `mj_forward` for models of `model_of`. MJX
    computes mass matrix and bias forces of the links. Friction acts on one degree of freedom at a
    time, and rotors and transmissions couple with one link each: what is written out here takes
    the place of MJX's general constraint solver, of which every iteration has a search of fifty
    steps that a GPU cannot leave early. `advance.c` does the same for C MuJoCo.

    **Attributes**

    - `links`: an MJX model of the links alone.
    - `differing`: the constants of `links` in which the machines differ, by name.
    - `data`: MJX's data of `links`.
    - `viscous`, `loss`: (machines, dofs): of MuJoCo's damping and friction loss.
    - `stiffness`, `decay`: (machines, dofs): with x = qdd + decay qd, the friction constraint's
      force is -stiffness x, at most `loss` either way.
    - `inertia`: of rotors, (machines, rotors).
    - `slack`: half of each transmission's dead band, (machines, rotors) [rad or m].
    - `spring`, `damping`: of each transmission, (machines, rotors).
    - `soft`: the joints that have a transmission; static.
    - `prismatic`: which joints slide instead of turning; static.
    - `step_length`: of the integrator [s]; static.

    The arrays of `of` have another leading axis: one for each list of models.
    """

    links: mjx.Model
    differing: Mapping[str, Array | np.ndarray]
    data: mjx.Data
    viscous: Float[Array, "*loads machines dofs"]
    loss: Float[Array, "*loads machines dofs"]
    stiffness: Float[Array, "*loads machines dofs"]
    decay: Float[Array, "*loads machines dofs"]
    inertia: Float[Array, "*loads machines rotors"]
    slack: Float[Array, "*loads machines rotors"]
    spring: Float[Array, "*loads machines rotors"]
    damping: Float[Array, "*loads machines rotors"]
    soft: tuple[int, ...] = eqx.field(static=True)
    prismatic: tuple[bool, ...] = eqx.field(static=True)
    step_length: float = eqx.field(static=True)

    @classmethod
    def of(cls, machine: Machine, models: Sequence[Sequence[mujoco.MjModel]]) -> "Mechanics":
        """Mechanics from models of machines with several loads.

        **Arguments**

        - `machine`: one of them, for the structure that all share.
        - `models`: of `model_of`, a list for each load, in which machines have the same place.
        """
        step = models[0][0].opt.timestep
        none = (False,) * machine.joint_count
        template = structure_of(machine.robot, none, none, step)
        of_links = {id(model): _links(template, model) for row in models for model in row}
        links, differing = _side_by_side([[of_links[id(model)] for model in row] for row in models])

        def stacked(values: Any) -> np.ndarray:
            return np.array([[values(model) for model in row] for row in models])

        n = machine.joint_count
        soft = stacked(
            lambda m: (
                m.dof_M0[n:],
                m.tendon_lengthspring[:, 1],
                m.tendon_stiffness,
                m.tendon_damping,
            )
        )
        loss, stiffness, decay = np.moveaxis(stacked(_friction_constraint), 2, 0)
        inertia, slack, spring, damping = np.moveaxis(soft, 2, 0)
        return cls(
            links=links,
            differing=differing,
            data=mjx.make_data(template),
            viscous=stacked(lambda m: m.dof_damping),
            loss=loss,
            stiffness=stiffness,
            decay=decay,
            inertia=inertia,
            slack=slack,
            spring=spring,
            damping=damping,
            soft=tuple(np.flatnonzero(machine.flexible).tolist()),
            prismatic=tuple(joint.kind == "P" for joint in machine.robot.joints),
            step_length=float(step),
        )

    def loaded(self, which: Int[Array, ""]) -> "Mechanics":
        """The mechanics with one of the loads."""
        changing = ("differing", *_ARRAYS)
        parts = [getattr(self, name) for name in changing]
        of_load = jax.tree.map(lambda x: jnp.asarray(x)[which], parts)
        return eqx.tree_at(lambda m: [getattr(m, name) for name in changing], self, of_load)

    def accelerations(
        self,
        q: Float[Array, "machines dofs"],
        qd: Float[Array, "machines dofs"],
        force: Float[Array, "machines dofs"],
        limits: Float[Array, "machines joints"],
    ) -> Accelerations:
        """Accelerations of links and rotors.

        **Arguments**

        - `q`, `qd`: the state.
        - `force`: applied to the degrees of freedom, those of drives included.
        - `limits`: where Newton's method begins, as in `Accelerations`.
        """
        n, soft = limits.shape[1], np.array(self.soft, int)
        axes = jax.tree.map(lambda _: None, self.links)
        axes = axes.tree_replace(dict.fromkeys(self.differing, 0))
        model = self.links.tree_replace(self.differing)
        inertia, bias = jax.vmap(self._links_dynamics, (axes, 0, 0))(model, q[:, :n], qd[:, :n])
        force = force - self.viscous * qd
        target = -self.decay * qd
        on_links = force[:, :n] - bias
        if len(soft):
            twist = q[:, n:] - q[:, soft]
            stretch = twist - jnp.clip(twist, -self.slack, self.slack)
            passed = self.spring * stretch + self.damping * (qd[:, n:] - qd[:, soft])
            on_links = on_links.at[:, soft].add(passed)
            on_rotors = force[:, n:] - passed
            stiffness, loss = self.stiffness[:, n:], self.loss[:, n:]
            sticking = (on_rotors + stiffness * target[:, n:]) / (self.inertia + stiffness)
            slides = _limit(stiffness, loss, sticking - target[:, n:])
            of_rotors = jnp.where(slides == 0, sticking, (on_rotors - slides * loss) / self.inertia)
        else:
            of_rotors = jnp.zeros((len(q), 0))
        of_links, limits = _newton(
            inertia, on_links, target[:, :n], self.stiffness[:, :n], self.loss[:, :n], limits
        )
        qdd = jnp.concatenate([of_links, of_rotors], axis=1)
        friction = _pull(self.stiffness, self.loss, qdd - target)
        return Accelerations(qdd, friction, limits)

    def step(
        self,
        q: Float[Array, "machines dofs"],
        qd: Float[Array, "machines dofs"],
        force: Float[Array, "machines dofs"],
        limits: Float[Array, "machines joints"],
    ) -> tuple[Array, Array, Array]:
        """One step of the fourth-order Runge-Kutta method under constant forces.

        **Arguments** as of `accelerations`.

        **Returns** positions, velocities and limits after it.
        """
        h = self.step_length

        # A loop over the stages: written out, they take four times as long to compile.
        def stage(carry: Any, numbers: Any) -> tuple[Any, None]:
            at, moving, limits, positions, velocities = carry
            part, weight = numbers
            qdd, _, limits = self.accelerations(at, moving, force, limits)
            positions, velocities = positions + weight * moving, velocities + weight * qdd
            return (q + part * moving, qd + part * qdd, limits, positions, velocities), None

        numbers = h * jnp.array([0.5, 0.5, 1.0, 0.0]), h * jnp.array([1.0, 2.0, 2.0, 1.0]) / 6.0
        (_, _, limits, *after), _ = jax.lax.scan(stage, (q, qd, limits, q, qd), numbers)
        return *after, limits

    def _links_dynamics(self, model: mjx.Model, q: Any, qd: Any) -> tuple[Any, Any]:
        """Mass matrix and bias forces of one machine's links."""
        data = self.data.replace(qpos=q, qvel=qd, **_placed(model, q, self.prismatic))
        for part in (mjx.com_pos, mjx.crb, mjx.com_vel, mjx.rne):
            data = part(model, data)
        return mjx.full_m(model, data), data.qfrc_bias


def _placed(model: mjx.Model, q: Any, prismatic: tuple[bool, ...]) -> dict[str, Any]:
    """Poses of a chain's links, by the names of MJX's data: as `mjx.kinematics` has them.

    What each link hands to the next is kept from being fused with it: XLA computed a component of
    the last pose from four of the pose before, each of those from four again, which took most of
    the time of an evaluation.
    """
    position, rotation = jnp.zeros(3), jnp.eye(3)
    positions, rotations, anchors, axes = [position], [rotation], [], []
    turns = _rotations(model.body_quat)
    for i, slides in enumerate(prismatic):
        position = position + _product(rotation, model.body_pos[i + 1][:, None])[:, 0]
        rotation = _product(rotation, turns[i + 1])
        anchors.append(position)
        axes.append(rotation[:, 2])
        if slides:
            position = position + rotation[:, 2] * q[i]
        else:
            c, s = jnp.cos(q[i]), jnp.sin(q[i])
            x, y, z = rotation.T
            rotation = jnp.stack([c * x + s * y, c * y - s * x, z], axis=1)
        position, rotation = jax.lax.optimization_barrier((position, rotation))
        positions.append(position)
        rotations.append(rotation)
    xpos, xmat = jnp.stack(positions), jnp.stack(rotations)
    return {
        "xpos": xpos,
        "xmat": xmat,
        "xanchor": jnp.stack(anchors),
        "xaxis": jnp.stack(axes),
        "xipos": xpos + _product(xmat, model.body_ipos[:, :, None])[:, :, 0],
        "ximat": _product(xmat, _rotations(model.body_iquat)),
    }


def _product(a: Any, b: Any) -> Any:
    """Products of small matrices, elementwise: a GPU's library takes longer to start."""
    return jnp.sum(a[..., :, :, None] * b[..., None, :, :], axis=-2)


def _rotations(quaternions: Float[Array, "bodies 4"]) -> Float[Array, "bodies 3 3"]:
    """Rotation matrices of unit quaternions (w, x, y, z)."""
    w, x, y, z = quaternions.T
    rows = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


_ARRAYS = ("viscous", "loss", "stiffness", "decay", "inertia", "slack", "spring", "damping")


def _limit(stiffness: Any, loss: Any, x: Any) -> Any:
    """Sign of x where friction is at its limit, otherwise 0."""
    return jnp.where(stiffness * x >= loss, 1.0, jnp.where(stiffness * x <= -loss, -1.0, 0.0))


def _pull(stiffness: Any, loss: Any, x: Any) -> Any:
    return jnp.clip(-stiffness * x, -loss, loss)


def _newton(
    inertia: Float[Array, "machines joints joints"],
    force: Float[Array, "machines joints"],
    target: Float[Array, "machines joints"],
    stiffness: Float[Array, "machines joints"],
    loss: Float[Array, "machines joints"],
    limits: Float[Array, "machines joints"],
) -> tuple[Array, Array]:
    """Accelerations a with inertia a = force + friction, and the limits of friction.

    They are the minimum of a convex function, quadratic between the limits of friction. Newton's
    method begins with those limits that held before; where a step overshoots, with the exact
    minimum on its line.
    """
    diagonal = jnp.eye(force.shape[1])

    def going_on(state: tuple[Any, ...]) -> Any:
        iteration, _, _, done = state
        return (iteration < _MOST_ITERATIONS) & ~jnp.all(done)

    def iterate(state: tuple[Any, ...]) -> tuple[Any, ...]:
        iteration, before, limits, done = state
        free = limits == 0
        system = inertia + diagonal * jnp.where(free, stiffness, 0.0)[:, None, :]
        right = force + jnp.where(free, stiffness * target, -limits * loss)
        tried = _solved(system, right)
        same = jnp.all(_limit(stiffness, loss, tried - target) == limits, axis=1)
        shift = tried - before
        share = _least_on_line(inertia, force, target, stiffness, loss, before, shift)
        share = jnp.where(same | (iteration == 0), 1.0, share)
        after = before + share[:, None] * shift
        after = jnp.where(share[:, None] == 1.0, tried, after)
        after = jnp.where(done[:, None], before, after)
        limits = jnp.where(done[:, None], limits, _limit(stiffness, loss, after - target))
        return iteration + 1, after, limits, done | same

    first = (0, jnp.zeros_like(force), limits, jnp.zeros(len(force), bool))
    _, solution, limits, _ = jax.lax.while_loop(going_on, iterate, first)
    return solution, limits


def _least_on_line(
    inertia: Any, force: Any, target: Any, stiffness: Any, loss: Any, at: Any, shift: Any
) -> Float[Array, " machines"]:
    """The share of a shift, from 0 to 1, at which the function of `_newton` is least.

    Its slope along the line grows, and is linear between the shares at which a joint's friction
    reaches a limit: the one where it vanishes lies between the last of them with a negative slope
    and the first with a positive one.
    """
    slope = jnp.sum(shift * (jnp.sum(inertia * at[:, None, :], axis=2) - force), axis=1)
    curvature = jnp.sum(shift * jnp.sum(inertia * shift[:, None, :], axis=2), axis=1)
    reach = jnp.where(stiffness > 0, loss / jnp.where(stiffness > 0, stiffness, 1.0), 0.0)
    moves = shift != 0
    divisor = jnp.where(moves, shift, 1.0)
    borders = [jnp.where(moves, (target + s * reach - at) / divisor, 0.0) for s in (1.0, -1.0)]
    ends = jnp.broadcast_to(jnp.array([0.0, 1.0]), (len(at), 2))
    shares = jnp.clip(jnp.concatenate([*borders, ends], axis=1), 0.0, 1.0)
    moved = at[:, None, :] + shares[:, :, None] * shift[:, None, :]
    pulls = _pull(stiffness[:, None, :], loss[:, None, :], moved - target[:, None, :])
    slopes = slope[:, None] + shares * curvature[:, None] - jnp.sum(shift[:, None] * pulls, axis=2)
    falls = slopes <= 0
    low = jnp.max(jnp.where(falls, shares, 0.0), axis=1)
    high = jnp.min(jnp.where(falls, 1.0, shares), axis=1)
    before = jnp.max(jnp.where(falls, slopes, -jnp.inf), axis=1)
    after = jnp.min(jnp.where(falls, jnp.inf, slopes), axis=1)
    between = jnp.isfinite(before) & jnp.isfinite(after)
    rise = jnp.where(between, after - before, 1.0)
    part = jnp.where(between, -before / rise, 0.0)
    return jnp.where(jnp.all(falls, axis=1), 1.0, low + part * (high - low))


def _solved(
    system: Float[Array, "machines n n"], right: Float[Array, "machines n"]
) -> Float[Array, "machines n"]:
    """Solutions of positive definite systems by elimination, an elementwise operation a row: a
    GPU's library takes several times as long for factors of small matrices."""
    rows = jnp.concatenate([system, right[:, :, None]], axis=2)
    n = right.shape[1]
    for k in range(n):
        pivot_row = rows[:, k, 1:] / rows[:, k, :1]
        others = rows[:, :, 1:] - rows[:, :, :1] * pivot_row[:, None, :]
        rows = jnp.where((np.arange(n) == k)[None, :, None], pivot_row[:, None, :], others)
    return rows[:, :, 0]


def _friction_constraint(model: mujoco.MjModel) -> np.ndarray:
    """Loss, stiffness and decay of the friction constraint of each degree of freedom, as MuJoCo's
    mj_makeImpedance and mj_referenceConstraint have them."""
    least, most = mujoco.mjMINIMP, mujoco.mjMAXIMP
    impedance = np.clip(0.5 * (model.dof_solimp[:, 0] + model.dof_solimp[:, 1]), least, most)
    time = np.maximum(model.dof_solref[:, 0], 2 * model.opt.timestep)
    loss = model.dof_frictionloss
    softness = np.maximum((1 - impedance) / impedance * model.dof_invweight0, mujoco.mjMINVAL)
    stiffness = np.where(loss > 0, 1 / softness, 0.0)
    return np.stack([loss, stiffness, 2 / np.maximum(impedance * time, mujoco.mjMINVAL)])


def _links(template: mujoco.MjModel, whole: mujoco.MjModel) -> mujoco.MjModel:
    """The links of a model, without rotors and friction."""
    model, n = copy.copy(template), template.nv
    for name in ("body_mass", "body_ipos", "body_iquat", "body_inertia"):
        getattr(model, name)[:] = getattr(whole, name)[: n + 1]
    model.dof_armature[:] = whole.dof_armature[:n]
    return model


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
            rows = np.stack(values).reshape(len(models), len(models[0]), *shared.shape)
            differing[field.name] = jnp.asarray(rows, shared.dtype)
    return model, differing


def perform_mjx(
    machines: Sequence[Machine],
    trajectory: Trajectory,
    seeds: Sequence[int],
    *,
    advanced: Callable[[int], object] | None = None,
) -> list[SimulatedRecording | SimulationError]:
    """Do what `perform` does, under MJX on JAX's default device.

    A whole recording is one compiled program; another trajectory or number of machines is
    compiled anew. The results agree with those of `perform` to rounding, which open-loop motion
    through stick and slip magnifies.

    **Raises** `MachineError`: as `perform`; and if JAX's 64-bit mode is off.
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
