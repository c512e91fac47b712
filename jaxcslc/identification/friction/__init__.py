from ._load import LoadFit as LoadFit, fit_load as fit_load, linearised as linearised
from ._pre_sliding import (
    PreSlidingFit as PreSlidingFit,
    fit_pre_sliding as fit_pre_sliding,
)
from ._regression import regress_friction as regress_friction
from ._saved_pre_sliding import (
    pre_sliding_document as pre_sliding_document,
    pre_sliding_from as pre_sliding_from,
)
from ._slopes import SlopeFit as SlopeFit, fit_slopes as fit_slopes
from ._yielding_friction import (
    along_motion as along_motion,
    checked_lengths as checked_lengths,
    dry_term as dry_term,
    has_states as has_states,
    pre_sliding as pre_sliding,
    split_friction as split_friction,
    state_after as state_after,
    state_at as state_at,
)
from ._yielding_motion import yielding_motion as yielding_motion
