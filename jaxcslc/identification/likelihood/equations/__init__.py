"""Equations of motion as functions of positions: by C code, in JAX, with pre-sliding friction."""

from ._equations import (
    AbstractEquations as AbstractEquations,
    MotionEquations as MotionEquations,
    triangle_truncation as triangle_truncation,
)
from ._linearisation import Linearisation as Linearisation
from ._motion_code import MotionCode as MotionCode, motion_code as motion_code
from ._pre_sliding_equations import PreSlidingEquations as PreSlidingEquations
from ._traced_equations import TracedEquations as TracedEquations
