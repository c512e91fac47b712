from ._decimated_low_pass import decimated_low_pass as decimated_low_pass
from ._parallel_filter import (
    FilteredEquations as FilteredEquations,
    decimation_for as decimation_for,
    parallel_filter as parallel_filter,
)
from ._zero_phase import zero_phase as zero_phase
