"""Torque by each number of each link, by a scan over pairs of a joint and a link."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ._link_motion import Geometry, States, cross, link_states


def unit_torques(
    geometry: Geometry,
    gravity: Float[Array | np.ndarray, "3"],
    paths: Sequence[Sequence[int]],
    q: Any,
    qd: Any,
    qdd: Any,
) -> Any:
    """Each joint's torque by each of the ten numbers of every link that it carries.

    - `paths`: the joints that carry each link.
    - `q`, `qd`, `qdd`: (joints, samples).

    **Returns** rows, of as many columns as samples: of `pairs_of` ten each, then the accelerations,
    then zeros.
    """
    states = link_states(geometry, gravity, q, qd, qdd)
    links, joints = pairs_of(paths)
    turns = jnp.asarray(geometry.turning[joints])
    indices = jnp.asarray(links + 1), jnp.asarray(joints + 1), turns
    _, ten = lax.scan(_unit_torques_of_pair, states, indices)
    rows = ten.reshape(10 * len(links), q.shape[1])
    return jnp.concatenate([rows, qdd, jnp.zeros((1, q.shape[1]), q.dtype)])


def _unit_torques_of_pair(states: States, pair: tuple[Array, Array, Array]) -> tuple[States, Array]:
    link, joint, turning = pair
    of_link, of_joint = (lax.dynamic_index_in_dim(states, i, keepdims=False) for i in (link, joint))
    return states, _pair_torques(of_link, of_joint, turning)


def _pair_torques(link: Any, joint: Any, turning: Any) -> Any:
    """A joint's torque by each of a link's (Ixx Iyy Izz Ixy Ixz Iyz hx hy hz m), (10, samples).

    - `link`, `joint`: the states of their frames.
    - `turning`: 1 for a revolute joint, 0 for a prismatic one.
    """
    x, y, z, origin, w, wd, a = link
    axis, pivot = joint[2], joint[3]
    angular = turning * axis
    linear = turning * cross(axis, origin - pivot) + (1 - turning) * axis

    def along_axes(vector: Any) -> list[Any]:  # of the link
        return [jnp.sum(vector * along, axis=-2) for along in (x, y, z)]

    # A moment of inertia about the link's x: torque (I wd + w x I w) along the joint's axis.
    turn, gain, rate, twist = (along_axes(x) for x in (angular, wd, w, cross(angular, w)))
    ten = [turn[i] * gain[i] + twist[i] * rate[i] for i in range(3)]
    ten += [
        turn[i] * gain[j] + turn[j] * gain[i] + twist[i] * rate[j] + twist[j] * rate[i]
        for i, j in ((0, 1), (0, 2), (1, 2))
    ]
    # A first moment h: force wd x h + w x (w x h), moment h x a, both seen from h.
    ten += along_axes(cross(linear, wd) + cross(cross(linear, w), w) + cross(a, angular))
    ten.append(jnp.sum(linear * a, axis=-2))
    return jnp.stack(ten, axis=-2)


def pairs_of(paths: Sequence[Sequence[int]]) -> tuple[np.ndarray, np.ndarray]:
    """Links and joints of all pairs in which the joint carries the link."""
    pairs = [(link, joint) for link, path in enumerate(paths) for joint in path]
    links, joints = np.array(pairs).T
    return links, joints
