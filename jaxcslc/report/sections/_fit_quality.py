"""Errors of a prediction in units of the torque, in % of its RMS, and as R²."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from jaxcslc.recordings import Patterns


def fit_quality(
    patterns: Patterns, predicted: Float[np.ndarray, "samples joints"]
) -> dict[str, dict[str, list[float]]]:
    """Errors of a prediction in units of the torque, in % of its RMS, and as R².

    **Arguments**

    - `patterns`: measured torque; n joints.
    - `predicted`: of the same samples.

    **Returns** for `"judged"` samples, those in `Patterns.mask`, and for `"all"` samples, by name,
    a number a joint: `rms` and `torque_rms` [N m or N], `percent`, the first of the second, and
    `r_squared`, one less the squared errors over the squared deviations of the torque from its
    mean. NaN of a joint without samples, and in `r_squared` without any deviation.

    >>> import numpy as np
    >>> time, pairs = np.arange(4.0), np.ones((4, 1), bool)
    >>> torque = np.array([[3.0], [-3.0], [3.0], [-3.0]])
    >>> patterns = Patterns(time, torque, torque, torque, torque, pairs, pairs)
    >>> quality = fit_quality(patterns, 0.9 * torque)["judged"]
    >>> [round(quality[name][0], 6) for name in ("rms", "torque_rms", "percent", "r_squared")]
    [0.3, 3.0, 10.0, 0.99]
    """
    torque, judged = np.asarray(patterns.torque), np.asarray(patterns.mask)
    return {
        name: _of_samples(torque, predicted, mask)
        for name, mask in (("judged", judged), ("all", np.ones_like(judged)))
    }


def _of_samples(
    torque: Float[np.ndarray, "samples joints"],
    predicted: Float[np.ndarray, "samples joints"],
    mask: Bool[np.ndarray, "samples joints"],
) -> dict[str, list[float]]:
    result: dict[str, list[float]] = {
        name: [] for name in ("rms", "torque_rms", "percent", "r_squared")
    }
    for joint in range(torque.shape[1]):
        samples = mask[:, joint]
        values = torque[samples, joint]
        error = values - predicted[samples, joint]
        squares = float(np.sum(error**2))
        count = values.size or np.nan
        rms, size = np.sqrt(squares / count), np.sqrt(float(np.sum(values**2)) / count)
        deviation = float(np.sum((values - values.mean()) ** 2)) if values.size else 0.0
        result["rms"].append(float(rms))
        result["torque_rms"].append(float(size))
        result["percent"].append(float(100 * rms / size) if size > 0 else np.nan)
        result["r_squared"].append(1.0 - squares / deviation if deviation > 0 else np.nan)
    return result


def worst_joint(quality: Mapping[str, Any], samples: str) -> int | None:
    """The joint, counted from 0, of the largest error in % of its torque; None if none has one."""
    percent = np.asarray(quality[samples]["percent"], float)
    return int(np.nanargmax(percent)) if np.any(np.isfinite(percent)) else None
