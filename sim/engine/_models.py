"""Mechanics of a machine as a model of MuJoCo, and whether its drives can hold it up at rest.

`_mjcf` writes the structure that all models of a robot share. Models are read by `_plant` and
`_mjx`."""

import copy
import functools
import math
from collections.abc import Sequence

import mujoco
import numpy as np
import scipy.linalg
from jaxtyping import Float

from jaxcslc.manipulator import LinkParameters, Manipulator, link_poses
from sim.engine._mjcf import mjcf, rigid_bodies
from sim.machine._bodies import MachineError
from sim.machine._drivetrain import Transmission, friction_of
from sim.machine._machine import Machine


# Configurations in which gravity torque is evaluated: a PUMA's maximum is within 2 %.
_POSTURES = 256


def check_gravity(machine: Machine, links: Sequence[LinkParameters]) -> None:
    """Refuses a drive that cannot hold up its joint at rest.

    - `links`: of the machine, with what it carries.

    **Raises** `MachineError`: names the first joint whose torque limit is below gravity's need.
    """
    limits = np.array(machine.maximum_torque)
    if not np.isfinite(limits).any() or not any(machine.robot.gravity):
        return
    most = largest_gravity(machine.robot, links, machine.position_range)
    for i in np.flatnonzero(most > limits):
        raise MachineError(
            f"maximum_torque of joint {i + 1} is {limits[i]:g}; expected no less than gravity"
            f" needs, {most[i]:.3g}"
        )


def largest_gravity(
    robot: Manipulator,
    links: Sequence[LinkParameters],
    position_range: tuple[tuple[float, float], ...],
) -> Float[np.ndarray, " joints"]:
    """The largest modulus of each joint's gravity torque in random postures within its range [N m
    or N].

    Gravity torque is linear in the masses and first moments of the links: what multiplies them in
    these postures is the same for all machines of one geometry.
    """
    columns = _gravity_columns(robot, position_range)
    mass = np.array([float(link.mass) for link in links])
    centre = np.array([np.asarray(link.centre_of_gravity, float) for link in links])
    moments = np.concatenate([mass[:, None], mass[:, None] * centre], axis=1).ravel()
    return np.max(np.abs(columns @ moments), axis=0)


@functools.lru_cache(maxsize=16)
def _gravity_columns(
    robot: Manipulator, position_range: tuple[tuple[float, float], ...]
) -> Float[np.ndarray, "postures joints moments"]:
    """Return the factors of mass and first moments of each link, in frame i, in joints' torques.

    A joint's torque is what lifts the links after it: the derivative of their potential energy,
    -m g·p, where p moves by z x (p - o) as a revolute joint turns, by z as a prismatic one slides.
    """
    n, gravity = robot.joint_count, np.array(robot.gravity, dtype=float)
    low, high = np.array(position_range, dtype=float).T
    low, high = (
        np.where(np.isfinite(low), low, -math.pi),
        np.where(np.isfinite(high), high, math.pi),
    )
    share = np.random.default_rng(0).uniform(size=(_POSTURES, n))
    poses = link_poses(robot, low + share * (high - low))
    rotation, origin = poses[..., :3, :3], poses[..., :3, 3]
    columns = np.zeros((_POSTURES, n, n, 4))
    for i in range(n):
        axis, centre = rotation[:, i, :, 2], origin[:, i]
        # g·(z x r) = (g x z)·r, of the origin of link j's frame and of its axes.
        lifted = -np.cross(gravity, axis)
        for j in range(i, n):
            if robot.joints[i].kind == "P":
                columns[:, i, j, 0] = -axis @ gravity
                continue
            columns[:, i, j, 0] = np.sum(lifted * (origin[:, j] - centre), axis=1)
            columns[:, i, j, 1:] = np.einsum("pa,pab->pb", lifted, rotation[:, j])
    return columns.reshape(_POSTURES, n, 4 * n)


# A fourth-order Runge-Kutta method is stable up to 2.8 rad of an undamped oscillation a step. At
# 1.5 each step removes a twentieth of the amplitude, of an oscillation too fast to matter.
_LARGEST_PHASE = 1.5


