"""Exact derivation of a robot's inverse dynamics: no JAX and no floating point.

`derive_algebra` takes a `Manipulator` and gives an `Algebra`: coefficients, and tables of inputs
and links of the mass matrix, the Christoffel symbols and the gravity vector. `jaxcslc.network`
builds its terms from it.

     Manipulator --> chain --> twists --> M, G as polynomials --> basis --> tables
                     (angles)  (Jacobians)  (Lagrange, c and s)   (stage C.1.4)

Modules, in reading order:

- `_chain`: rationals for decimals and angles; kinematics in groups of parallel axes, and the
  columns of the links' Jacobians.
- `_polynomials`: sparse polynomials in sines and cosines, and their normal form.
- `_lagrange`: products of link parameters; mass matrix, gravity vector and Christoffel symbols.
- `_base_parameters`: the fewest coefficients, for numeric lengths and for symbolic ones.
- `_tables`: coefficients and their signs, inputs and links.
- `_algebra`: the whole derivation.
- `_identifiability`: which link parameters coefficients determine.
- `_newton_euler`: the same dynamics as a recursion, over any kind of number.
"""

from ._algebra import (
    Algebra as Algebra,
    Lengths as Lengths,
    constant_values as constant_values,
    derive_algebra as derive_algebra,
)
from ._base_parameters import Basis as Basis
from ._chain import (
    Chain as Chain,
    exact_cos_sin as exact_cos_sin,
    exact_number as exact_number,
    link_twists as link_twists,
)
from ._identifiability import (
    StructuralIdentifiability as StructuralIdentifiability,
    structural_identifiability as structural_identifiability,
)
from ._lagrange import (
    BODY as BODY,
    InertialTerm as InertialTerm,
    UnitInertia as UnitInertia,
    inertial_terms as inertial_terms,
)
from ._newton_euler import (
    LinkFrame as LinkFrame,
    NewtonEuler as NewtonEuler,
    link_frames as link_frames,
)
from ._polynomials import PositionRing as PositionRing, product_text as product_text
from ._tables import (
    Addend as Addend,
    Coefficient as Coefficient,
    ProductTable as ProductTable,
    TableLink as TableLink,
    sum_text as sum_text,
)


__all__ = [
    "BODY",
    "Addend",
    "Algebra",
    "Basis",
    "Chain",
    "Coefficient",
    "InertialTerm",
    "Lengths",
    "LinkFrame",
    "NewtonEuler",
    "PositionRing",
    "ProductTable",
    "StructuralIdentifiability",
    "TableLink",
    "UnitInertia",
    "constant_values",
    "derive_algebra",
    "exact_cos_sin",
    "exact_number",
    "inertial_terms",
    "link_frames",
    "link_twists",
    "structural_identifiability",
]
