from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from functools import lru_cache
from itertools import chain, pairwise
from typing import TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...._environment import array_namespace
from ....codegen import CompiledProgram, Motion, Value, in_stage
from ....derivation import Algebra, Coefficient, PositionRing, Table
from .._input_term import by_joint
from .._term import (
    AbstractManipulatorTerm,
    Coefficients,
    Columns,
    Joints,
    Matrices,
    Regressor,
    Rows,
)
from ._closed_form import ClosedForm


Samples = Float[Array | np.ndarray, "*batch"]
Monomial = tuple[int, ...]


class RigidBodyTables(AbstractManipulatorTerm):
    """The CSLC as the thesis draws it: preprocessed inputs, links, context-sensitive layers.

    Straight-line code over one array a quantity and joint, so that a batch is the only axis
    there is. Every sum over links is formed once for each element and coefficient, and serves
    both torques that an off-diagonal element of the mass matrix enters.
    """

    mass: Table = eqx.field(static=True)
    velocity: Table = eqx.field(static=True)
    gravity: Table = eqx.field(static=True)
    ring: PositionRing = eqx.field(static=True)
    coefficients: tuple[Coefficient, ...] = eqx.field(static=True)
    joint_count: int = eqx.field(static=True)
    kind: str = eqx.field(static=True, default="rigid_body")

    @classmethod
    def from_algebra(cls, algebra: Algebra) -> "RigidBodyTables":
        return cls(
            mass=algebra.mass,
            velocity=algebra.velocity,
            gravity=algebra.gravity,
            ring=algebra.ring,
            coefficients=algebra.coefficients,
            joint_count=algebra.robot.joint_count,
        )

    @property
    def has_tables(self) -> bool:
        """Whether the closed form is small enough to be computed from its tables."""
        return True

    @property
    def parts(self) -> tuple[str, ...]:
        return ("mass", "velocity", "gravity")

    @property
    def support(self) -> tuple[tuple[int, ...], ...]:
        return _support(self.mass, self.velocity, self.gravity, self.joint_count)

    @property
    def has_host_columns(self) -> bool:
        return True

    def columns(self, q: Rows, qd: Rows, qdd: Rows) -> Columns:
        if isinstance(q, np.ndarray):
            rows = self._program()(q, np.asarray(qd), np.asarray(qdd))
            ends = np.cumsum([len(support) for support in self.support])[:-1]
            return tuple(np.split(rows, ends))
        entries = self._entries(list(q), list(qd), list(qdd))
        zero = jnp.zeros_like(q[0])
        return tuple(
            jnp.stack([entries[joint, p] for p in support])
            if support
            else jnp.zeros((0, *zero.shape), zero.dtype)
            for joint, support in enumerate(self.support)
        )

    def write_columns(
        self, into: Sequence[Float[np.ndarray, "_ samples"]], q: Rows, qd: Rows, qdd: Rows
    ) -> None:
        rows = [row for of_joint in into for row in of_joint]
        self._program().write(rows, np.asarray(q), np.asarray(qd), np.asarray(qdd))

    def entries(self, motion: Motion) -> Iterator[tuple[int, int, Value]]:
        """Joint, coefficient and value of the regressor's entries, as expressions."""
        tables = {"mass": self.mass, "velocity": self.velocity, "gravity": self.gravity}
        for (joint, index), value in ClosedForm(motion, self.ring, **tables).entries().items():
            yield joint, index, value

    def _program(self) -> CompiledProgram:
        return _program(self.ring, self.mass, self.velocity, self.gravity, self.joint_count)

    def regressor(self, q: Joints, qd: Joints, qdd: Joints) -> Regressor:
        if self.size == 0:
            return jnp.zeros((*q.shape, 0), q.dtype)
        entries = self._entries(by_joint(q), by_joint(qd), by_joint(qdd))
        zero = jnp.zeros_like(q[..., 0])
        return jnp.stack(
            [
                jnp.stack([entries.get((j, p), zero) for p in range(self.size)], axis=-1)
                for j in range(self.joint_count)
            ],
            axis=-2,
        )

    def _entries(
        self, q: Sequence[Samples], qd: Sequence[Samples], qdd: Sequence[Samples]
    ) -> dict[tuple[int, int], Samples]:
        """The entries of the regressor that are ever non-zero, as {(joint, coefficient): array}.

        In three stages that the compiler may not merge: variables, inputs, entries. Merged, it
        repeats the inputs' products in each of the hundred entries that use them, at a third
        of the speed.
        """
        used = tuple(
            dict.fromkeys((*self.mass.inputs, *self.velocity.inputs, *self.gravity.inputs))
        )
        variables = in_stage(lambda q: position_variables(self.ring, q), list(q))
        values = in_stage(lambda variables: products(used, variables), variables)
        inputs = dict(zip(used, values, strict=True)).__getitem__

        entries: dict[tuple[int, int], Samples] = {}
        for (j, k), coefficient, value in _sums(self.mass, inputs):
            _add(entries, (j, coefficient), value * qdd[k])
            if j != k:
                _add(entries, (k, coefficient), value * qdd[j])
        rates = _rate_products(qd)
        for (i, j, k), coefficient, value in _sums(self.velocity, inputs):
            _add(entries, (i, coefficient), value * rates(j, k))
        for (j,), coefficient, value in _sums(self.gravity, inputs):
            _add(entries, (j, coefficient), value)
        return entries

    def torque(self, k: Coefficients, q: Joints, qd: Joints, qdd: Joints) -> Joints:
        used = (*self.mass.inputs, *self.velocity.inputs, *self.gravity.inputs)
        inputs = input_layer(self.ring, used, by_joint(q))
        total = self._mass_term(k, inputs, by_joint(qdd))
        for term in (self._velocity_term(k, inputs, by_joint(qd)), self._gravity_term(k, inputs)):
            for joint, value in term.items():
                _add(total, joint, value)
        return self._stack(total, q)

    def mass_matrix(self, k: Coefficients, q: Joints) -> Matrices:
        elements = _elements(self.mass, k, input_layer(self.ring, self.mass.inputs, by_joint(q)))
        zero = jnp.zeros_like(q[..., 0])
        rows = [
            jnp.stack(
                [elements.get((min(j, i), max(j, i)), zero) for i in range(self.joint_count)],
                axis=-1,
            )
            for j in range(self.joint_count)
        ]
        return jnp.stack(rows, axis=-2)

    def velocity_term(self, k: Coefficients, q: Joints, qd: Joints) -> Joints:
        inputs = input_layer(self.ring, self.velocity.inputs, by_joint(q))
        return self._stack(self._velocity_term(k, inputs, by_joint(qd)), q)

    def gravity_term(self, k: Coefficients, q: Joints) -> Joints:
        inputs = input_layer(self.ring, self.gravity.inputs, by_joint(q))
        return self._stack(self._gravity_term(k, inputs), q)

    def christoffel_symbols(
        self, k: Float[Array, " coefficients"], q: Float[Array, "*batch joints"]
    ) -> dict[tuple[int, ...], Samples]:
        """The symbols c_ijk, j <= k, that are not identically zero (Eqn. 2.4-5)."""
        return _elements(
            self.velocity, k, input_layer(self.ring, self.velocity.inputs, by_joint(q))
        )

    def _mass_term(self, k: Array, inputs: "Inputs", qdd: Sequence[Samples]) -> dict[int, Samples]:
        total: dict[int, Samples] = {}
        for (i, j), value in _elements(self.mass, k, inputs).items():
            _add(total, i, value * qdd[j])
            if i != j:
                _add(total, j, value * qdd[i])
        return total

    def _velocity_term(
        self, k: Array, inputs: "Inputs", qd: Sequence[Samples]
    ) -> dict[int, Samples]:
        total: dict[int, Samples] = {}
        rates = _rate_products(qd)
        for (i, j, m), value in _elements(self.velocity, k, inputs).items():
            _add(total, i, value * rates(j, m))
        return total

    def _gravity_term(self, k: Array, inputs: "Inputs") -> dict[int, Samples]:
        return {joint: value for (joint,), value in _elements(self.gravity, k, inputs).items()}

    def _stack(self, total: dict[int, Samples], like: Array) -> Array:
        zero = jnp.zeros_like(like[..., 0])
        return jnp.stack([total.get(joint, zero) for joint in range(self.joint_count)], axis=-1)


