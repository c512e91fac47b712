"""Description of systems: variables, constants, units, and equations.

- `_entries`: variables, constants and units; `_motion_symbols`: their plain symbols.
- `_formula`: equations as text; `_mechanics`: equations by Lagrange or SymPy's mechanics.
"""

from ._entries import (
    Constant as Constant,
    DescriptionError as DescriptionError,
    Variable as Variable,
    check_unit as check_unit,
    named as named,
    product_of_units as product_of_units,
)
from ._formula import RESERVED as RESERVED, parse_equation as parse_equation
from ._mechanics import (
    lagrange_equations as lagrange_equations,
    mechanics_equations as mechanics_equations,
)
from ._motion_symbols import MotionSymbols as MotionSymbols
