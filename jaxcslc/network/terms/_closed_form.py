"""A network's tables over expressions."""

from collections.abc import Callable, Collection, Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from jaxcslc.codegen import Expressions, Motion, Value
from jaxcslc.derivation import PositionRing, ProductTable

from ._expressed_bodies import PARTS, AbstractExpressedBodies


Monomial = tuple[int, ...]
Polynomial = dict[Monomial, Any]


class ClosedForm(AbstractExpressedBodies):
    """A network's tables over expressions: polynomials in sines and cosines (thesis 5.1).

    Sums are nested (Horner): the variable that most of the monomials have is taken out, and so
    on inside and outside of the bracket. Each element of a table is formed once, and serves both
    torques that an off-diagonal element of the mass matrix enters.
    """

    def __init__(self, motion: Motion, tables: Any) -> None:
        """
        - `motion`: of the joints.
        - `tables`: what has `ring`, `mass`, `velocity` and `gravity`: an `Algebra`, or a term made
          from it.
        """
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
        """The symbols c_ijk, j <= k, that are not identically zero (Eqn. 2.4-5)."""
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
    """A polynomial's value, variables taken out of brackets while two monomials share one."""
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