@lru_cache(maxsize=64)  # tables are compared by identity
def _support(
    mass: Table, velocity: Table, gravity: Table, joints: int
) -> tuple[tuple[int, ...], ...]:
    """For each joint, the coefficients of the elements that enter its torque."""
    reach: list[set[int]] = [set() for _ in range(joints)]
    for table, outputs in ((mass, 2), (velocity, 1), (gravity, 1)):
        for link in table.links:
            for joint in table.columns[link.column][:outputs]:
                reach[joint] |= {coefficient for coefficient, _ in link.weights}
    return tuple(tuple(sorted(coefficients)) for coefficients in reach)


@lru_cache(maxsize=64)
def _program(
    ring: PositionRing, mass: Table, velocity: Table, gravity: Table, joints: int
) -> CompiledProgram:
    """The columns of all joints, one behind the other, for NumPy's arrays."""
    motion = Motion(joints)
    entries = ClosedForm(motion, ring, mass=mass, velocity=velocity, gravity=gravity).entries()
    supports = enumerate(_support(mass, velocity, gravity, joints))
    outputs = tuple(entries[joint, p] for joint, support in supports for p in support)
    return CompiledProgram(motion, outputs)


Inputs = Callable[[tuple[int, ...]], Samples]


Key = TypeVar("Key")


