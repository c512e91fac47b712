"""Structural identifiability: which link parameters torque and motion can determine at all.

Exact arithmetic decides; no motion is sampled (Gautier and Khalil 1990).
"""

from dataclasses import dataclass
from typing import Literal

from flint import fmpq, fmpq_mat

from ._algebra import Algebra
from ._lagrange import InertialTerm


Identifiability = Literal["alone", "only in combinations", "not at all"]


@dataclass(frozen=True)
class StructuralIdentifiability:
    """Verdict on whether any motion can identify a physical parameter of a robot.

    **Attributes**

    - `parameter`: as expressions name it, links counted from 1: `"Ixx3"`, `"m2*rx2"`, `"Im1"`.
    - `link`: counted from 1.
    - `verdict`: `"alone"`, `"only in combinations"` or `"not at all"`.
    - `coefficients`: names of the coefficients that it is part of.

    >>> from jaxcslc.manipulator import Manipulator
    >>> from jaxcslc.derivation import derive_algebra, structural_identifiability
    >>> pendulum = Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> for row in structural_identifiability(derive_algebra(pendulum, "numeric"))[6:8]:
    ...     print(row)
    m1*rx1: alone, as kB2
    m1*ry1: alone, as kB3
    """

    parameter: str
    link: int
    verdict: Identifiability
    coefficients: tuple[str, ...]

    def __str__(self) -> str:
        match self.verdict:
            case "not at all":
                return f"{self.parameter}: not at all"
            case "alone":
                return f"{self.parameter}: alone, as {', '.join(self.coefficients)}"
            case _:
                return f"{self.parameter}: only in combinations, {', '.join(self.coefficients)}"


def structural_identifiability(algebra: Algebra) -> tuple[StructuralIdentifiability, ...]:
    """Find the link parameters that torque and motion determine, however exciting the motion.

    Torque depends on link parameters through the coefficients alone, and on each coefficient
    independently of the others (2.4; with numeric lengths they are the base parameters of Gautier
    and Khalil, 1990). So a parameter can be identified alone if, and only if, it is a linear
    combination of coefficients: exact arithmetic decides, nothing is sampled.

    With symbolic lengths, products with different lengths count as different parameters, as if
    the lengths were free. What they determine alone, numeric lengths determine alone too; numeric
    lengths can determine more, where they make coefficients that share parameters independent.

    Friction is not part of the link parameters: each of its coefficients can be identified alone.

    **Returns** one row for each link parameter, or product of parameters, that the robot has, in
    the order of `algebra.terms`: for full inertia tensors `Ixx` to `Iyz` about the link frame's
    origin, first moments and mass, then motor inertias.

    >>> from jaxcslc.manipulator import puma560
    >>> from jaxcslc.derivation import derive_algebra, structural_identifiability
    >>> rows = structural_identifiability(derive_algebra(puma560(), "numeric"))
    >>> [row.verdict for row in rows if row.parameter in ("Im1", "Im4", "Ixx1")]
    ['not at all', 'only in combinations', 'alone']
    """
    # Columns: every product of lengths with a parameter that occurs in some coefficient.
    columns: dict[tuple[InertialTerm, tuple[tuple[str, int], ...]], int] = {}
    part_of: dict[InertialTerm, list[str]] = {}
    for coefficient in algebra.coefficients:
        for addend in coefficient.addends:
            columns.setdefault((addend.term, addend.constants), len(columns))
            names = part_of.setdefault(addend.term, [])
            if coefficient.name not in names:
                names.append(coefficient.name)
    rows = [[fmpq(0)] * len(columns) for _ in algebra.coefficients]
    for row, coefficient in zip(rows, algebra.coefficients, strict=True):
        for addend in coefficient.addends:
            factor = fmpq(addend.factor.numerator, addend.factor.denominator)
            row[columns[addend.term, addend.constants]] += factor
    echelon, _ = fmpq_mat(rows).rref() if rows else (fmpq_mat(0, 0), 0)
    alone = {
        next(index for index, value in enumerate(row) if value)
        for row in echelon.tolist()
        if sum(1 for value in row if value) == 1
    }
    identified = {term for (term, _), column in columns.items() if column in alone}
    return tuple(
        StructuralIdentifiability(
            term.label,
            term.link + 1,
            "alone"
            if term in identified
            else "only in combinations"
            if term in part_of
            else "not at all",
            tuple(part_of.get(term, ())),
        )
        for term in algebra.terms
    )