def model_of(machine: Machine, step: float) -> mujoco.MjModel:
    """A machine's mechanics as a MuJoCo model with a time step [s].

    **Raises** `MachineError`: a torque limit below gravity's need, or a time step too long for a
    transmission.
    """
    friction, links = friction_of(machine), machine.links
    check_gravity(machine, links)
    sticks = tuple((friction.static > 0).tolist())
    model = copy.copy(structure_of(machine.robot, machine.flexible, sticks, step))
    n, soft = machine.joint_count, np.flatnonzero(machine.flexible)
    for i, body in enumerate(rigid_bodies(machine.robot, links), start=1):
        model.body_mass[i], model.body_ipos[i] = body.mass, body.centre
        model.body_inertia[i], model.body_iquat[i] = body.moments, body.axes
    motor = np.array([float(link.motor_inertia) for link in links])
    model.dof_armature[:n] = np.where(machine.flexible, 0.0, motor)
    model.dof_armature[n:] = motor[soft]
    model.dof_damping[:], model.dof_frictionloss[:] = friction.viscous, friction.static
    if soft.size:
        half = np.array(machine.backlash)[soft] / 2
        model.tendon_lengthspring[:] = np.stack([-half, half], axis=1)
        model.tendon_stiffness[:] = np.array(machine.stiffness)[soft]
        model.tendon_damping[:] = np.array(machine.transmission_damping)[soft]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    model.stat.meaninertia = np.mean(model.dof_M0)  # as the compiler does
    return model


@functools.lru_cache(maxsize=16)
def structure_of(
    robot: Manipulator, flexible: tuple[bool, ...], sticks: tuple[bool, ...], step: float
) -> mujoco.MjModel:
    """A model of machines that differ in numbers alone: to fill in takes a fourth of the time of
    compiling each."""
    # MuJoCo has short cuts for bodies with axes along their frame's, which others must not get.
    body = LinkParameters(1.0, np.array([0.1, 0.2, 0.3]), np.eye(3) + 0.1 * np.ones((3, 3)), 1.0)
    model = mujoco.MjModel.from_xml_string(
        mjcf(
            robot,
            [body] * robot.joint_count,
            breakaway=[float(stuck) for stuck in sticks],
            stiffness=[1.0 if soft else math.inf for soft in flexible],
            time_step=step,
        )
    )
    # Without a reset by MuJoCo, a state that is not finite stays visible.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    # Friction of a chain's joints is one island: looking for islands takes a sixth of a step.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
    return model


def check_time_step(
    machine: Machine, model: mujoco.MjModel, position: Float[np.ndarray, " joints"]
) -> None:
    """Refuses a step too long for the quickest oscillation or decay of a machine's transmissions.

    **Raises** `MachineError`: names the joint and the longest step.
    """
    n, dofs = machine.joint_count, model.nv
    transmission = Transmission.of(machine)
    if dofs == n:
        return
    data = mujoco.MjData(model)
    data.qpos[:n], data.qpos[transmission.rotor] = position, position
    mujoco.mj_forward(model, data)
    mass, stiffness, damping = np.zeros((3, dofs, dofs))
    mujoco.mj_fullM(model, data, mass)
    for i in np.flatnonzero(transmission.flexible):
        apart = np.zeros(dofs)
        apart[transmission.rotor[i]], apart[i] = 1.0, -1.0
        stiffness += machine.stiffness[i] * np.outer(apart, apart)
        damping += machine.transmission_damping[i] * np.outer(apart, apart)
    squares, shapes = scipy.linalg.eigh(stiffness, mass)
    decays = scipy.linalg.eigh(damping, mass, eigvals_only=True)
    quickest = max(math.sqrt(float(squares[-1])), float(decays[-1]))
    if model.opt.timestep * quickest > _LARGEST_PHASE:
        joint = int(np.argmax(np.abs(shapes[:n, -1]))) + 1
        raise MachineError(
            f"time_step is {model.opt.timestep:.3g} s; expected no more than"
            f" {_LARGEST_PHASE / quickest:.3g} s for the transmission of joint {joint}"
        )
