from ._assembly import add_equations as add_equations
from ._triangle import solved as solved
