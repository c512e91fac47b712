"""How links move, by a scan over them, and what of robots the scan reads."""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from ....derivation import BODY
from ....manipulator import Joint


Samples = Float[Array, "joints samples"]
States = Float[Array, "frames 7 3 samples"]


class Geometry(NamedTuple):
    """What leads from each link's parent to the link, and which joints carry which links.

    Arrays, not attributes of the program: robots of as many joints share what is compiled.
    """

    carrier: Int[Array | np.ndarray, " links"]  # 0 is the base
    turn: Float[Array | np.ndarray, "links 3 3"]
    step: Float[Array | np.ndarray, "links 3"]
    turning: Float[Array | np.ndarray, " links"]  # 1: revolute, 0: prismatic
    carries: Float[Array | np.ndarray, "joints links"]  # 1 where a joint carries a link


def paths_of(parents: Sequence[int]) -> tuple[tuple[int, ...], ...]:
    """The joints that carry each link, from the base outwards."""
    paths: list[tuple[int, ...]] = []
    for i, parent in enumerate(parents):
        paths.append((*(paths[parent] if parent >= 0 else ()), i))
    return tuple(paths)


@lru_cache(maxsize=256)
def geometry_of(
    joints: tuple[Joint, ...], paths: tuple[tuple[int, ...], ...], dtype: np.dtype
) -> Geometry:
    """The numbers of a chain or tree of joints, in a precision."""
    placed = [_placement(joint) for joint in joints]
    carries = np.zeros((len(paths), len(paths)), dtype)
    for link, path in enumerate(paths):
        carries[list(path), link] = 1.0
    return Geometry(
        np.array([path[-2] + 1 if len(path) > 1 else 0 for path in paths]),
        np.array([turn for turn, _ in placed], dtype),
        np.array([step for _, step in placed], dtype),
        np.array([joint.kind == "R" for joint in joints], dtype),
        carries,
    )


# Ten numbers of a link, and its motor's inertia.
_NUMBERS = len(BODY) + 1


class Bodies(NamedTuple):
    """Links as linear functions of their coefficients, those that there are and zeros."""

    body: Float[Array | np.ndarray, "links eleven eleven"]
    k: Float[Array | np.ndarray, "links eleven"]


class Links(NamedTuple):
    """Of every link, about its frame's origin and in its axes."""

    inertia: Float[Array, "links 3 3"]
    first: Float[Array, "links 3 1"]
    mass: Float[Array, " links"]
    motor: Float[Array, " links"]


@lru_cache(maxsize=256)
def by_link(
    body: tuple[tuple[tuple[float, ...], ...], ...],
    indices: tuple[tuple[int, ...], ...],
    motors: tuple[tuple[int, int], ...],
    size: int,
) -> tuple[Int[np.ndarray, "links eleven"], Float[np.ndarray, "links eleven eleven"]]:
    """Which coefficients are a link's, and what they are of its ten numbers and motor inertia."""
    index = np.full((len(body), _NUMBERS), size)
    matrix = np.zeros((len(body), _NUMBERS, _NUMBERS))
    for link, of_link in enumerate(indices):
        if of_link:
            index[link, : len(of_link)] = of_link
            matrix[link, :-1, : len(of_link)] = np.array(body[link])
    for joint, motor in motors:
        index[joint, -1] = motor
        matrix[joint, -1, -1] = 1.0
    return index, matrix


def links_of(bodies: Bodies) -> Links:
    ten = jnp.sum(bodies.body * bodies.k[:, None], axis=2)
    xx, yy, zz, xy, xz, yz = (ten[:, i] for i in range(6))
    tensor = jnp.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(-1, 3, 3)
    return Links(tensor, ten[:, 6:9, None], ten[:, 9], ten[:, 10])


def link_states(
    geometry: Geometry,
    gravity: Float[Array | np.ndarray, "3"],
    q: Samples,
    qd: Samples,
    qdd: Samples,
) -> States:
    """Outward recursion over the links (thesis 2.3; Luh, Walker and Paul 1980).

    **Returns** seven vectors per frame, the base's first, in its axes: axes x, y and z, origin,
    angular velocity, angular acceleration, and acceleration of the origin less gravity.

    A scan over links: it compiles in a fifth of the time that the unrolled recursion took, and
    what one link needs of another is in memory. Unrolled, the compiler writes the whole way from
    the base into every link that uses it.
    """
    (n, samples), dtype = q.shape, q.dtype
    at_rest = np.concatenate([np.eye(3), np.zeros((3, 3))]).astype(dtype)
    at_base = jnp.concatenate([at_rest, -jnp.asarray(gravity, dtype)[None]])[:, :, None]
    states = jnp.zeros((n + 1, 7, 3, samples), dtype).at[0].set(at_base)
    steps = tuple(jnp.asarray(x) for x in geometry[:4])
    states, _ = lax.scan(_outwards, states, (jnp.arange(1, n + 1), steps, q, qd, qdd))
    return states


def cross(x: Any, y: Any) -> Any:
    """Vector product along the last axis but one; `jnp.cross` would move it to the end and back."""
    (x0, x1, x2), (y0, y1, y2) = (_components(v) for v in (x, y))
    return jnp.stack([x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0], axis=-2)


def _components(x: Any) -> tuple[Any, ...]:
    return tuple(lax.index_in_dim(x, i, -2, keepdims=False) for i in range(3))


# At the top of the module, and without anything from around it: outside of `jit` a scan is
# compiled once for a function, not once a call.
def _outwards(states: States, at: tuple[Any, ...]) -> tuple[States, None]:
    number, (carrier, turn, step, turning), *rates = at
    before = lax.dynamic_index_in_dim(states, carrier, keepdims=False)
    state = _next_frame(before, turn, step, turning, *(rate[None, :] for rate in rates))
    return lax.dynamic_update_index_in_dim(states, state, number, 0), None


def _next_frame(
    before: Float[Array, "7 3 samples"],
    turn: Float[Array | np.ndarray, "3 3"],
    step: Float[Array | np.ndarray, "3"],
    turning: Any,
    q: Float[Array, "1 samples"],
    qd: Float[Array, "1 samples"],
    qdd: Float[Array, "1 samples"],
) -> Float[Array, "7 3 samples"]:
    """The motion of a link, from that of the frame before it."""
    x, y, z, origin, w, wd, a = before

    def onward(column: Any) -> Any:
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
    return jnp.stack(state)


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
