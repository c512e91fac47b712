from ._candidates import Candidates as Candidates
from ._selection import Selection as Selection, Trial as Trial, choose_settings as choose_settings
