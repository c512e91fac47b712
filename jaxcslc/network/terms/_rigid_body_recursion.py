"""The rigid-body term by Newton and Euler's recursion, and a payload's, which is one body more."""

import dataclasses
import math
from collections.abc import Collection, Sequence
from fractions import Fraction
from functools import lru_cache, partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from jaxcslc._environment import platform_of
from jaxcslc.codegen import Expressions, Motion, StraightLine, Value, in_blocks, motion_outputs
from jaxcslc.derivation import (
    BODY,
    Addend,
    Algebra,
    Chain,
    Coefficient,
    NewtonEuler,
    inertial_terms,
    link_frames,
)
from jaxcslc.manipulator import Joint, LinkInertia, Manipulator, RobotError

from ._rigid_body import PARTS, AbstractExpressedBodies, AbstractRigidBody, code
from ._rolled import (
    Bodies,
    Geometry,
    by_link,
    carried_pairs,
    carrying_joints,
    chain_geometry,
    rolled_mass_matrix,
    rolled_torque,
    samples_last,
    unit_torques,
)
from ._term import Coefficients, Joints, Rows


# Straight-line code of so many joints compiles within seconds; its operations grow with the square
# of the joints for the torque, with the third power for the regressor.
_MOST_JOINTS = 12
# On a processor it compiles for 2 to 4 s longer than the loop, and gains that in so many samples.
_MANY_SAMPLES = 1 << 20


