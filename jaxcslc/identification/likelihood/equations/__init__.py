from ._motion_equations import Linearisation as Linearisation, MotionEquations as MotionEquations
from ._stretches import Stretches as Stretches
from ._truncation import truncation as truncation
