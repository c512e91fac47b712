from ._algebra import (
    Algebra as Algebra,
    Lengths as Lengths,
    constant_values as constant_values,
    derive_algebra as derive_algebra,
)
from ._chain import Chain as Chain, link_twists as link_twists
from ._coefficient import Addend as Addend, Coefficient as Coefficient
from ._exact import exact_cos_sin as exact_cos_sin, exact_number as exact_number
from ._identifiability import (
    StructuralIdentifiability as StructuralIdentifiability,
    structural_identifiability as structural_identifiability,
)
from ._inertial_terms import (
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
from ._polynomials import PositionRing as PositionRing
from ._span import Basis as Basis
from ._tables import Link as Link, Table as Table
