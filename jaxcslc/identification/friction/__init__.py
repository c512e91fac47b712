from ._load import LoadFit as LoadFit, fit_load as fit_load, linearised as linearised
from ._slopes import SlopeFit as SlopeFit, fit_slopes as fit_slopes