class RigidBodyRecursion(AbstractRigidBody):
    """Newton-Euler over link parameters, for robots whose closed-form tables are large.

    Cost grows with the square of the number of joints, not with the number of monomials. It
    needs numeric lengths: then the torque is that of bodies which have the base parameters
    (`Algebra.unit_inertias`).

    It has two forms. Rolled, links are scanned over, and so are pairs of a link and a joint that
    carries it: compile time is nearly independent of the number of joints, and robots of as many
    joints share a program. Unrolled, it is straight-line code in which right angles and zero
    lengths make most operations vanish: some times quicker, and it compiles for longer.

    **Attributes**

    - `body`: for every link, the matrix (10, coefficients of the link) from its coefficients to
      (Ixx Iyy Izz Ixy Ixz Iyz hx hy hz m), as nested tuples.
    - `indices`: for every link, its coefficients.
    - `motors`: a joint and the coefficient of its motor's inertia, each.
    - `paths`: the joints that carry each link, from the base outwards.
    - `unrolled`: which form; None for the one that was measured to be quicker: unrolled on a GPU,
      and on a processor from a million samples, for robots of up to 12 joints.
    """

    body: tuple[tuple[tuple[float, ...], ...], ...] = eqx.field(static=True)
    joints: tuple[Joint, ...] = eqx.field(static=True)
    gravity: tuple[float, float, float] = eqx.field(static=True)
    indices: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    motors: tuple[tuple[int, int], ...] = eqx.field(static=True)
    paths: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    coefficients: tuple[Coefficient, ...] = eqx.field(static=True)
    kind: str = eqx.field(static=True, default="rigid_body")
    unrolled: bool | None = eqx.field(static=True, default=None)

    @classmethod
    def from_algebra(cls, algebra: Algebra, unrolled: bool | None = None) -> "RigidBodyRecursion":
        """**Raises** `ValueError` if the algebra kept lengths symbolic."""
        if algebra.lengths != "numeric":
            raise ValueError(
                "the recursive evaluator needs numeric lengths: symbolic coefficients are not"
                " independent once lengths have values; derive with lengths='numeric'"
            )
        n = algebra.robot.joint_count
        indices: list[list[int]] = [[] for _ in range(n)]
        columns: list[list[tuple[float, ...]]] = [[] for _ in range(n)]
        motors: list[tuple[int, int]] = []
        for index, unit in enumerate(algebra.unit_inertias):
            if unit.motor:
                motors.append((unit.link, index))
            else:
                indices[unit.link].append(index)
                columns[unit.link].append(tuple(float(entry) for entry in unit.body))
        body = tuple(tuple(zip(*c, strict=True)) if c else ((),) * len(BODY) for c in columns)
        by_link = tuple(tuple(link) for link in indices)
        term = cls.from_bodies(algebra.robot, body, by_link, tuple(motors), algebra.coefficients)
        return dataclasses.replace(term, unrolled=unrolled)

    @classmethod
    def from_bodies(
        cls,
        robot: Manipulator,
        body: tuple[tuple[tuple[float, ...], ...], ...],
        indices: tuple[tuple[int, ...], ...],
        motors: tuple[tuple[int, int], ...],
        coefficients: tuple[Coefficient, ...] = (),
        kind: str = "rigid_body",
    ) -> "RigidBodyRecursion":
        """Make the term of bodies that a robot's links carry; arguments as the attributes."""
        return cls(
            body=body,
            joints=robot.joints,
            gravity=robot.gravity,
            indices=indices,
            motors=motors,
            paths=carrying_joints(robot.parents),
            coefficients=coefficients,
            kind=kind,
        )

    @property
    def has_tables(self) -> bool:
        return False

    @property
    def support(self) -> tuple[tuple[int, ...], ...]:
        return _support(self.indices, self.motors, self.paths)

    def expressed(self, motion: Motion) -> "RecursiveBodies":
        return RecursiveBodies(motion, self)

    def _column_rows(self, q: Rows, qd: Rows, qdd: Rows) -> Float[Array, "rows samples"]:
        if self.is_unrolled(q, q.shape[::-1]):
            return _unrolled(code(self, "columns"), None, q.T, qd.T, qdd.T)
        return self._rolled_entries(False, q, qd, qdd)

    @eqx.filter_jit
    def _rolled_entries(self, dense: bool, *motion: Any) -> Float[Array, "..."]:
        """Entries of the regressor by joint and coefficient.

        - `dense`: whether all of them, (..., entries), of motion (..., joints). Otherwise those of
          the support, (entries, samples), of motion (joints, samples).
        """
        indices = [range(self.size)] * len(self.joints) if dense else self.support
        entries = [(joint, index) for joint, row in enumerate(indices) for index in row]

        def of_block(*block: Array) -> Array:
            rows = self._gathered(self._unit_torques(*block), entries)
            return rows.T if dense else rows

        if not dense:
            return in_blocks(of_block, motion)
        rows = in_blocks(of_block, tuple(map(samples_last, motion)), samples_first=True)
        return rows.reshape(*motion[0].shape[:-1], len(entries))

    def _values(
        self, quantity: str, k: Coefficients | None, *motion: Joints
    ) -> Float[Array, "*batch values"]:
        q = motion[0]
        if self.is_unrolled(q, q.shape):
            rows = _unrolled(code(self, quantity), k, *(x.reshape(-1, x.shape[-1]) for x in motion))
            return rows.T.reshape(*q.shape[:-1], len(rows))
        if k is None:
            return self._rolled_entries(True, *motion)
        geometry, bodies = self._geometry(q.dtype), self._bodies(k)
        if quantity == "mass_matrix":
            return rolled_mass_matrix(geometry, bodies, q).reshape(*q.shape[:-1], -1)
        gravity = np.zeros(3) if quantity == "velocity" else np.array(self.gravity)
        still = [jnp.zeros_like(q)] * (3 - len(motion))
        return rolled_torque(geometry, gravity.astype(q.dtype), bodies, *motion, *still)

    def is_unrolled(self, q: Any, shape: tuple[int, ...]) -> bool:
        """Return whether the unrolled form computes with positions of a shape (..., joints)."""
        if self.unrolled is not None:
            return self.unrolled
        *batch, joints = shape
        if joints > _MOST_JOINTS:
            return False
        return platform_of(q) != "cpu" or math.prod(batch) >= _MANY_SAMPLES

    def _geometry(self, dtype: Any) -> Geometry:
        return chain_geometry(self.joints, self.paths, np.dtype(dtype))

    def _bodies(self, k: Array) -> Bodies:
        """The coefficients by link, which are as many for every robot of so many joints."""
        index, body = by_link(self.body, self.indices, self.motors, self.size)
        # Behind the last one stands a zero. Outside of `jit` there is nothing to compile.
        xp = jnp if isinstance(k, Tracer) else np
        padded = xp.concatenate([xp.asarray(k, k.dtype), xp.zeros(1, k.dtype)])
        return Bodies(body.astype(k.dtype), padded[index])

    def _unit_torques(self, *motion: Any) -> Any:
        """Compute `unit_torques` of samples last."""
        dtype = motion[0].dtype
        gravity = np.array(self.gravity, dtype)
        return unit_torques(self._geometry(dtype), gravity, self.paths, *motion)

    def _gathered(
        self, torques: Float[Array, "rows samples"], entries: list[tuple[int, int]]
    ) -> Float[Array, "_ samples"]:
        """Regressor entries (joint, coefficient) as sums of rows of `unit_torques`."""
        zero_row = torques.shape[0] - 1
        if not entries:
            return torques[:0]
        sums = [self._rows(joint, index) for joint, index in entries]
        total: Array | None = None
        for part in range(max(map(len, sums))):
            terms = [rows[part] if part < len(rows) else (zero_row, 0.0) for rows in sums]
            picked = torques[np.array([row for row, _ in terms])]
            factors = np.array([factor for _, factor in terms])
            if not np.all(factors == 1.0):
                picked = picked * jnp.asarray(factors, torques.dtype)[:, None]
            total = picked if total is None else total + picked
        assert total is not None
        return total

    def _rows(self, joint: int, index: int) -> list[tuple[int, float]]:
        """Rows of `unit_torques`, and multiples, of which one entry of the regressor is made."""
        link, joints = carried_pairs(self.paths)
        zero_row = 10 * len(link) + len(self.joints)
        for motor, motor_index in self.motors:
            if motor_index == index:
                return [(10 * len(link) + motor, 1.0) if motor == joint else (zero_row, 1.0)]
        (body,) = [i for i, indices in enumerate(self.indices) if index in indices]
        if joint not in self.paths[body]:
            return [(zero_row, 1.0)]
        (pair,) = np.flatnonzero((link == body) & (joints == joint))
        column = self.indices[body].index(index)
        return [
            (10 * int(pair) + entry, row[column])
            for entry, row in enumerate(self.body[body])
            if row[column]
        ]


