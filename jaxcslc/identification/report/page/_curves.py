from typing import Any

import numpy as np
from jaxtyping import Float

from ....motion import Patterns
from ....network import CSLC
from ....page import envelope, intervals, plain


# Points of a curve, and of a cloud of points.
_MOST_POINTS = 5000
_MOST_DOTS = 1500


def torque_curves(
    patterns: Patterns, predicted: Float[np.ndarray, "samples joints"]
) -> list[dict[str, Any]]:
    """For each joint its measured and predicted torque and their difference over time.

    Long recordings are thinned to the extremes of stretches. A gap longer than ten sampling
    intervals breaks the curves.

    **Returns** by name `measured`, `predicted` and `residual`, each x and y; and `masked`, the
    stretches of time that were not fitted; and `residual_range` over those that were.
    """
    time, torque = np.asarray(patterns.time, float), np.asarray(patterns.torque, float)
    mask = np.asarray(patterns.mask)
    steps = np.diff(time)
    breaks = np.flatnonzero(steps > 10 * np.median(steps)) + 1 if len(steps) else []
    clock = np.insert(time, breaks, np.nan)
    filled = np.where(np.isnan(clock), np.insert(time, breaks, time[breaks]), clock)
    curves: list[dict[str, Any]] = []
    for joint in range(torque.shape[1]):
        lines = {
            "measured": torque[:, joint],
            "predicted": predicted[:, joint],
            "residual": torque[:, joint] - predicted[:, joint],
        }
        curves.append(
            {
                name: _line(filled, np.insert(values, breaks, np.nan))
                for name, values in lines.items()
            }
            | {
                "masked": intervals(time, ~mask[:, joint]),
                "residual_range": _range(lines["residual"][mask[:, joint]]),
            }
        )
    return curves


def friction_points(
    network: CSLC, k: Float[np.ndarray, " coefficients"], patterns: Patterns
) -> list[dict[str, Any]]:
    """For each joint the friction that was measured and that is modelled, over velocity.

    Measured is the torque less what all other terms of the network predict; modelled are the
    friction terms at the same samples. Only samples that were fitted.

    **Returns** by name `data` and `model`, each x, the velocity [rad/s or m/s] and y [N m or N];
    an empty list if the network has no friction.
    """
    friction = network.layout.friction
    if not friction.size:
        return []
    motion = (np.asarray(patterns.q), np.asarray(patterns.qd), np.asarray(patterns.qdd))
    of_friction = np.zeros_like(k)
    of_friction[friction] = k[friction]
    model = np.asarray(network.torque(of_friction, *motion))
    data = np.asarray(patterns.torque) - np.asarray(network.torque(k - of_friction, *motion))
    mask = np.asarray(patterns.mask)
    clouds: list[dict[str, Any]] = []
    for joint in range(network.joint_count):
        samples = np.flatnonzero(mask[:, joint])
        samples = samples[:: max(-(-len(samples) // _MOST_DOTS), 1)]
        order = samples[np.argsort(motion[1][samples, joint], kind="stable")]
        velocity = plain(motion[1][order, joint])
        clouds.append(
            {
                "data": {"x": velocity, "y": plain(data[order, joint])},
                "model": {"x": velocity, "y": plain(model[order, joint])},
            }
        )
    return clouds


def _range(values: np.ndarray) -> list[float] | None:
    """Of numbers, a little wider; None without any."""
    if not values.size or not np.ptp(values) > 0:
        return None
    low, high = float(values.min()), float(values.max())
    return [low - 0.1 * (high - low), high + 0.1 * (high - low)]


def _line(x: np.ndarray, y: np.ndarray) -> dict[str, list[float | None]]:
    fewer_x, fewer_y = envelope(x, y, _MOST_POINTS)
    return {"x": plain(fewer_x, 8), "y": plain(fewer_y)}
