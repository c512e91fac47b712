"""What is known beforehand: values of coefficients, and consistent bodies."""

from ._possible_bodies import possible_bodies as possible_bodies
from ._prior_values import check_prior as check_prior, prior_values as prior_values
