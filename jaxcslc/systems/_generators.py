"""Expressions as rational functions of generators: symbols, functions of them, and relations.

`Angles` chooses the angles whose sines and cosines are generators.
"""

from collections.abc import Collection, Iterable, Sequence
from math import isfinite, lcm
from typing import Any

from sympy import (
    Abs,
    Add,
    And,
    Dummy,
    Eq,
    Heaviside,
    Integer,
    Matrix,
    Max,
    Min,
    Mul,
    Ne,
    Not,
    Or,
    Piecewise,
    Rational,
    chebyshevt,
    chebyshevu,
    cos,
    cot,
    csc,
    exp,
    expand,
    expand_power_base,
    gcd_list,
    preorder_traversal,
    sec,
    sign,
    sin,
    tan,
)

from ..derivation import exact_cos_sin
from ._description import DescriptionError


Terms = dict[Any, Any]  # what is added in the argument of a function: monic term to its rational


class Angles:
    """The independent angles of sines and cosines, and every argument as an integer sum of them.

    Arguments of few terms first and, among those, the most frequent; of arguments that are
    multiples of one another, what divides them all.
    """

    def __init__(self, largest_multiple: int) -> None:
        self._largest = largest_multiple
        self._counts: dict[frozenset[tuple[Any, Any]], dict[Any, int]] = {}
        self._basis: list[Terms] = []
        # Arguments that are large multiples, or fractions of sums, of angles of the basis.
        self._apart: list[Terms] = []

    def add(self, terms: Terms) -> None:
        """Counts an argument."""
        if terms:
            first = terms[min(terms, key=str)]
            direction = frozenset((name, factor / first) for name, factor in terms.items())
            counts = self._counts.setdefault(direction, {})
            counts[first] = counts.get(first, 0) + 1

    def settle(self) -> None:
        """Chooses the angles."""
        candidates: list[tuple[int, int, str, Terms]] = []
        for direction, counts in self._counts.items():
            smallest = gcd_list(list(counts))
            near = max(abs(factor / smallest) for factor in counts) <= self._largest
            for factor in (smallest,) if near else sorted(counts, key=abs):
                terms = {name: part * factor for name, part in direction}
                label = str(sorted(map(str, terms)))
                candidates.append((len(terms), -sum(counts.values()), label, terms))
        for *_, terms in sorted(candidates, key=lambda candidate: candidate[:3]):
            if self._integers(terms) is None:
                (self._basis if self._in_basis(terms) is None else self._apart).append(terms)

    def multiples(self, terms: Terms) -> Iterable[tuple[Any, int]]:
        """Angles with the multiple of each."""
        if not terms:
            return
        integers = self._integers(terms)
        assert integers is not None, terms
        for angle, multiple in zip((*self._basis, *self._apart), integers, strict=True):
            if multiple:
                yield sum(factor * term for term, factor in angle.items()), multiple

    def _integers(self, terms: Terms) -> list[int] | None:
        """Return an argument as an integer sum of the angles; None if it is no such sum."""
        everything = [*self._basis, *self._apart]
        for index, angle in enumerate(everything):
            ratios = {terms.get(name, 0) / factor for name, factor in angle.items()}
            if terms.keys() == angle.keys() and len(ratios) == 1 and self._is_multiple(*ratios):
                return [int(*ratios) if i == index else 0 for i in range(len(everything))]
        solution = self._in_basis(terms)
        if solution is None or not all(map(self._is_multiple, solution)):
            return None
        return [*map(int, solution), *[0] * len(self._apart)]

    def _is_multiple(self, x: Any) -> bool:
        return bool(x.is_Integer and abs(x) <= self._largest)

    def _in_basis(self, terms: Terms) -> list[Any] | None:
        """Return an argument as a rational sum of the basis; None if it is independent of it."""
        columns, last = (*self._basis, terms), len(self._basis)
        names = list(dict.fromkeys(name for part in columns for name in part))
        rows = [[part.get(name, Integer(0)) for part in columns] for name in names]
        echelon, pivots = Matrix(rows).rref()
        return None if last in pivots else [echelon[row, last] for row in range(last)]


