"""Newton and Euler's recursion by scans of JAX: programs that robots of as many joints share.

Vectors are in the base's axes, so that what a joint carries is a product with a matrix of ones and
zeros, and torque by single numbers of links a scan over pairs. (Unrolled, the recursion is in the
links' axes, in which right angles and zero lengths leave few operations.)
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from jaxcslc.codegen import in_blocks
from jaxcslc.derivation import BODY
from jaxcslc.manipulator import Joint, steps_at_zero

from ._term import Joints, Matrices


Samples = Float[Array, "joints samples"]
States = Float[Array, "frames 7 3 samples"]


class Geometry(NamedTuple):
    """Step from each link's parent to the link, and the joints that carry each link.

    Arrays, not attributes of the program: robots of as many joints share what is compiled.
    """

    carrier: Int[Array | np.ndarray, " links"]  # 0 is the base
    turn: Float[Array | np.ndarray, "links 3 3"]
    step: Float[Array | np.ndarray, "links 3"]
    turning: Float[Array | np.ndarray, " links"]  # 1: revolute, 0: prismatic
    carries: Float[Array | np.ndarray, "joints links"]  # 1 where a joint carries a link


def carrying_joints(parents: Sequence[int]) -> tuple[tuple[int, ...], ...]:
    """The joints that carry each link, from the base outwards."""
    paths: list[tuple[int, ...]] = []
    for i, parent in enumerate(parents):
        paths.append((*(paths[parent] if parent >= 0 else ()), i))
    return tuple(paths)


@lru_cache(maxsize=256)
def chain_geometry(
    joints: tuple[Joint, ...], paths: tuple[tuple[int, ...], ...], dtype: np.dtype
) -> Geometry:
    """The numbers of a chain or tree of joints, in a precision."""
    placed = steps_at_zero(joints).astype(dtype)
    carries = np.zeros((len(paths), len(paths)), dtype)
    for link, path in enumerate(paths):
        carries[list(path), link] = 1.0
    return Geometry(
        np.array([path[-2] + 1 if len(path) > 1 else 0 for path in paths]),
        placed[:, :3, :3],
        placed[:, :3, 3],
        np.array([joint.kind == "R" for joint in joints], dtype),
        carries,
    )


# Ten numbers of a link, and its motor's inertia.
_NUMBERS = len(BODY) + 1


class Bodies(NamedTuple):
    """Links as linear functions of their coefficients, those that there are and zeros."""

    body: Float[Array | np.ndarray, "links eleven eleven"]
    k: Float[Array | np.ndarray, "links eleven"]


class RolledLinks(NamedTuple):
    """Inertial parameters of every link, about its frame's origin and in its axes."""

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
    """Return the indices of each link's coefficients, and a matrix per link.

    The matrix maps these coefficients to the link's ten numbers and motor inertia.
    """
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


def rolled_links(bodies: Bodies) -> RolledLinks:
    ten = jnp.sum(bodies.body * bodies.k[:, None], axis=2)
    xx, yy, zz, xy, xz, yz = (ten[:, i] for i in range(6))
    tensor = jnp.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(-1, 3, 3)
    return RolledLinks(tensor, ten[:, 6:9, None], ten[:, 9], ten[:, 10])


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


# Functions of arrays alone: robots of as many joints share one program each.
@jax.jit
def rolled_torque(
    geometry: Geometry,
    gravity: Float[Array | np.ndarray, "3"],
    bodies: Bodies,
    q: Joints,
    qd: Joints,
    qdd: Joints,
) -> Joints:
    """Joint torques of bodies by Newton and Euler's recursion (thesis 2.3; Luh et al. 1980)."""
    links = rolled_links(bodies)

    def of_block(q: Array, qd: Array, qdd: Array) -> Array:
        return _block_torque(geometry, gravity, links, q, qd, qdd).T

    motion = (samples_last(q), samples_last(qd), samples_last(qdd))
    return in_blocks(of_block, motion, samples_first=True).reshape(q.shape)


def _block_torque(
    geometry: Geometry,
    gravity: Float[Array | np.ndarray, "3"],
    links: RolledLinks,
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
def rolled_mass_matrix(geometry: Geometry, bodies: Bodies, q: Joints) -> Matrices:
    """Mass matrices by composite rigid bodies (Walker and Orin 1982), about the base's origin."""
    n, links = q.shape[-1], rolled_links(bodies)

    def of_block(position: Array) -> Array:
        return _block_mass_matrix(geometry, links, position).reshape(n * n, -1).T

    total = in_blocks(of_block, (samples_last(q),), samples_first=True)
    return total.reshape(*q.shape, n)


def _block_mass_matrix(
    geometry: Geometry, links: RolledLinks, position: Array
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


def _composite(
    geometry: Geometry, links: RolledLinks, states: States
) -> tuple[Array, Array, Array]:
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


def unit_torques(
    geometry: Geometry,
    gravity: Float[Array | np.ndarray, "3"],
    paths: Sequence[Sequence[int]],
    q: Any,
    qd: Any,
    qdd: Any,
) -> Any:
    """Return each joint's torque by each of the ten numbers of every link that it carries.

    - `paths`: the joints that carry each link.
    - `q`, `qd`, `qdd`: (joints, samples).

    **Returns** rows, of as many columns as samples: ten for each of `carried_pairs`, then
    the accelerations, then zeros.
    """
    states = link_states(geometry, gravity, q, qd, qdd)
    links, joints = carried_pairs(paths)
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


def carried_pairs(paths: Sequence[Sequence[int]]) -> tuple[np.ndarray, np.ndarray]:
    """Links and joints of all pairs in which the joint carries the link."""
    pairs = [(link, joint) for link, path in enumerate(paths) for joint in path]
    links, joints = np.array(pairs).T
    return links, joints
