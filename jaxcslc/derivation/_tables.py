from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

from ..manipulator import RobotError, Subnumbering
from ._lagrange import Element
from ._polynomials import PositionRing
from ._sparse_polynomial import Monomial


Column = tuple[int, ...]  # (row, column) of M, (i, j, k) of c_ijk or (joint,) of G, from 0


@dataclass(frozen=True)
class Link:
    """A link of the network: from an input to an element, weighted by coefficients.

    **Attributes**

    - `input`, `column`: indices into the table's `inputs` and `columns`.
    - `weights`: (coefficient, multiple) pairs, coefficients counted from 0 in the network's vector.
    """

    input: int
    column: int
    weights: tuple[tuple[int, Fraction], ...]


@dataclass(frozen=True, eq=False)  # compared by identity: a table is part of compiled functions
class Table:
    """One subnetwork: element = sum over its links of weight times input (thesis 5.1).

    **Attributes**

    - `inputs`: monomials in the ring's variables: the preprocessed inputs.
    - `labels`: the same as they are printed, `"c23*s4*c5"`.
    - `columns`: which element each node of the second layer is, indices from 0: (j, k) of the
      mass matrix, (i, j, k) of the Christoffel symbols, (i,) of the gravity vector.
    - `links`: those that exist.
    """

    inputs: tuple[Monomial, ...]
    labels: tuple[str, ...]
    columns: tuple[Column, ...]
    links: tuple[Link, ...]

    @property
    def coefficients(self) -> frozenset[int]:
        """Indices of the coefficients that the links use."""
        return frozenset(index for link in self.links for index, _ in link.weights)


def table(
    ring: PositionRing,
    elements: Mapping[Column, Element],
    published: Subnumbering | None = None,
    source: str = "",
) -> Table:
    """Sort elements, their forms written in coefficients, into inputs and links.

    Inputs are numbered as they are met, column by column, simple ones first; or as `published`
    lists them.

    **Raises**

    - `RobotError`: if the published inputs are not exactly those of the algebra.
    """
    inputs: dict[Monomial, int] = {}
    if published is not None and published.inputs:
        inputs = _published_inputs(ring, elements, published.inputs, source)
    else:
        for element in elements.values():
            for monomial in sorted(element, key=lambda m: (sum(m), [-power for power in m])):
                inputs.setdefault(monomial, len(inputs))
    columns = tuple(elements)
    links = [
        Link(
            inputs[monomial],
            column,
            tuple(
                (index, Fraction(int(value.numerator), int(value.denominator)))
                for index, value in sorted(form.items())
            ),
        )
        for column, element in enumerate(elements.values())
        for monomial, form in element.items()
    ]
    links.sort(key=lambda link: (link.input, link.column))
    return Table(
        tuple(inputs), tuple(ring.label(monomial) for monomial in inputs), columns, tuple(links)
    )


def _published_inputs(
    ring: PositionRing, elements: Mapping[Column, Element], labels: Sequence[str], source: str
) -> dict[Monomial, int]:
    monomials = {monomial for element in elements.values() for monomial in element}
    inputs: dict[Monomial, int] = {}
    for label in labels:
        monomial = ring.parse(label)
        if monomial is None or monomial not in monomials or monomial in inputs:
            raise RobotError(
                f"numbering ({source}): {label!r} is not an input of this robot, or is listed twice"
            )
        inputs[monomial] = len(inputs)
    if missing := monomials - set(inputs):
        raise RobotError(
            f"numbering ({source}): input {ring.label(min(missing))!r} of this robot is not listed"
        )
    return inputs
