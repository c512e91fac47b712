"""Curves and clouds of a report, thinned to what a page can draw."""

from typing import Any

import numpy as np
from jaxtyping import Float

from jaxcslc.network import CSLC
from jaxcslc.recordings import Patterns

from .._chart_curves import envelope, intervals, plain
from .._errors import predicted_torque


# Points of all curves of a page, which keep it below 8 MB; of a curve; of all clouds, of a cloud.
_ALL_POINTS, _MOST_POINTS, _LEAST_POINTS = 150_000, 5000, 200
_ALL_DOTS, _MOST_DOTS = 30_000, 1500


def torque_curves(
    patterns: Patterns, predicted: Float[np.ndarray, "samples joints"], recordings: int = 1
) -> list[dict[str, Any]]:
    """Return each joint's measured and predicted torque and their difference over time.

    Long recordings are thinned to the extremes of stretches, the more the more joints and
    `recordings` a page has. A gap longer than ten sampling intervals breaks the curves.

    **Returns** by name `measured`, `predicted` and `residual`, each x and y; and `masked`, the
    stretches of time that were not fitted; and `residual_range` over those that were.
    """
    time, torque = np.asarray(patterns.time, float), np.asarray(patterns.torque, float)
    mask = np.asarray(patterns.mask)
    steps = np.diff(time)
    breaks = np.flatnonzero(steps > 10 * np.median(steps)) + 1 if len(steps) else np.zeros(0, int)
    most = _ALL_POINTS // (3 * recordings * torque.shape[1])
    most = min(max(most, _LEAST_POINTS), _MOST_POINTS)
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
                name: _line(filled, np.insert(values, breaks, np.nan), most)
                for name, values in lines.items()
            }
            | {
                "masked": intervals(time, ~mask[:, joint]),
                "residual_range": _range(lines["residual"][mask[:, joint]]),
            }
        )
    return curves


def friction_points(
    network: CSLC,
    k: Float[np.ndarray, " coefficients"],
    patterns: Patterns,
    predicted: Float[np.ndarray, "samples joints"],
) -> list[dict[str, Any]]:
    """Return each joint's measured and modelled friction over velocity.

    Measured is the torque less what all other terms of the network predict; modelled are the
    friction terms at the same samples. Only samples that were fitted.

    - `predicted`: torque of the patterns by `k` [N m or N].

    **Returns** by name `data` and `model`, each x, the velocity [rad/s or m/s] and y [N m or N];
    an empty list if the network has no friction.
    """
    friction = network.layout.friction
    if not friction.size:
        return []
    speed, mask = np.asarray(patterns.qd), np.asarray(patterns.mask)
    of_friction = np.zeros_like(k)
    of_friction[friction] = k[friction]
    model = np.asarray(predicted_torque(network, patterns, of_friction))
    data = np.asarray(patterns.torque) - predicted + model
    clouds: list[dict[str, Any]] = []
    most = max(min(_ALL_DOTS // network.joint_count, _MOST_DOTS), 1)
    for joint in range(network.joint_count):
        samples = np.flatnonzero(mask[:, joint])
        samples = samples[:: max(-(-len(samples) // most), 1)]
        order = samples[np.argsort(speed[samples, joint], kind="stable")]
        velocity = plain(speed[order, joint])
        clouds.append(
            {
                "data": {"x": velocity, "y": plain(data[order, joint])},
                "model": {"x": velocity, "y": plain(model[order, joint])},
            }
        )
    return clouds


def _range(values: np.ndarray) -> list[float] | None:
    """Return the range of numbers, a little wider; None without any."""
    if not values.size or not np.ptp(values) > 0:
        return None
    low, high = float(values.min()), float(values.max())
    return [low - 0.1 * (high - low), high + 0.1 * (high - low)]


def _line(x: np.ndarray, y: np.ndarray, most: int) -> dict[str, list[float | None]]:
    fewer_x, fewer_y = envelope(x, y, most)
    return {"x": plain(fewer_x, 8), "y": plain(fewer_y)}
