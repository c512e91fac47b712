"""The rigid-body term from the tables of its closed form, and the preprocessing layer (thesis 5.1).

`ClosedForm` has the tables over expressions; `RigidBodyTables` is the term whose values they are.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from fractions import Fraction
from functools import lru_cache
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxcslc.codegen import Expressions, Motion, StraightLine, Value, motion_outputs
from jaxcslc.derivation import Algebra, Coefficient, PositionRing, ProductTable

from ._input_term import by_joint
from ._rigid_body import PARTS, AbstractExpressedBodies, AbstractRigidBody, code
from ._term import Coefficients, Joints, Rows


Samples = Float[Array | np.ndarray, "*batch"]
Monomial = tuple[int, ...]
Polynomial = dict[Monomial, Any]


class ClosedForm(AbstractExpressedBodies):
    """A network's tables over expressions: polynomials in sines and cosines (thesis 5.1).

    Sums are nested (Horner): the variable that most of the monomials have is taken out, and so
    on inside and outside of the bracket. Each element of a table is formed once, and serves both
    torques that an off-diagonal element of the mass matrix enters.
    """

    def __init__(self, motion: Motion, tables: Algebra) -> None:
        self.motion, self._tables = motion, tables
        graph = motion.graph

        def sine(x: Value) -> Value:
            minus, size = x.signed()
            return -graph.apply("sin", size) if minus else graph.apply("sin", size)

        self._variables = position_variables(
            tables.ring, motion.q, lambda x: graph.apply("cos", x.signed()[1]), sine
        )

    def torque(self, k: Any, parts: Collection[str] = PARTS) -> list[Value]:
        motion = self.motion
        total = [motion.graph.constant(0.0)] * len(motion.q)
        if "mass" in parts:
            for (i, j), value in self._elements(self._tables.mass, k).items():
                total[i] = total[i] + value * motion.qdd[j]
                if i != j:
                    total[j] = total[j] + value * motion.qdd[i]
        if "velocity" in parts:
            for (i, j, m), value in self.christoffel_symbols(k).items():
                total[i] = total[i] + value * self._rates(j, m)
        if "gravity" in parts:
            for (i,), value in self._elements(self._tables.gravity, k).items():
                total[i] = total[i] + value
        return total

    def mass_matrix(self, k: Any) -> list[list[Value]]:
        n, zero = len(self.motion.q), self.motion.graph.constant(0.0)
        elements = self._elements(self._tables.mass, k)
        return [[elements.get((min(i, j), max(i, j)), zero) for j in range(n)] for i in range(n)]

    def christoffel_symbols(self, k: Any) -> dict[tuple[int, ...], Value]:
        """Return the symbols c_ijk, j <= k, that are not identically zero (Eqn. 2.4-5)."""
        return self._elements(self._tables.velocity, k)

    def entries(self) -> dict[tuple[int, int], Value]:
        motion, tables = self.motion, self._tables
        entries: dict[tuple[int, int], Value] = {}

        def put(joint: int, coefficient: int, value: Value) -> None:
            key = joint, coefficient
            entries[key] = entries[key] + value if key in entries else value

        for (j, m), coefficient, value in self._sums(tables.mass):
            put(j, coefficient, value * motion.qdd[m])
            if j != m:
                put(m, coefficient, value * motion.qdd[j])
        for (i, j, m), coefficient, value in self._sums(tables.velocity):
            put(i, coefficient, value * self._rates(j, m))
        for (j,), coefficient, value in self._sums(tables.gravity):
            put(j, coefficient, value)
        return entries

    def _rates(self, j: int, m: int) -> Value:
        """qd_j qd_m, twice that if j != m: c_ijm = c_imj stand for one link (Eqn. 5.1-5, 5.1-6)."""
        return self.motion.qd[j] * self.motion.qd[m] * (1.0 if j == m else 2.0)

    def _elements(self, table: ProductTable, k: Any) -> dict[tuple[int, ...], Value]:
        """Every element of a table that has links: the sum of weight times input."""
        elements: dict[int, Polynomial] = {}
        for link in table.links:
            weight = sum(k[index] * float(multiple) for index, multiple in link.weights)
            element, monomial = elements.setdefault(link.column, {}), table.inputs[link.input]
            element[monomial] = element[monomial] + weight if monomial in element else weight
        return {table.columns[i]: self._nested(element) for i, element in elements.items()}

    def _sums(self, table: ProductTable) -> list[tuple[tuple[int, ...], int, Value]]:
        """Sum multiple times input over links, for every element and coefficient."""
        sums: dict[tuple[int, int], dict[Monomial, Fraction]] = {}
        for link in table.links:
            for coefficient, multiple in link.weights:
                polynomial = sums.setdefault((link.column, coefficient), {})
                monomial = table.inputs[link.input]
                polynomial[monomial] = polynomial.get(monomial, Fraction(0)) + multiple
        return [
            (
                table.columns[column],
                coefficient,
                self._nested({m: float(f) for m, f in polynomial.items()}),
            )
            for (column, coefficient), polynomial in sums.items()
        ]

    def _nested(self, polynomial: Mapping[Monomial, Any]) -> Value:
        return nested(self.motion.graph, polynomial, self._variables)


def position_variables(
    ring: PositionRing,
    q: Sequence[Any],
    cos: Callable[[Any], Any],
    sin: Callable[[Any], Any],
) -> list[Any]:
    """Return the ring's variables: cosine and sine of every angle, prismatic positions.

    `q` is one array, or one expression, per joint.
    """
    variables: list[Any] = []
    for angle in ring.chain.angles:
        total = sum(q[joint] * sign for joint, sign in angle.terms)
        sine = sin(total)
        variables += [cos(total), sine]
    return variables + [q[i] for i, link in enumerate(ring.chain.links) if link.prismatic]


def nested(
    graph: Expressions, polynomial: Mapping[Monomial, Any], variables: Sequence[Value]
) -> Value:
    """Return a polynomial's value; variables that two monomials share leave the brackets."""
    polynomial = {
        monomial: value
        for monomial, value in polynomial.items()
        if isinstance(value, Value) or value
    }
    if not polynomial:
        return graph.constant(0.0)
    counts = np.count_nonzero(np.array(list(polynomial)), axis=0)
    common = int(np.argmax(counts)) if len(counts) else 0
    if len(polynomial) == 1 or counts[common] < 2:
        total = graph.constant(0.0)
        for monomial, value in polynomial.items():
            total = total + product(graph, monomial, variables) * value
        return total
    inside: Polynomial = {}
    outside: Polynomial = {}
    for monomial, value in polynomial.items():
        if monomial[common]:
            powers = list(monomial)
            powers[common] -= 1
            inside[tuple(powers)] = value
        else:
            outside[monomial] = value
    taken = variables[common] * nested(graph, inside, variables)
    return taken + nested(graph, outside, variables)


