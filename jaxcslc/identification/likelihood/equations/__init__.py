from ._linearisation import Linearisation as Linearisation
from ._motion_code import MotionCode as MotionCode, motion_code as motion_code
from ._motion_equations import MotionEquations as MotionEquations
from ._stretches import Stretches as Stretches
from ._truncation import truncation as truncation
from ._yielding_equations import YieldingEquations as YieldingEquations
