"""A network's tables over expressions."""

from collections.abc import Mapping, Sequence
from fractions import Fraction

import numpy as np
from jaxtyping import Float

from ....codegen import Expressions, Motion, Value
from ....derivation import PositionRing, Table


Monomial = tuple[int, ...]
Polynomial = dict[Monomial, float]


class ClosedForm:
    """A network's tables over expressions: polynomials in sines and cosines (thesis 5.1).

    Sums are nested (Horner): the variable that most of the monomials have is taken out, and so
    on inside and outside of the bracket.
    """

    def __init__(
        self, motion: Motion, ring: PositionRing, *, mass: Table, velocity: Table, gravity: Table
    ) -> None:
        """
        - `motion`: of the joints.
        - `ring`, `mass`, `velocity`, `gravity`: of an `Algebra`.
        """
        self.graph, self.ring = motion.graph, ring
        self.q, self.qd, self.qdd = motion.q, motion.qd, motion.qdd
        self.tables = mass, velocity, gravity
        self.variables = self._position_variables()

    def _position_variables(self) -> list[Value]:
        chain, variables = self.ring.chain, list[Value]()
        for angle in chain.angles:
            total = self.graph.constant(0.0)
            for joint, sign in angle.terms:
                total = total + self.q[joint] * float(sign)
            minus, size = total.signed()  # cos(-x) = cos x
            sine = self.graph.apply("sin", size)
            variables += [self.graph.apply("cos", size), -sine if minus else sine]
        return variables + [self.q[i] for i, link in enumerate(chain.links) if link.prismatic]

    def torque(self, k: Float[np.ndarray, " inertial"]) -> list[Value]:
        """Rigid-body torque of every joint, a polynomial in positions, rates and accelerations."""
        n, size = len(self.q), len(self.variables)
        mass, velocity, gravity = self.tables
        joints: list[Polynomial] = [{} for _ in range(n)]

        def put(joint: int, monomial: Monomial, rates: Sequence[int], value: float) -> None:
            powers = [*monomial, *([0] * (2 * n))]
            for rate in rates:
                powers[size + rate] += 1
            key = tuple(powers)
            joints[joint][key] = joints[joint].get(key, 0.0) + value

        for column, monomial, value in _weighted(mass, k):
            j, m = column
            put(j, monomial, [n + m], value)
            if j != m:
                put(m, monomial, [n + j], value)
        for column, monomial, value in _weighted(velocity, k):
            i, j, m = column
            put(i, monomial, [j, m], value if j == m else 2 * value)
        for column, monomial, value in _weighted(gravity, k):
            put(column[0], monomial, [], value)
        variables = [*self.variables, *self.qd, *self.qdd]
        return [nested(self.graph, polynomial, variables) for polynomial in joints]

    def mass_matrix(self, k: Float[np.ndarray, " inertial"]) -> list[list[Value]]:
        n = len(self.q)
        elements = self._elements(self.tables[0], k)
        zero = self.graph.constant(0.0)
        return [[elements.get((min(i, j), max(i, j)), zero) for j in range(n)] for i in range(n)]

    def gravity(self, k: Float[np.ndarray, " inertial"]) -> list[Value]:
        elements = self._elements(self.tables[2], k)
        zero = self.graph.constant(0.0)
        return [elements.get((i,), zero) for i in range(len(self.q))]

    def entries(self) -> dict[tuple[int, int], Value]:
        """The regressor's entries that are not always zero, by joint and coefficient."""
        mass, velocity, gravity = self.tables
        entries: dict[tuple[int, int], Value] = {}

        def put(joint: int, coefficient: int, value: Value) -> None:
            key = joint, coefficient
            entries[key] = entries[key] + value if key in entries else value

        for (j, m), coefficient, value in self._sums(mass):
            put(j, coefficient, value * self.qdd[m])
            if j != m:
                put(m, coefficient, value * self.qdd[j])
        for (i, j, m), coefficient, value in self._sums(velocity):
            put(i, coefficient, value * (self.qd[j] * self.qd[m] * (1.0 if j == m else 2.0)))
        for (j,), coefficient, value in self._sums(gravity):
            put(j, coefficient, value)
        return entries

    def _elements(
        self, table: Table, k: Float[np.ndarray, " inertial"]
    ) -> dict[tuple[int, ...], Value]:
        elements: dict[tuple[int, ...], Polynomial] = {}
        for column, monomial, value in _weighted(table, k):
            element = elements.setdefault(column, {})
            element[monomial] = element.get(monomial, 0.0) + value
        return {
            column: nested(self.graph, element, self.variables)
            for column, element in elements.items()
        }

    def _sums(self, table: Table) -> list[tuple[tuple[int, ...], int, Value]]:
        """For every element and coefficient, the sum over links of multiple times input."""
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
                nested(self.graph, {m: float(f) for m, f in polynomial.items()}, self.variables),
            )
            for (column, coefficient), polynomial in sums.items()
        ]


def nested(
    graph: Expressions, polynomial: Mapping[Monomial, float], variables: Sequence[Value]
) -> Value:
    """A polynomial's value, variables taken out of brackets while two monomials share one."""
    polynomial = {monomial: value for monomial, value in polynomial.items() if value}
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


def _weighted(table: Table, k: Float[np.ndarray, " inertial"]):
    """Every link of a table as its element, its input's monomial, and its weight."""
    for link in table.links:
        weight = float(sum(float(multiple) * k[index] for index, multiple in link.weights))
        yield table.columns[link.column], table.inputs[link.input], weight
