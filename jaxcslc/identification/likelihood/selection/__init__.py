from ._noise_excitation import NoiseExcitation as NoiseExcitation
from ._noise_order import NoiseOrders as NoiseOrders
from ._selection import (
    ModelSelection as ModelSelection,
    OrderChoice as OrderChoice,
    SpacingTrial as SpacingTrial,
    best_spacing as best_spacing,
)