def _add(total: dict[Key, Samples], key: Key, value: Samples) -> None:
    total[key] = total[key] + value if key in total else value


def _rate_products(qd: Sequence[Samples]) -> Callable[[int, int], Samples]:
    """qd_j qd_k, twice that if j != k: c_ijk = c_ikj stand for one link (Eqn. 5.1-5, 5.1-6)."""
    rates: dict[tuple[int, int], Samples] = {}

    def product(j: int, k: int) -> Samples:
        if (j, k) not in rates:
            rates[j, k] = qd[j] * qd[k] if j == k else 2 * qd[j] * qd[k]
        return rates[j, k]

    return product


def _sums(table: Table, inputs: Inputs) -> list[tuple[tuple[int, ...], int, Samples]]:
    """For every element and coefficient, the sum over links of multiple times input."""
    sums: dict[tuple[int, int], Samples] = {}
    multiples: dict[tuple[int, Fraction], Samples] = {}  # each formed once
    for link in table.links:
        for coefficient, multiple in link.weights:
            term = link.input, multiple
            if term not in multiples:
                multiples[term] = _times(float(multiple), inputs(table.inputs[link.input]))
            _add(sums, (link.column, coefficient), multiples[term])
    return [
        (table.columns[column], coefficient, value) for (column, coefficient), value in sums.items()
    ]


def _elements(
    table: Table, k: Float[Array, " coefficients"], inputs: Inputs
) -> dict[tuple[int, ...], Samples]:
    """Every element of a table that has links: the sum of weight times input.

    Each coefficient is taken out of `k` once and each weight formed once: many links have the same,
    and every operation less is less to compile.
    """
    entries = {index: k[index] for index in sorted(table.coefficients)}
    weights: dict[tuple[tuple[int, Fraction], ...], Samples] = {}
    elements: dict[tuple[int, ...], Samples] = {}
    for link in table.links:
        if link.weights not in weights:
            first, *others = [_times(float(x), entries[index]) for index, x in link.weights]
            weights[link.weights] = sum(others, first)
        term = weights[link.weights] * inputs(table.inputs[link.input])
        column = table.columns[link.column]
        elements[column] = elements[column] + term if column in elements else term
    return elements


def _times(factor: float, value: Samples) -> Samples:
    if factor == 1.0:
        return value
    return -value if factor == -1.0 else factor * value


def position_variables(ring: PositionRing, q: Sequence[Samples]) -> list[Samples]:
    """Values of the ring's variables: cosine and sine of every angle, prismatic positions.

    `q` is one array a joint.
    """
    xp = array_namespace(*q)
    variables: list[Samples] = []
    for angle in ring.chain.angles:
        joint, sign = angle.terms[0]
        total = q[joint] if sign > 0 else -q[joint]
        for joint, sign in angle.terms[1:]:
            total = total + q[joint] if sign > 0 else total - q[joint]
        variables += [xp.cos(total), xp.sin(total)]
    return variables + [q[i] for i, link in enumerate(ring.chain.links) if link.prismatic]


