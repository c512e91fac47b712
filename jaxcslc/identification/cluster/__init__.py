from ._blocks import Derivation as Derivation, Work as Work, block_factors as block_factors
from ._cluster import (
    Fleet as Fleet,
    fit_fleet_on_cluster as fit_fleet_on_cluster,
    fit_on_cluster as fit_on_cluster,
)
