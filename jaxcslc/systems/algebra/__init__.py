"""Exact algebra that separates known variables from unknown constants.

equations ──► angles, generators ──► fractions ──► separation ──► identifiability
"""

from ._identifiability import (
    COMPLEX_STEP as COMPLEX_STEP,
    ConstantIdentifiability as ConstantIdentifiability,
)
from ._separation import Separation as Separation, separate as separate