@partial(jax.jit, static_argnames=("expressed",))
def _unrolled(
    expressed: StraightLine,
    k: Float[Array, " coefficients"] | None,
    *motion: Float[Array, "samples joints"],
) -> Float[Array, "outputs samples"]:
    """The outputs of straight-line code for many samples of q, qd and qdd, as many as it needs.

    One array a quantity and joint, so that a compiler can keep all of a sample in registers.
    """

    def of_block(*rows: Array) -> Array:
        return jnp.stack(motion_outputs(expressed, k, *map(list, rows)))

    return in_blocks(of_block, tuple(x.T for x in motion))


@lru_cache(maxsize=256)
def _support(
    indices: tuple[tuple[int, ...], ...],
    motors: tuple[tuple[int, int], ...],
    paths: tuple[tuple[int, ...], ...],
) -> tuple[tuple[int, ...], ...]:
    """Return, for each joint, the coefficients of all links that it carries and of its motor."""
    carried = [
        [
            index
            for path, link in zip(paths, indices, strict=True)
            if joint in path
            for index in link
        ]
        for joint in range(len(paths))
    ]
    for joint, motor in motors:
        carried[joint].append(motor)
    return tuple(tuple(sorted(joint)) for joint in carried)


# An angle this close to a multiple of 90 degrees is meant to be it [rad].
_RIGHT_ANGLE = 1e-14


