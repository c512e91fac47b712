from ._candidates import Candidates as Candidates
from ._section import Section as Section, section_of as section_of, sections_of as sections_of
from ._selection import Selection as Selection, Trial as Trial, choose_settings as choose_settings
