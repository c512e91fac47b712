"""The search for the most likely unknowns."""

from ._search import Minimum as Minimum, search as search, search_on as search_on
from ._state import State as State