@dataclasses.dataclass(frozen=True, eq=False)
class RecursiveBodies(AbstractExpressedBodies):
    """A chain or tree of bodies over expressions: a term, and the motion of its joints."""

    motion: Motion
    term: RigidBodyRecursion

    def torque(self, k: Any, parts: Collection[str] = PARTS) -> list[Value]:
        motion, still = self.motion, [0.0] * len(self.motion.q)
        recursion = self._recursion(self.term.gravity if "gravity" in parts else (0.0, 0.0, 0.0))
        qd = motion.qd if "velocity" in parts else still
        qdd = motion.qdd if "mass" in parts else still
        return motion.values(recursion.torque(*self._numbers(k), qd, qdd))

    def mass_matrix(self, k: Any) -> list[list[Value]]:
        rows = self._recursion(self.term.gravity).mass_matrix(*self._numbers(k))
        return [self.motion.values(row) for row in rows]

    def entries(self) -> dict[tuple[int, int], Value]:
        motion, term = self.motion, self.term
        units = [
            (link, index, [row[column] for row in term.body[link]])
            for link, indices in enumerate(term.indices)
            for column, index in enumerate(indices)
        ]
        rows = self._recursion(self.term.gravity).columns(
            [(link, unit) for link, _, unit in units], motion.qd, motion.qdd
        )
        entries: dict[tuple[int, int], Value] = {}
        for joint, row in enumerate(rows):
            for (_, index, _), x in zip(units, motion.values(row), strict=True):
                if not x.is_zero:
                    entries[joint, index] = x
            entries |= {(i, index): motion.qdd[i] for i, index in self.term.motors if i == joint}
        return entries

    def _recursion(self, gravity: tuple[float, float, float]) -> NewtonEuler:
        parents = tuple(path[-2] if len(path) > 1 else -1 for path in self.term.paths)
        return newton_euler(self.motion, self.term.joints, parents, gravity)

    def _numbers(self, k: Any) -> tuple[list[list[Any]], list[Any]]:
        """Every link's ten numbers and every motor's inertia."""
        links: list[list[Any]] = []
        for rows, indices in zip(self.term.body, self.term.indices, strict=True):
            links.append(
                [
                    sum(k[i] * factor for i, factor in zip(indices, row, strict=True) if factor)
                    for row in rows
                ]
            )
        motors: list[Any] = [0.0] * len(self.term.joints)
        for joint, index in self.term.motors:
            motors[joint] = k[index]
        return links, motors


def newton_euler(
    motion: Motion,
    joints: Sequence[Joint],
    parents: Sequence[int],
    gravity: tuple[float, float, float],
) -> NewtonEuler:
    """The recursion of a robot over expressions of its motion.

    Unrolled, and without what right angles and zero lengths make trivial: a Panda's regressor of
    base parameters is 1,245 operations, a PUMA 560's 505.

    - `motion`: of the joints.
    - `joints`: a row of modified Denavit-Hartenberg parameters each, all lengths in numbers.
    - `parents`: the index of the link that carries each link, -1 for the base.
    - `gravity`: in the base frame [m/s²].

    >>> import jaxcslc as jc
    >>> robot, motion = jc.puma560(), Motion(6)
    >>> arm = newton_euler(motion, robot.joints, robot.parents, robot.gravity)
    >>> point_mass = 5, (0, 0, 0, 0, 0, 0, 0, 0, 0, 1)  # at the origin of the last frame
    >>> rows = arm.columns([point_mass], motion.qd, motion.qdd)
    >>> [motion.graph.cost(motion.values(row)) for row in rows]
    [159, 136, 131, 0, 0, 0]
    """
    a, d, b = ([float(getattr(joint, letter).value or 0.0) for joint in joints] for letter in "adb")
    frames = link_frames(
        Chain.from_joints(joints, parents).in_numbers(float),
        rotations=[
            _rotation(motion.graph, joint, q) for joint, q in zip(joints, motion.q, strict=True)
        ],
        a=a,
        d=[
            offset + q if joint.kind == "P" else offset
            for offset, joint, q in zip(d, joints, motion.q, strict=True)
        ],
        b=b,
    )
    return NewtonEuler(frames, gravity)