class Generators:
    """Expressions as rational functions of generators, of which few relations hold.

    Generators are the variables and constants themselves, and one symbol for each function of
    them: cosine and sine of independent angles, signs, roots, exponentials, and any other function
    as it is. No function contains both variables and unknown constants: what would (as `sin(w*t)`
    with an unknown `w`) is an error that names the constant. Sums in sines, cosines and
    exponentials are expanded: `A*sin(theta + phi)` is `A*cos(phi)*sin(theta) +
    A*sin(phi)*cos(theta)`, which is linear in what multiplies functions of `theta`.

    **Attributes**

    - `unknown`: symbols of the unknown constants.
    - `values`: generator to the expression that it stands for, in the order of their creation.
    - `relations`: a generator, its least power that the normal form does not contain, and the
      polynomial of generators that it is replaced by.
    """

    def __init__(
        self,
        expressions: Sequence[tuple[str, Any]],
        unknown: Collection[Any],
        largest_multiple: int = 1,
    ) -> None:
        """- `expressions`: that are to be rewritten, with a name for messages.

        - `largest_multiple`: sines and cosines of so many times an angle are expanded into powers
          of the angle's. (Not of any multiple: powers cancel, at 24 times seven digits are lost.)
        """
        self.unknown = frozenset(unknown)
        self.values: dict[Any, Any] = {}
        self.relations: list[tuple[Any, int, Any]] = []
        self._of: dict[Any, Any] = {}
        self._where = ""
        self._angles = Angles(largest_multiple)
        self._exponents: dict[Any, int] = {}
        self._forms: dict[Any, Any] = {}
        for where, expression in expressions:
            self._where = where
            self._collect(expression)
        self._angles.settle()

    def rational(self, where: str, expression: Any) -> Any:
        """An expression of sums, products and integer powers of generators."""
        self._where = where
        return self._rewritten(expression)

    def is_constant(self, generator: Any) -> bool:
        """Return whether a generator depends on unknown constants."""
        return bool(self.values[generator].free_symbols & self.unknown)

    def _collect(self, expression: Any) -> None:
        """Angles and exponents, which are rewritten in terms of those that occur."""
        for node in preorder_traversal(expression):
            if isinstance(node, sin | cos | tan | cot | sec | csc):
                self._angles.add(self._split(node)[0])
            elif isinstance(node, exp):
                for term, factor in (t for part in self._split(node) for t in part.items()):
                    denominator = int(factor.q)
                    self._exponents[term] = lcm(self._exponents.get(term, 1), denominator)

    def _split(self, function: Any) -> tuple[Terms, Terms]:
        """The terms of the argument of a function: without unknown constants, and with them alone.

        **Raises** `DescriptionError` for a term with both.
        """
        parts: tuple[Terms, Terms] = {}, {}
        for term in Add.make_args(expand(function.args[0])):
            factor, monic = term.as_coeff_Mul()
            parts[self._side(monic, function)][monic] = factor
        return parts

    def _side(self, expression: Any, within: Any) -> int:
        """0 for an expression of variables, 1 for one of unknown constants.

        **Raises** `DescriptionError` for one of both, which is not linear in coefficients.
        """
        symbols = expression.free_symbols
        constants = symbols & self.unknown
        if not constants:
            return 0
        if symbols != constants:
            names = sorted(str(symbol) for symbol in constants)
            listed = ", ".join(names)
            raise DescriptionError(
                f"{self._where}: not polynomial in the constant{'s' * (len(names) > 1)} {listed},"
                f" in {within}: give a value, or bounds to search it within, as in"
                f" [constants] {names[0]} = {{ bounds = [LOW, HIGH] }}"
            )
        return 1

    def _rewritten(self, x: Any) -> Any:
        if x not in self._forms:
            self._forms[x] = self._rewrite(x)
        return self._forms[x]

    def _rewrite(self, x: Any) -> Any:
        if x.is_Rational:
            return x
        if not x.free_symbols:
            return _as_rational(x, self._where)
        if x.is_Symbol:
            self.values.setdefault(x, x)
            return x
        if x.is_Add or x.is_Mul:
            return x.func(*map(self._rewritten, x.args))
        if isinstance(x, exp):
            return self._exponential(x)
        if x.is_Pow:
            return self._power(x)
        if isinstance(x, sin | cos):
            return self._trigonometric(x)[0 if isinstance(x, cos) else 1]
        if isinstance(x, tan | cot | sec | csc):
            c, s = self._trigonometric(x)
            return {tan: s / c, cot: c / s, sec: 1 / c, csc: 1 / s}[x.func]
        if isinstance(x, sign):
            return self._sign(x)
        if isinstance(x, Abs):
            return self._rewritten(x.args[0]) * self._rewritten(sign(x.args[0]))
        if isinstance(x, Heaviside):
            return (1 + self._rewritten(sign(x.args[0]))) / 2
        if isinstance(x, Max | Min):
            return self._rewritten(_by_moduli(x))
        if isinstance(x, Piecewise):
            return self._piecewise(x)
        return self._function(x)

    def _power(self, x: Any) -> Any:
        base, exponent = x.as_base_exp()
        if exponent.is_Integer:
            return self._rewritten(base) ** exponent
        apart = expand_power_base(x)
        if apart.is_Mul:
            return Mul(*map(self._rewritten, apart.args))
        if not exponent.is_Rational:
            return self._function(x)
        q = int(exponent.q)
        root = base ** Rational(1, q)
        if not (root.is_Pow and root.exp == Rational(1, q)):
            return self._rewritten(root) ** int(exponent.p)
        self._side(base, x)
        inside = self._rewritten(base)
        whole, part = divmod(int(exponent.p), q)
        return inside**whole * self._generator(root, q, inside) ** part

    def _exponential(self, x: Any) -> Any:
        product = Integer(1)
        for part in self._split(x):
            for term, factor in part.items():
                if term.is_Rational:
                    product *= _as_rational(exp(term * factor), self._where)
                    continue
                unit = self._exponents[term]
                product *= self._generator(exp(term / unit)) ** int(factor * unit)
        return product

    def _trigonometric(self, x: Any) -> tuple[Any, Any]:
        """Cosine and sine of the argument."""
        of_variables, of_constants = self._split(x)
        total: tuple[Any, Any] = (Integer(1), Integer(0))
        for angle, multiple in self._angles.multiples(of_variables):
            total = _added(total, self._multiple(angle, multiple))
        for term, factor in of_constants.items():
            total = _added(total, self._multiple(term * factor, 1))
        return total

    def _multiple(self, angle: Any, multiple: int) -> tuple[Any, Any]:
        if not angle.free_symbols:
            c, s = exact_cos_sin(float(angle) * multiple)
            return Rational(str(c)), Rational(str(s))
        cosine = self._generator(cos(angle))
        sine = self._generator(sin(angle), 2, 1 - cosine**2)
        n = abs(multiple)
        sine_n = sine * expand(chebyshevu(n - 1, cosine))
        return expand(chebyshevt(n, cosine)), sine_n if multiple > 0 else -sine_n

    def _function(self, x: Any) -> Any:
        """A function that nothing is known of, as a generator."""
        canonical = x.func(*map(expand, x.args))
        if canonical.func != x.func:
            return self._rewritten(canonical)
        self._side(canonical, x)
        return self._generator(canonical)

    def _generator(self, value: Any, power: int = 0, replacement: Any = None) -> Any:
        """Return the symbol of a function, of which a power is replaced by other generators."""
        if value not in self._of:
            self._of[value] = Dummy(str(value))
            self.values[self._of[value]] = value
            if power:
                self.relations.append((self._of[value], power, replacement))
        return self._of[value]

    def _sign(self, x: Any) -> Any:
        """Return the sign of an expression that changes sign: its square is 1."""
        (inside,) = x.args
        if inside.is_Mul:
            return Mul(*(self._rewritten(sign(factor)) for factor in inside.args))
        value = sign(expand(inside))
        if not isinstance(value, sign):
            return self._rewritten(value)
        self._side(value, x)
        return self._generator(value, 2, Integer(1))

    def _piecewise(self, x: Any) -> Any:
        """Multiply each piece by an indicator of where it holds and those before it do not."""
        total, left = Integer(0), Integer(1)
        for value, condition in x.args:
            self._side(condition, x)
            indicator = left * self._indicator(condition)
            total += self._rewritten(value) * indicator
            left = left - indicator
        return total

    def _indicator(self, condition: Any) -> Any:
        """1 where a condition holds and 0 elsewhere, except at single points."""
        if condition.is_Relational and not isinstance(condition, Eq | Ne):
            difference = condition.gts - condition.lts
            return (1 + self._rewritten(sign(difference))) / 2
        if isinstance(condition, And):
            return Mul(*map(self._indicator, condition.args))
        if isinstance(condition, Or):
            return 1 - Mul(*(1 - self._indicator(part) for part in condition.args))
        if isinstance(condition, Not):
            return 1 - self._indicator(condition.args[0])
        return Integer(bool(condition == True or isinstance(condition, Ne)))  # noqa: E712


def _by_moduli(x: Any) -> Any:
    """Return the greatest or least of several, by the moduli of their differences."""
    first, *others = x.args
    total = first
    for other in others:
        size = Abs(total - other)
        total = (total + other + (size if isinstance(x, Max) else -size)) / 2
    return total


def _added(one: tuple[Any, Any], other: tuple[Any, Any]) -> tuple[Any, Any]:
    """Cosine and sine of a sum."""
    return one[0] * other[0] - one[1] * other[1], one[1] * other[0] + one[0] * other[1]


def _as_rational(x: Any, where: str) -> Any:
    """An irrational number as the decimal that a float prints."""
    try:
        number = float(x)
        if not isfinite(number):
            raise ValueError
        return Rational(repr(number))
    except (TypeError, ValueError):
        raise DescriptionError(f"{where}: got {x}; expected finite real numbers") from None
