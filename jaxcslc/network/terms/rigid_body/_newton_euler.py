"""Torque and mass matrix of rolled robots: programs that robots of as many joints share."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ....codegen import in_blocks
from .._term import Joints, Matrices
from ._link_motion import Bodies, Geometry, Links, States, cross, link_states, links_of


# Functions of arrays alone: robots of as many joints share one program each.
@jax.jit
def torque_of(
    geometry: Geometry,
    gravity: Float[Array | np.ndarray, "3"],
    bodies: Bodies,
    q: Joints,
    qd: Joints,
    qdd: Joints,
) -> Joints:
    """Joint torques of bodies by Newton and Euler's recursion (thesis 2.3; Luh et al. 1980)."""
    links = links_of(bodies)

    def of_block(q: Array, qd: Array, qdd: Array) -> Array:
        return _torque_of_block(geometry, gravity, links, q, qd, qdd).T

    motion = (samples_last(q), samples_last(qd), samples_last(qdd))
    return in_blocks(of_block, motion, samples_first=True).reshape(q.shape)


def _torque_of_block(
    geometry: Geometry,
    gravity: Float[Array | np.ndarray, "3"],
    links: Links,
    q: Array,
    qd: Array,
    qdd: Array,
) -> Float[Array, "joints samples"]:
    states = link_states(geometry, gravity, q, qd, qdd)[1:]
    axes, (origin, w, wd, a) = states[:, :3], (states[:, i] for i in range(3, 7))

    def inertia_times(x: Any) -> Any:  # I x, with I in the link's axes
        along = jnp.sum(axes * x[:, None], axis=2)
        product = jnp.sum(links.inertia[..., None] * along[:, None], axis=2)
        return jnp.sum(axes * product[:, :, None], axis=1)

    first = jnp.sum(links.first[:, :, None] * axes, axis=1)
    force = links.mass[:, None, None] * a + cross(wd, first) + cross(w, cross(w, first))
    moment = inertia_times(wd) + cross(w, inertia_times(w)) + cross(first, a) + cross(origin, force)
    # What each joint carries, as moments about the base's origin.
    carries = jnp.asarray(geometry.carries)
    force, moment = (
        _product(carries, x.reshape(x.shape[0], 3 * x.shape[2])).reshape(x.shape)
        for x in (force, moment)
    )
    turns = jnp.asarray(geometry.turning)[:, None, None]
    along = turns * (moment - cross(origin, force)) + (1 - turns) * force
    return jnp.sum(axes[:, 2] * along, axis=1) + links.motor[:, None] * qdd


@jax.jit
def mass_matrix_of(geometry: Geometry, bodies: Bodies, q: Joints) -> Matrices:
    """Mass matrices by composite rigid bodies (Walker and Orin 1982), about the base's origin."""
    n, links = q.shape[-1], links_of(bodies)

    def of_block(position: Array) -> Array:
        return _mass_matrix_of_block(geometry, links, position).reshape(n * n, -1).T

    total = in_blocks(of_block, (samples_last(q),), samples_first=True)
    return total.reshape(*q.shape, n)


def _mass_matrix_of_block(
    geometry: Geometry, links: Links, position: Array
) -> Float[Array, "joints joints samples"]:
    still = jnp.zeros_like(position)
    weightless = jnp.zeros(3, position.dtype)
    states = link_states(geometry, weightless, position, still, still)[1:]
    inertia, first, mass = _composite(geometry, links, states)
    # Velocities of the whole at the base's origin, for a unit rate of each joint.
    turns = jnp.asarray(geometry.turning)[:, None, None]
    axis, origin = states[:, 2], states[:, 3]
    angular = turns * axis
    linear = turns * cross(origin, axis) + (1 - turns) * axis
    force = mass[:, None] * linear + cross(angular, first)
    moment = jnp.sum(inertia * angular[:, None], axis=2) + cross(first, linear)
    # Joint j moves what joint k carries if it carries joint k.
    upper = jnp.sum(angular[:, None] * moment[None] + linear[:, None] * force[None], axis=2)
    diagonal = jnp.eye(position.shape[0], dtype=position.dtype)
    upper = upper * geometry.carries[:, :, None]
    below = jnp.swapaxes(upper, 0, 1) * (1 - diagonal)[:, :, None]
    return upper + below + (links.motor[None] * diagonal)[:, :, None]


def _composite(geometry: Geometry, links: Links, states: States) -> tuple[Array, Array, Array]:
    """Inertia, first moment and mass that each joint carries, about the base's origin."""
    turn, p, mass = states[:, :3], states[:, 3], links.mass[:, None]
    # R I R', by columns of R.
    half = jnp.sum(links.inertia[:, :, :, None, None] * turn[:, None], axis=2)
    tensor = jnp.sum(turn[:, :, :, None] * half[:, :, None], axis=1)
    about = jnp.sum(links.first[:, :, None] * turn, axis=1)
    first = about + mass[:, None] * p
    mixed = jnp.sum((2 * about + mass[:, None] * p) * p, axis=1)
    outer = about[:, :, None] * p[:, None] + p[:, :, None] * about[:, None]
    outer = outer + mass[:, None, None] * p[:, :, None] * p[:, None]
    eye = jnp.eye(3, dtype=p.dtype)[None, :, :, None]
    tensor = tensor + mixed[:, None, None] * eye - outer
    n, samples = p.shape[0], p.shape[-1]
    ones = jnp.ones((1, samples), p.dtype)
    parts = tensor.reshape(n, 9, samples), first, (mass * ones)[:, None]
    flat = jnp.concatenate(parts, axis=1).reshape(n, 13 * samples)
    total = _product(jnp.asarray(geometry.carries), flat).reshape(n, 13, samples)
    return total[:, :9].reshape(n, 3, 3, samples), total[:, 9:12], total[:, 12]


def _product(x: Array, y: Array) -> Array:
    """The product of matrices in the precision that they have: GPUs round float32 to ten bits."""
    return jnp.matmul(x, y, precision="highest")


def samples_last(x: Joints) -> Float[Array, "joints samples"]:
    """Joints first, all batch axes in one behind them."""
    return x.reshape(-1, x.shape[-1]).T