def _rotation(graph: Expressions, joint: Joint, q: Value) -> tuple[Value, Value]:
    """Cosine and sine of a joint's angle about z; multiples of 90 degrees are exact."""
    quarters = round(joint.theta / (math.pi / 2))
    remainder = joint.theta - quarters * (math.pi / 2)
    if abs(remainder) < _RIGHT_ANGLE:
        remainder = 0.0
    if joint.kind == "P":
        c, s = graph.constant(math.cos(remainder)), graph.constant(math.sin(remainder))
    else:
        c, s = graph.apply("cos", q + remainder), graph.apply("sin", q + remainder)
    for _ in range(quarters % 4):
        c, s = -s, c
    return c, s


PAYLOAD = tuple(f"p{entry}" for entry in BODY)
"""Names of a payload's ten coefficients, in their order in `k`."""

_NOTHING = LinkInertia(
    zero=("m", "rx", "ry", "rz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz"), motor=False
)
_UNITS = {"I": "kg m²", "h": "kg m", "m": "kg"}


def carrier(robot: Manipulator, link: int | None = None) -> Manipulator:
    """Return the robot without any mass except that of a body fixed to one link, its last one if
    omitted.

    What the thesis calls an additional link (8.2.4), of ten unknown inertial parameters: rigidly
    attached, it has no joint of its own, and its frame can be the carrying link's. Derive it to
    see which parameters of a payload the arm's torques depend on at all.

    **Arguments**

    - `robot`: that carries.
    - `link`: that carries the body, counted from 1; the last one if None.

    **Raises** `RobotError`: there is no such link; counted from 1.

    >>> import jaxcslc as jc
    >>> from jaxcslc.network import carrier
    >>> jc.derive(carrier(jc.puma560()), lengths="numeric").size
    10
    """
    n = robot.joint_count
    link = n if link is None else link
    if not 1 <= link <= n:
        raise RobotError(f"robot {robot.name!r}: there is no link {link}; expected 1 to {n}")
    body = LinkInertia("full", motor=False)
    return Manipulator(
        name=f"payload of {robot.name}",
        joints=robot.joints,
        inertia=tuple(body if i == link else _NOTHING for i in range(1, n + 1)),
        gravity=robot.gravity,
        friction=(),
    )


def payload_term(carrying: Manipulator) -> RigidBodyRecursion:
    """Newton-Euler over the body of a `carrier`, with a coefficient for each of its ten numbers.

    All ten numbers, not the fewest that the torque depends on: whether a body is physically
    possible depends on all of them, and a fit reports those that a motion, or an arm of few
    joints, leaves undetermined.
    """
    size = len(BODY)
    unit = tuple(tuple(float(i == j) for j in range(size)) for i in range(size))
    link = inertial_terms(carrying)[0].link
    links = range(carrying.joint_count)
    body = tuple(unit if i == link else ((),) * size for i in links)
    indices = tuple(tuple(range(size)) if i == link else () for i in links)
    coefficients = _coefficients(carrying)
    return RigidBodyRecursion.from_bodies(carrying, body, indices, (), coefficients, "payload")


@lru_cache(maxsize=64)  # coefficients are compared by identity
def _coefficients(carrying: Manipulator) -> tuple[Coefficient, ...]:
    coefficients: list[Coefficient] = []
    for name, term in zip(PAYLOAD, inertial_terms(carrying), strict=True):
        label = "*".join(f"{factor}p" for factor in term.factors)
        positive = name in ("pIxx", "pIyy", "pIzz", "pm")
        addend = Addend(Fraction(1), (), term)
        coefficients.append(
            Coefficient(name, "payload", label, _UNITS[name[1]], positive, (addend,))
        )
    return tuple(coefficients)
