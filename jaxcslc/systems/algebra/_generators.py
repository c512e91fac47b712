"""Generators of expressions, and the relations that hold between them."""

import dataclasses
from collections.abc import Callable, Collection, Sequence
from math import isfinite, lcm
from typing import Any

from jaxcslc.derivation import exact_cos_sin

from ..description import DescriptionError
from ._angles import Angles, Terms


@dataclasses.dataclass(frozen=True)
class Relation:
    """A power of a generator that the normal form does not contain, and what it is replaced by.

    **Attributes**

    - `generator`: a symbol.
    - `power`: the least that is replaced.
    - `value`: a polynomial of generators, of lower power in this one.
    """

    generator: Any
    power: int
    value: Any


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
    - `relations`: that the normal form uses.
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
        self.relations: list[Relation] = []
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
        from sympy import cos, cot, csc, exp, preorder_traversal, sec, sin, tan

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
        from sympy import Add, expand

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
        from sympy import cos, cot, csc, exp, sec, sin, tan

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
        special = _SPECIAL.get(x.func.__name__)
        if special is not None:
            return special(self, x)
        return self._function(x)

    def _power(self, x: Any) -> Any:
        from sympy import Mul, Rational, expand_power_base

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
        if root not in self._of:
            inside = self._rewritten(base)
            self.relations.append(Relation(self._generator(root, root), q, inside))
        whole, part = divmod(int(exponent.p), q)
        return self._rewritten(base) ** whole * self._of[root] ** part

    def _exponential(self, x: Any) -> Any:
        from sympy import Integer, exp

        product = Integer(1)
        for part in self._split(x):
            for term, factor in part.items():
                if term.is_Rational:
                    product *= _as_rational(exp(term * factor), self._where)
                    continue
                unit = self._exponents[term]
                generator = self._generator(exp(term / unit), exp(term / unit))
                product *= generator ** int(factor * unit)
        return product

    def _trigonometric(self, x: Any) -> tuple[Any, Any]:
        """Cosine and sine of the argument."""
        from sympy import Integer

        of_variables, of_constants = self._split(x)
        total: tuple[Any, Any] = (Integer(1), Integer(0))
        for angle, multiple in self._angles.multiples(of_variables):
            total = _added(total, self._multiple(angle, multiple))
        for term, factor in of_constants.items():
            angle = term * factor
            total = _added(total, self._multiple(angle, 1))
        return total

    def _multiple(self, angle: Any, multiple: int) -> tuple[Any, Any]:
        from sympy import Integer, Rational, chebyshevt, chebyshevu, cos, expand, sin

        if not angle.free_symbols:
            c, s = exact_cos_sin(float(angle) * multiple)
            return Rational(str(c)), Rational(str(s))
        c, s = cos(angle), sin(angle)
        if c not in self._of:
            cosine, sine = self._generator(c, c), self._generator(s, s)
            self.relations.append(Relation(sine, 2, 1 - cosine**2))
        cosine, sine = self._of[c], self._of[s]
        n = abs(multiple)
        cosine_n = expand(chebyshevt(n, cosine))
        sine_n = sine * expand(chebyshevu(n - 1, cosine)) if n else Integer(0)
        return cosine_n, sine_n if multiple > 0 else -sine_n

    def _function(self, x: Any) -> Any:
        """A function that nothing is known of, as a generator."""
        from sympy import expand

        canonical = x.func(*map(expand, x.args))
        if canonical.func != x.func:
            return self._rewritten(canonical)
        self._side(canonical, x)
        return self._generator(canonical, canonical)

    def _generator(self, key: Any, value: Any) -> Any:
        from sympy import Dummy

        if key not in self._of:
            self._of[key] = Dummy(str(value))
            self.values[self._of[key]] = value
        return self._of[key]

    def sign(self, x: Any) -> Any:
        """Return the sign of an expression that changes sign: its square is 1."""
        from sympy import Integer, Mul, expand, sign

        (inside,) = x.args
        if inside.is_Mul:
            return Mul(*(self._rewritten(sign(factor)) for factor in inside.args))
        inside = expand(inside)
        value = sign(inside)
        if not isinstance(value, sign):
            return self._rewritten(value)
        self._side(inside, x)
        new = value not in self._of
        generator = self._generator(value, value)
        if new:
            self.relations.append(Relation(generator, 2, Integer(1)))
        return generator

    def absolute(self, x: Any) -> Any:
        """The argument times its sign."""
        from sympy import sign

        (inside,) = x.args
        return self._rewritten(inside) * self._rewritten(sign(inside))

    def step(self, x: Any) -> Any:
        """Half of one more than the sign."""
        from sympy import sign

        return (1 + self._rewritten(sign(x.args[0]))) / 2

    def extreme(self, x: Any) -> Any:
        """The greatest or least of several, by the moduli of their differences."""
        from sympy import Abs, Max

        greatest = isinstance(x, Max)
        first, *others = x.args
        total = first
        for other in others:
            size = Abs(total - other)
            total = (total + other + (size if greatest else -size)) / 2
        return self._rewritten(total)

    def piecewise(self, x: Any) -> Any:
        """Each piece times an indicator of where it holds and those before it do not."""
        from sympy import Integer

        total, left = Integer(0), Integer(1)
        for value, condition in x.args:
            self._side(condition, x)
            indicator = left * self._indicator(condition)
            total += self._rewritten(value) * indicator
            left = left - indicator
        return total

    def _indicator(self, condition: Any) -> Any:
        """1 where a condition holds and 0 elsewhere, but for single points."""
        from sympy import And, Eq, Integer, Mul, Ne, Not, Or, sign

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


_SPECIAL: dict[str, Callable[[Generators, Any], Any]] = {
    "sign": Generators.sign,
    "Abs": Generators.absolute,
    "Heaviside": Generators.step,
    "Max": Generators.extreme,
    "Min": Generators.extreme,
    "Piecewise": Generators.piecewise,
}


def _added(one: tuple[Any, Any], other: tuple[Any, Any]) -> tuple[Any, Any]:
    """Cosine and sine of a sum."""
    return one[0] * other[0] - one[1] * other[1], one[1] * other[0] + one[0] * other[1]


def _as_rational(x: Any, where: str) -> Any:
    """An irrational number as the decimal that a float prints."""
    from sympy import Rational

    try:
        number = float(x)
        if not isfinite(number):
            raise ValueError
        return Rational(repr(number))
    except (TypeError, ValueError):
        raise DescriptionError(f"{where}: got {x}; expected finite real numbers") from None
