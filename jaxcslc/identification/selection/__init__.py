from ._candidates import Candidates as Candidates
from ._friction import (
    FRICTION_CANDIDATES as FRICTION_CANDIDATES,
    PRE_SLIDING as PRE_SLIDING,
    FrictionChoice as FrictionChoice,
    FrictionTrial as FrictionTrial,
    choose_friction as choose_friction,
)
from ._section import Section as Section, section_of as section_of, sections_of as sections_of
from ._selection import (
    Selection as Selection,
    Trial as Trial,
    choose_settings as choose_settings,
    selection_with_motion as selection_with_motion,
)