def product(graph: Expressions, monomial: Monomial, variables: Sequence[Value]) -> Value:
    """A monomial, factor by factor in the order of the variables, so that beginnings are shared."""
    result = graph.constant(1.0)
    for variable, power in zip(variables, monomial, strict=True):
        for _ in range(power):
            result = result * variable
    return result


class RigidBodyTables(AbstractRigidBody):
    """The CSLC as the thesis draws it: preprocessed inputs, links, context-sensitive layers.

    Straight-line code over one array per quantity and joint, so that a batch is the only axis
    there is.
    """

    algebra: Algebra = eqx.field(static=True)
    coefficients: tuple[Coefficient, ...] = eqx.field(static=True)
    kind: str = eqx.field(static=True, default="rigid_body")

    @classmethod
    def from_algebra(cls, algebra: Algebra) -> "RigidBodyTables":
        return cls(algebra=algebra, coefficients=algebra.coefficients)

    @property
    def has_tables(self) -> bool:
        return True

    @property
    def support(self) -> tuple[tuple[int, ...], ...]:
        return _support(self.algebra)

    def expressed(self, motion: Motion) -> ClosedForm:
        return ClosedForm(motion, self.algebra)

    def christoffel_symbols(
        self, k: Float[Array, " coefficients"], q: Float[Array, "*batch joints"]
    ) -> dict[tuple[int, ...], Samples]:
        """Return the symbols c_ijk, j <= k, that are not identically zero (Eqn. 2.4-5)."""
        motion = Motion(q.shape[-1])
        symbols = self.expressed(motion).christoffel_symbols(motion.graph.inputs("k", self.size))
        symbols_code = StraightLine(motion, tuple(symbols.values()))
        return dict(zip(symbols, motion_outputs(symbols_code, k, by_joint(q)), strict=True))

    def _values(
        self, quantity: str, k: Coefficients | None, *motion: Joints
    ) -> Float[Array, "*batch values"]:
        return jnp.stack(self._outputs(quantity, k, *map(by_joint, motion)), axis=-1)

    def _column_rows(self, q: Rows, qd: Rows, qdd: Rows) -> Float[Array, "rows samples"]:
        return jnp.stack(self._outputs("columns", None, list(q), list(qd), list(qdd)))

    def _outputs(
        self, quantity: str, k: Coefficients | None, *motion: Sequence[Samples]
    ) -> list[Samples]:
        """Arrays of a quantity, all of the motion's shape."""
        # All at once but sines and cosines: in stages they take three times as long to compile.
        return motion_outputs(code(self, quantity), k, *motion, stage=None)


