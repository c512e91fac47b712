import functools
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxcslc.manipulator import LinkParameters, Manipulator
from sim.machine._bodies import MachineError
from sim.machine._machine import Machine
from sim.trajectory._kinematics import Hand


# Configurations in which gravity torque is evaluated: a PUMA's maximum is within 2 %.
_POSTURES = 256


def check_gravity(machine: Machine, links: Sequence[LinkParameters]) -> None:
    """Refuses a drive that cannot hold up its joint at rest.

    - `links`: of the machine, with what it carries.

    **Raises**

    - `MachineError`: names the first joint whose torque limit is below gravity's need.
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
    """What multiplies mass and first moments of each link, in frame i, in the torque of each joint.

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
    frames = Hand.of(robot).frames(low + share * (high - low))  # (postures, 4, 4, n)
    rotation, origin = frames[:, :3, :3], frames[:, :3, 3]
    columns = np.zeros((_POSTURES, n, n, 4))
    for i in range(n):
        axis, centre = rotation[:, :, 2, i], origin[:, :, i]
        # g·(z x r) = (g x z)·r, of the origin of link j's frame and of its axes.
        lifted = -np.cross(gravity, axis)
        for j in range(i, n):
            if robot.joints[i].kind == "P":
                columns[:, i, j, 0] = -axis @ gravity
                continue
            columns[:, i, j, 0] = np.sum(lifted * (origin[:, :, j] - centre), axis=1)
            columns[:, i, j, 1:] = np.einsum("pa,pab->pb", lifted, rotation[:, :, :, j])
    return columns.reshape(_POSTURES, n, 4 * n)
