from collections.abc import Sequence
from typing import Literal, get_args

from ..solver import ERRORS, Errors
from .torque import MOST_ORDER, TorqueSampling, TorqueUnknown


LikelihoodUnknown = TorqueUnknown | Literal["transmission"]
"""What may be estimated beside coefficients: of recorded torques, or gears that give way."""
_UNKNOWNS = (*get_args(TorqueUnknown), "transmission")


def check_options(
    torque_sampling: TorqueSampling,
    errors: Errors,
    every: int | Literal["auto"],
    noise_order: int | Literal["auto"],
    unknowns: Sequence[LikelihoodUnknown],
) -> None:
    """**Raises** `ValueError` for options of `MaximumLikelihood` that there are none of."""
    if torque_sampling not in get_args(TorqueSampling):
        raise ValueError(
            f"torque_sampling {torque_sampling!r} is unknown; expected 'held' or 'sampled'"
        )
    if errors not in ERRORS:
        raise ValueError(f"errors: expected {' or '.join(ERRORS)}, got {errors!r}")
    if every != "auto" and every < 1:
        raise ValueError(f"every: expected 1 or more or 'auto', got {every}")
    if noise_order != "auto" and not 0 <= noise_order <= MOST_ORDER:
        raise ValueError(f"noise_order: expected 0 to {MOST_ORDER} or 'auto', got {noise_order}")
    for name in unknowns:
        if name not in _UNKNOWNS:
            raise ValueError(f"unknowns: expected {' or '.join(_UNKNOWNS)}, got {name!r}")
