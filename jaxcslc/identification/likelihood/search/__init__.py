from ._search import Minimum as Minimum, search as search
