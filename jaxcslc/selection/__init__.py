"""Choice of settings and friction terms by cross-validation within a recording.

In: a network and a recording. Out: `Settings` or friction terms, with all trials.

- `_selection`: `choose_settings`, by held-out scores, and the part of a long recording it uses.
- `_candidates`: what it chooses among, and the search along it.
- `_friction`: friction terms, joint by joint.
"""

from ._candidates import Candidates as Candidates
from ._friction import (
    FRICTION_CANDIDATES as FRICTION_CANDIDATES,
    OFFSET as OFFSET,
    PRE_SLIDING as PRE_SLIDING,
    FrictionChoice as FrictionChoice,
    FrictionTrial as FrictionTrial,
    choose_friction as choose_friction,
    with_all_offsets as with_all_offsets,
)
from ._selection import (
    SAMPLES_OF_THREADS as SAMPLES_OF_THREADS,
    Segment as Segment,
    Selection as Selection,
    Trial as Trial,
    choose_settings as choose_settings,
    motion_part as motion_part,
    section_of as section_of,
    sections_of as sections_of,
    selection_with_motion as selection_with_motion,
)


__all__ = [
    "Candidates",
    "FrictionChoice",
    "FrictionTrial",
    "Selection",
    "Trial",
    "choose_friction",
    "choose_settings",
]
