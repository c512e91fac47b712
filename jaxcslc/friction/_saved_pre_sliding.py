"""Plain data of a `PreSlidingFit`, written and read."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..least_squares import Identification
from ..network import CSLC
from ..uncertainty import RelativeError
from ._pre_sliding import PreSlidingFit


_LENGTHS = ("lengths", "tried_lengths")


def pre_sliding_document(result: PreSlidingFit) -> dict[str, Any]:
    """A `PreSlidingFit` as plain data, without its network."""
    return {
        **{name: getattr(result, name) for name in _LENGTHS},
        "relative": {
            str(joint): [error.change, error.change_error, error.parts]
            for joint, error in result.relative.items()
        },
        "fit": result.fit.document(),
    }


def pre_sliding_from(document: Any, network: CSLC, where: str) -> PreSlidingFit:
    """Read the fit that `pre_sliding_document` wrote; `where` it was read.

    **Raises** `ValueError` for something else; the message names the entry.
    """
    if not isinstance(document, Mapping) or not isinstance(document.get("fit"), Mapping):
        raise ValueError(f"{where}: expected a JSON object with a fit")
    fit = Identification.from_document(document["fit"], f"{where}, fit")
    if fit.names != network.names:
        raise ValueError(f"{where}, fit: expected the coefficients of {network.name!r}")
    try:
        lengths, tried = (np.array(document[name], float) for name in _LENGTHS)
        relative = {
            int(joint): RelativeError(
                float(change), np.inf if spread is None else float(spread), int(parts)
            )
            for joint, (change, spread, parts) in document["relative"].items()
        }
    except (AttributeError, KeyError, TypeError, ValueError):
        raise ValueError(f"{where}: expected lengths, tried_lengths and relative") from None
    shape = (network.joint_count,)
    if lengths.shape != shape or tried.shape != shape or not np.all(lengths >= 0.0):
        raise ValueError(f"{where}: lengths: expected {shape[0]} numbers from 0 up")
    return PreSlidingFit(network, fit, lengths, relative, tried)
