from ._assembly import add_equations as add_equations
from ._columns import JointColumns as JointColumns
from ._normal_equations import (
    BandedEquations as BandedEquations,
    Factored as Factored,
    Order as Order,
    Spectrum as Spectrum,
    gram as gram,
)
from ._triangle import solved as solved
