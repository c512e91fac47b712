"""Friction that is not linear in its parameters: slopes, load, and pre-sliding.

In: a network with friction terms, and patterns. Out: fits with the nonlinear parameters. The laws
themselves, linear or not, are rows of a table in `jaxcslc.network.terms`.

- `_slopes`: slopes of static friction.
- `_load`: friction that grows with the load; uses `_slopes`.
- `_pre_sliding`: states of pre-sliding (Dahl) friction along a motion, fitted and saved.
"""

from ._load import (
    LoadFit as LoadFit,
    fit_load as fit_load,
    linearised as linearised,
    regress_friction as regress_friction,
)
from ._pre_sliding import (
    PreSlidingFit as PreSlidingFit,
    along_motion as along_motion,
    checked_distance as checked_distance,
    contact_states as contact_states,
    dry_term as dry_term,
    fit_pre_sliding as fit_pre_sliding,
    has_states as has_states,
    informed_errors as informed_errors,
    pre_sliding_document as pre_sliding_document,
    pre_sliding_from as pre_sliding_from,
    split_friction as split_friction,
    state_after as state_after,
    state_at as state_at,
)
from ._slopes import SlopeFit as SlopeFit, fit_slopes as fit_slopes


__all__ = [
    "LoadFit",
    "PreSlidingFit",
    "SlopeFit",
    "contact_states",
    "fit_load",
    "fit_pre_sliding",
    "fit_slopes",
    "regress_friction",
]
