from ._movement import (
    moved_bodies as moved_bodies,
    movement_of as movement_of,
    other_masses as other_masses,
)
from ._physical_parameters import (
    POSSIBILITY as POSSIBILITY,
    PhysicalParameters as PhysicalParameters,
    fixed_bodies as fixed_bodies,
    in_file_frames as in_file_frames,
    physical_parameters as physical_parameters,
    possible_coefficients as possible_coefficients,
)
from ._possible_fit import (
    Choice as Choice,
    Part as Part,
    PossibleFit as PossibleFit,
    judged_bodies as judged_bodies,
    possible_fit as possible_fit,
    possible_text as possible_text,
)
