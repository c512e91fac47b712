"""Sign of a coefficient that holds for every mass distribution (thesis 5.2.3)."""

from collections.abc import Sequence
from fractions import Fraction

from ._tables import Addend


_MOMENTS = {"Ixx": ("y", "z"), "Iyy": ("x", "z"), "Izz": ("x", "y")}


def positive_by_construction(addends: Sequence[Addend], gravity: Sequence[str]) -> bool:
    """Return whether a coefficient is positive for every possible mass distribution (thesis 5.2.3).

    Moments of inertia, first moments and mass of a link are integrals over its mass of products
    of two of x, y, z and the lengths. So a link's share of a coefficient is the integral of a
    quadratic form, which cannot be negative if the form is positive semidefinite. Shares of
    different links, of moments about a centre of gravity and of motors add up.

    Sufficient, and checked in exact arithmetic. It finds the four that the thesis names (kM4,
    kM6, kM9 and kM11 of the PUMA 560) and others, such as complete squares.
    """
    forms: dict[tuple[int, bool], dict[tuple[str, str], Fraction]] = {}
    for addend in addends:
        lengths = [name for name, power in addend.constants for _ in range(power)]
        if any(name in gravity for name in lengths):
            return False
        factors, link = addend.term.factors, addend.term.link
        if factors == ("motor",):
            if addend.factor < 0:
                return False
            continue
        moment = factors[0].startswith("I")
        # A principal moment is an integral about the centre of gravity: another form.
        form = forms.setdefault((link, addend.term.central), {})
        if factors[0] in _MOMENTS:
            for axis in _MOMENTS[factors[0]]:
                _add(form, axis, axis, addend.factor)
        elif moment:  # a tensor's off-diagonal element is -∫ x y dm
            _add(form, factors[0][1], factors[0][2], -addend.factor)
        else:
            variables = [factor[1] for factor in factors[1:]] + lengths
            variables += ["1"] * (2 - len(variables))  # numeric lengths are in the factor
            if len(variables) != 2:
                return False
            _add(form, variables[0], variables[1], addend.factor)
    return all(_positive_semidefinite(form) for form in forms.values())


def _add(form: dict[tuple[str, str], Fraction], a: str, b: str, value: Fraction) -> None:
    """Add value * a * b to a form, stored as its symmetric matrix."""
    for key in ((a, b), (b, a)):
        form[key] = form.get(key, Fraction(0)) + value / 2


def _positive_semidefinite(form: dict[tuple[str, str], Fraction]) -> bool:
    """Return whether a form is positive semidefinite, by symmetric elimination.

    A negative pivot, or a zero one in a row that is not zero, decides.
    """
    names = sorted({name for key in form for name in key})
    rows = [[form.get((a, b), Fraction(0)) for b in names] for a in names]
    while rows:
        pivot, remaining_rows = rows[0], rows[1:]
        if pivot[0] < 0 or (pivot[0] == 0 and any(pivot)):
            return False
        rows = [
            [
                value - row[0] * other / pivot[0] if pivot[0] else value
                for value, other in zip(row[1:], pivot[1:], strict=True)
            ]
            for row in remaining_rows
        ]
    return True