@lru_cache(maxsize=64)
def _support(algebra: Algebra) -> tuple[tuple[int, ...], ...]:
    """Return, for each joint, the coefficients of the elements that enter its torque."""
    reach: list[set[int]] = [set() for _ in range(algebra.robot.joint_count)]
    tables = algebra.mass, algebra.velocity, algebra.gravity
    for table, outputs in zip(tables, (2, 1, 1), strict=True):
        for link in table.links:
            for joint in table.columns[link.column][:outputs]:
                reach[joint] |= {coefficient for coefficient, _ in link.weights}
    return tuple(tuple(sorted(coefficients)) for coefficients in reach)


def input_rows(
    ring: PositionRing, monomials: Sequence[Monomial], q: Sequence[Samples]
) -> Float[Array, " monomials *batch"]:
    """Return the preprocessing layer as one array: quick to compile, however many monomials there
    are.

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
    variables = jnp.stack(position_variables(ring, q, jnp.cos, jnp.sin))
    highest, needed = max(map(sum, monomials), default=0), set(monomials)
    for degree in range(highest, 1, -1):
        needed |= {_without_last(m) for m in needed if sum(m) == degree}
    # A gathered product for each degree: a Panda's 9,500 monomials, written out, compile for 50 s.
    level: list[Monomial] = [(0,) * len(variables)]
    order, levels = list(level), [jnp.ones_like(variables[:1])]
    for degree in range(1, highest + 1):
        before = {monomial: row for row, monomial in enumerate(level)}
        level = sorted(m for m in needed if sum(m) == degree)
        factors = np.array([(before[_without_last(m)], _last(m)) for m in level]).T
        levels.append(levels[-1][factors[0]] * variables[factors[1]])
        order += level
    row_of = {monomial: row for row, monomial in enumerate(order)}
    return jnp.concatenate(levels)[np.array([row_of[m] for m in monomials], int)]


def _last(monomial: Monomial) -> int:
    """Return the last variable of a monomial."""
    return max(index for index, power in enumerate(monomial) if power)


def _without_last(monomial: Monomial) -> Monomial:
    last = _last(monomial)
    return (*monomial[:last], monomial[last] - 1, *monomial[last + 1 :])
