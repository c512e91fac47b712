import math
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from ...manipulator import Joint


Samples = Float[Array, "joints samples"]
Vector = Float[Array, "3 samples"]
States = Float[Array, "frames 7 3 samples"]


class LinkMotion(NamedTuple):
    """How every link moves: links first, samples last, all vectors in the base frame.

    `axes` are the columns of the rotations from links to base, one frame's x, y and z;
    `acceleration` is that of the frame's origin, less gravity.
    """

    axes: Float[Array, "links 3 3 samples"]
    origin: Float[Array, "links 3 samples"]
    angular_velocity: Float[Array, "links 3 samples"]
    angular_acceleration: Float[Array, "links 3 samples"]
    acceleration: Float[Array, "links 3 samples"]


class _Step(NamedTuple):
    """What leads from a link's parent to the link, for all links."""

    carrier: Int[Array, " links"]  # 0 is the base
    turn: Float[Array, "links 3 3"]
    step: Float[Array, "links 3"]
    turning: Float[Array, " links"]  # 1: revolute, 0: prismatic


def paths_of(parents: Sequence[int]) -> tuple[tuple[int, ...], ...]:
    """The joints that carry each link, from the base outwards."""
    paths: list[tuple[int, ...]] = []
    for i, parent in enumerate(parents):
        paths.append((*(paths[parent] if parent >= 0 else ()), i))
    return tuple(paths)


def link_motion(
    joints: Sequence[Joint],
    paths: Sequence[Sequence[int]],
    gravity: tuple[float, float, float],
    q: Samples,
    qd: Samples,
    qdd: Samples,
) -> LinkMotion:
    """Outward recursion over the links (thesis 2.3; Luh, Walker and Paul 1980)."""
    states = link_states(joints, paths, gravity, q, qd, qdd)[1:]
    return LinkMotion(states[:, :3], states[:, 3], states[:, 4], states[:, 5], states[:, 6])


def link_states(
    joints: Sequence[Joint],
    paths: Sequence[Sequence[int]],
    gravity: tuple[float, float, float],
    q: Samples,
    qd: Samples,
    qdd: Samples,
) -> States:
    """The fields of `LinkMotion`, seven vectors a frame, the base first.

    A scan over links: it compiles in a fifth of the time that the unrolled recursion took, and
    what one link needs of another is in memory. Unrolled, the compiler writes the whole way from
    the base into every link that uses it.
    """
    dtype, samples = q.dtype, q.shape[1]
    at_base = np.concatenate([np.eye(3), np.zeros((3, 3)), -np.array([gravity])])
    states = jnp.zeros((len(joints) + 1, 7, 3, samples), dtype)
    states = states.at[0].set(jnp.asarray(at_base, dtype)[:, :, None])
    placed = [_placement(joint) for joint in joints]
    steps = _Step(
        jnp.asarray([path[-2] + 1 if len(path) > 1 else 0 for path in paths]),
        jnp.asarray(np.array([turn for turn, _ in placed]), dtype),
        jnp.asarray(np.array([step for _, step in placed]), dtype),
        turning_of(joints, dtype),
    )
    numbers = jnp.arange(1, len(joints) + 1)
    states, _ = lax.scan(_outwards, states, (numbers, steps, q, qd, qdd))
    return states


def turning_of(joints: Sequence[Joint], dtype: np.dtype) -> Float[Array, " joints"]:
    """1 for revolute joints, 0 for prismatic ones."""
    return jnp.asarray(np.array([joint.kind == "R" for joint in joints]), dtype)


def cross(x: Array, y: Array, axis: int = -2) -> Array:
    """Vector product along an axis of three; `jnp.cross` would move it to the end and back."""
    x0, x1, x2 = (lax.index_in_dim(x, i, axis, keepdims=False) for i in range(3))
    y0, y1, y2 = (lax.index_in_dim(y, i, axis, keepdims=False) for i in range(3))
    return jnp.stack([x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0], axis=axis)


# At the top of the module, and without anything from around it: outside of `jit` a scan is
# compiled once for a function, not once a call.
def _outwards(states: States, at: tuple[Array, _Step, Array, Array, Array]) -> tuple[States, None]:
    number, (carrier, turn, step, turning), *rates = at
    q, qd, qdd = (rate[None, :] for rate in rates)
    x, y, z, origin, w, wd, a = lax.dynamic_index_in_dim(states, carrier, keepdims=False)

    def onward(column: Array) -> Vector:
        return x * column[0] + y * column[1] + z * column[2]

    angle, way = turning * q, (1 - turning) * q
    c, s = jnp.cos(angle), jnp.sin(angle)
    first, second, axis = (onward(turn[:, i]) for i in range(3))
    along = onward(step) + way * axis
    spin, slide = turning * qd * axis, (1 - turning) * qd * axis
    a = a + cross(wd, along) + cross(w, cross(w, along) + 2 * slide) + (1 - turning) * qdd * axis
    state = (
        *(c * first + s * second, c * second - s * first, axis),
        *(origin + along, w + spin, wd + turning * qdd * axis + cross(w, spin), a),
    )
    return lax.dynamic_update_index_in_dim(states, jnp.stack(state), number, 0), None


def _placement(joint: Joint) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and step, in the parent's frame, at joint variable zero (Eqn. 2.6-1)."""

    def about(axis: int, angle: float) -> np.ndarray:
        i, j = (axis + 1) % 3, (axis + 2) % 3
        matrix = np.eye(3)
        matrix[i, i] = matrix[j, j] = math.cos(angle)
        matrix[i, j], matrix[j, i] = -math.sin(angle), math.sin(angle)
        return matrix

    a, d, b = (length.value or 0.0 for _, _, length in joint.lengths)
    branch, twist = about(2, joint.gamma), about(0, joint.alpha)
    step = branch @ (np.array([a, 0.0, b]) + twist @ np.array([0.0, 0.0, d]))
    return branch @ twist @ about(2, joint.theta), step
