import math
from typing import Any, no_type_check

from flint import fmpq


Monomial = tuple[int, ...]


class SparsePolynomial(dict[Monomial, Any]):
    """A polynomial with rational coefficients: exponents of the generators to coefficients.

    Without zeros. What it is added to or multiplied by is a polynomial in the same generators, or
    a number. (The rings of sympy do the same. Importing sympy took longer than the derivations of
    a PUMA 560 and a Panda together, and products here have tens of terms, in which FLINT's own
    polynomials would gain nothing.) The order of terms follows from that of the operands: the sign
    of a coefficient of the network is that of the first term in which it is met.

    >>> x = SparsePolynomial.generator(0, 2)
    >>> y = SparsePolynomial.generator(1, 2)
    >>> (x + y) * (x - y)
    {(2, 0): 1, (0, 2): -1}
    """

    @classmethod
    def generator(cls, index: int, count: int) -> "SparsePolynomial":
        """One of so many generators."""
        return cls({tuple(int(i == index) for i in range(count)): fmpq(1)})

    @classmethod
    def without_zeros(cls, terms: dict[Monomial, Any]) -> "SparsePolynomial":
        """Of terms of which some may be zero."""
        return cls((monomial, value) for monomial, value in terms.items() if value)

    # A check of annotations at run time, as in the tests, would take most of a derivation's time.
    @no_type_check
    def __add__(self, other: Any) -> Any:
        return self._plus(other, 1)

    @no_type_check
    def __radd__(self, other: Any) -> Any:
        return self._plus(other, 1)

    @no_type_check
    def __sub__(self, other: Any) -> Any:
        return self._plus(other, -1)

    @no_type_check
    def __rsub__(self, other: Any) -> Any:
        return (-self)._plus(other, 1)

    @no_type_check
    def __neg__(self) -> "SparsePolynomial":
        return SparsePolynomial((monomial, -value) for monomial, value in self.items())

    @no_type_check
    def __mul__(self, other: Any) -> "SparsePolynomial":
        if not isinstance(other, SparsePolynomial):
            return self.without_zeros({monomial: value * other for monomial, value in self.items()})
        result = {}
        for one, factor in self.items():
            for two, value in other.items():
                monomial = tuple(map(int.__add__, one, two))
                result[monomial] = result.get(monomial, 0) + factor * value
        return self.without_zeros(result)

    __rmul__ = __mul__

    @no_type_check
    def __pow__(self, power: int) -> Any:
        return math.prod([self] * power, start=fmpq(1))

    @no_type_check
    def __eq__(self, other: object) -> bool:
        if isinstance(other, dict):
            return dict.__eq__(self, other)
        return not self and other == 0

    __hash__ = None

    @no_type_check
    def _plus(self, other: Any, sign: int) -> Any:
        result = SparsePolynomial(self)
        if not isinstance(other, SparsePolynomial):
            if not other:
                return result
            if not self:  # of how many generators is not known, and a number is as good
                return sign * other
            other = {(0,) * len(next(iter(self))): fmpq(other)}
        for monomial, value in other.items():
            total = result.get(monomial, 0) + sign * value
            if total:
                result[monomial] = total
            else:
                del result[monomial]
        return result
