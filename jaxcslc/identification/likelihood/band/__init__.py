"""Linear algebra of unknowns that are banded in time and bordered."""

from ._assembly import add_equations as add_equations
from ._columns import JointColumns as JointColumns
from ._normal_equations import (
    BandedEquations as BandedEquations,
    Factored as Factored,
    Order as Order,
    Spectrum as Spectrum,
    gram as gram,
)
from ._products import (
    equation_changes as equation_changes,
    equation_gradients as equation_gradients,
    stencil_parts as stencil_parts,
)
from ._triangle import solved as solved