def products(monomials: Sequence[Monomial], variables: Sequence[Samples]) -> list[Samples]:
    """Values of monomials, each formed once, from the product without its last factor."""
    one = array_namespace(*variables).ones_like(variables[0])
    values: dict[Monomial, Samples] = {(0,) * len(variables): one}

    def value(monomial: Monomial) -> Samples:
        if monomial not in values:
            last = max(index for index, power in enumerate(monomial) if power)
            powers = list(monomial)
            powers[last] -= 1
            shorter = tuple(powers)
            values[monomial] = (
                variables[last] if not any(shorter) else value(shorter) * variables[last]
            )
        return values[monomial]

    return [value(monomial) for monomial in monomials]


def product_rows(
    monomials: Sequence[Monomial], variables: Float[Array, " variables *batch"]
) -> Float[Array, " monomials *batch"]:
    """`products` as one array: one gathered product for each degree.

    A Panda's tables have 9,500 monomials. Written out, they are that many operations, which XLA
    compiles for 50 s on one core; this is two operations for each of some fifteen degrees, and
    half a second.
    """
    degrees: list[list[Monomial]] = [[(0,) * len(variables)]]
    parents: dict[Monomial, tuple[Monomial, int]] = {}
    pending = list(monomials)
    while pending:
        monomial = pending.pop()
        if monomial in parents or not any(monomial):
            continue
        last = max(index for index, power in enumerate(monomial) if power)
        shorter = (*monomial[:last], monomial[last] - 1, *monomial[last + 1 :])
        parents[monomial] = shorter, last
        pending.append(shorter)
    for monomial in sorted(parents, key=lambda monomial: (sum(monomial), monomial)):
        if sum(monomial) == len(degrees):
            degrees.append([])
        degrees[-1].append(monomial)
    levels = [jnp.ones_like(variables[:1])]
    for shorter, level in pairwise(degrees):
        index = {monomial: row for row, monomial in enumerate(shorter)}
        factors = [(index[before], last) for before, last in map(parents.__getitem__, level)]
        before, last = np.array(factors).T
        levels.append(levels[-1][before] * variables[last])
    rows = {monomial: row for row, monomial in enumerate(chain.from_iterable(degrees))}
    order = np.array([rows[monomial] for monomial in monomials], int)
    return jnp.concatenate(levels)[order]


def input_layer(
    ring: PositionRing, monomials: Sequence[Monomial], q: Sequence[Samples]
) -> Callable[[Monomial], Samples]:
    """The preprocessing layer: joint positions to products of sines and cosines (thesis 5.1.1).

    Sines and cosines are a stage of their own: fused, the compiler recomputes them for every
    torque (1.1 instead of 2.3 million PUMA 560 patterns/s on two busy cores).
    """
    variables = in_stage(lambda q: position_variables(ring, q), list(q))
    values = products(monomials, variables)
    return dict(zip(monomials, values, strict=True)).__getitem__


def input_rows(
    ring: PositionRing, monomials: Sequence[Monomial], q: Sequence[Samples]
) -> Float[Array, " monomials *batch"]:
    """The preprocessing layer as one array: quick to compile, however many monomials there are.

    **Arguments**

    - `ring`: of the positions, `algebra.ring` of a network.
    - `monomials`: powers of the ring's variables, such as `algebra.mass.inputs`.
    - `q`: positions, one array a joint [rad or m].

    **Returns** their values, a row a monomial.

    >>> import jax.numpy as jnp, jaxcslc as jc
    >>> from jaxcslc.network import input_rows
    >>> algebra = jc.derive(jc.puma560()).algebra
    >>> input_rows(algebra.ring, algebra.mass.inputs, list(jnp.zeros((6, 100)))).shape
    (59, 100)
    """
    return product_rows(monomials, jnp.stack(position_variables(ring, q)))
