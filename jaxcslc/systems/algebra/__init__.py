from ._identifiability import ConstantIdentifiability as ConstantIdentifiability
from ._separation import Separation as Separation, separate as separate
