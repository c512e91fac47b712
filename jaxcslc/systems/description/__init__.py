from ._entries import Constant as Constant, Variable as Variable, name_of as name_of, named as named
from ._errors import DescriptionError as DescriptionError
from ._formula import RESERVED as RESERVED, parse_equation as parse_equation
from ._mechanics import (
    lagrange_equations as lagrange_equations,
    mechanics_equations as mechanics_equations,
)
from ._motion_symbols import MotionSymbols as MotionSymbols
from ._units import check_unit as check_unit, product_of_units as product_of_units
