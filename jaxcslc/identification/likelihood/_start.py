from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...motion import Patterns, Recording, Sampling
from ...network import CSLC
from .._settings import Settings
from ..solver import Identification, regressor_of
from ._motion_equations import MotionEquations
from ._objective import Point
from ._search import Problem
from ._signs import rests


TorqueSampling = Literal["held", "sampled"]
"""What a recorded torque is: held until the next sample, or the value at the sample's instant."""

# The share of its dry friction that static friction starts with; the speed at which it has gone to
# 1/e as a part of the joint's greatest speed, at first, at most and at least.
_STATIC_SHARE, _DECAY, _LEAST_DECAY, _MOST_DECAY = 0.1, 1 / 30, 1 / 1.5, 1 / 300
# Standard deviation of the logarithm of a slope about the first one, beforehand.
_SLOPE_DEVIATION = 1.0
# Below this part of its greatest speed, a joint whose readings stay the same is at rest.
_SLOW = 2e-3
# Positions without noise count as noisy by this part of the range of motion.
_LEAST_NOISE = 1e-9

Joints = Float[np.ndarray, " joints"]


def starting_point(
    network: CSLC,
    recording: Recording,
    settings: Settings,
    torque_sampling: TorqueSampling,
    resolution: Joints | None,
    start: Identification | None,
) -> tuple[Problem, Point, Joints, Joints]:
    """The problem of a recording, and where its search starts: regression on smoothed motion.

    **Returns** the problem, the point, and the noise of torque and of positions.

    **Raises** as `MaximumLikelihood.fit`.
    """
    n, p = network.joint_count, network.size
    static = _Static(network)
    settings = settings.with_options(
        torque_alignment="mean" if torque_sampling == "held" else "sample"
    )
    patterns = settings.patterns(recording)
    regression = settings.for_network(static.without).fit(static.without, patterns)
    smooth = settings.preparation.smoothing.smooth(recording.time, recording.position)
    q, speed = np.array(smooth[0]), np.abs(np.asarray(smooth[1]))
    fastest = np.maximum(speed.max(axis=0), 1e-6)

    sampling = Sampling.of(recording)
    resolution = np.array(sampling.resolution) if resolution is None else resolution
    encoder = resolution > 0.0
    least = _LEAST_NOISE * np.maximum(np.ptp(recording.position, axis=0), 1e-3)
    position_noise = np.where(
        encoder, resolution / np.sqrt(12.0), np.maximum(np.array(sampling.noise), least)
    )

    k = np.zeros(p)
    index = {name: number for number, name in enumerate(network.names)}
    for fit in (regression, start):
        if fit is not None:
            k[[index[name] for name in fit.names]] = np.asarray(fit.k)
    slopes = np.log(1.0 / (_DECAY * fastest))
    if start is None:
        k[static.indices] = _STATIC_SHARE * static.dry(k)[static.joints]

    def known(point: Point) -> tuple[Float[np.ndarray, " border"], Float[np.ndarray, " border"]]:
        # Encoders are within half a step, and friction at rest rarely is above twice the dry one:
        # without the latter, static friction that the motion does not show grows without bounds,
        # with a slope that hides it.
        dry = static.dry(point.k)[static.joints]
        of_k = np.zeros(p)
        of_k[static.indices] = np.where(static.with_dry, np.maximum(dry, 1e-9) ** -2.0, 0.0)
        of_slopes = np.zeros(n)
        of_slopes[static.joints] = _SLOPE_DEVIATION**-2
        return (
            np.concatenate([np.zeros(p), slopes, np.zeros(n)]),
            np.concatenate([of_k, of_slopes, position_noise**-2.0]),
        )

    def breakaway(point: Point) -> Joints:
        dry, at_rest = static.dry(point.k), np.zeros(n)
        at_rest[static.joints] = np.abs(point.k[static.indices])
        beyond = np.where(dry > 0.0, np.minimum(at_rest, dry), at_rest)
        return dry + beyond + 1e-9

    moves = np.zeros(n)
    moves[static.joints] = 0.5
    problem = Problem(
        equations=MotionEquations(network, jnp.asarray(np.diff(recording.time))),
        time=np.asarray(recording.time),
        position=np.asarray(recording.position),
        torque=averaged_torque(recording, torque_sampling),
        stuck=rests(
            recording.position, speed, np.where(encoder, resolution, 2 * least), _SLOW * fastest
        ),
        scale=np.concatenate(
            [_scale(network, patterns, np.asarray(regression.torque_error)), moves, position_noise]
        ),
        known=known,
        slope_bounds=(
            np.log(1.0 / (_LEAST_DECAY * fastest)),
            np.log(1.0 / (_MOST_DECAY * fastest)),
        ),
        breakaway=breakaway,
        fixed_noise=encoder,
    )
    point = Point(k, slopes, np.zeros(n), q, np.zeros(0))
    return problem, point, np.asarray(regression.torque_error), position_noise


def averaged_torque(
    recording: Recording, torque_sampling: TorqueSampling
) -> Float[np.ndarray, "equations joints"]:
    """The recorded torque, averaged as the second difference averages acceleration.

    >>> import numpy as np
    >>> line = np.arange(5.0)[:, None]
    >>> recording = Recording(np.arange(5.0), line, line)
    >>> averaged_torque(recording, "held")[:, 0].tolist()
    [0.5, 1.5, 2.5]
    >>> averaged_torque(recording, "sampled")[:, 0].tolist()
    [1.0, 2.0, 3.0]
    """
    torque, h = np.asarray(recording.torque), np.diff(recording.time)[:, None]
    before, after = h[:-1] / (h[:-1] + h[1:]), h[1:] / (h[:-1] + h[1:])
    if torque_sampling == "held":
        return before * torque[:-2] + after * torque[1:-1]
    # Linear between samples: two thirds of each triangle are at its middle, a third at its end.
    return (before * torque[:-2] + 2.0 * torque[1:-1] + after * torque[2:]) / 3.0


class _Static:
    """Which joints have static friction, and which of them dry friction; a network without it."""

    def __init__(self, network: CSLC) -> None:
        laws = network.robot.friction_per_joint
        self.joints = [joint for joint, kinds in enumerate(laws) if "static" in kinds]
        self.without, self.indices = network, np.zeros(0, int)
        if self.joints:
            self.without = network.without_law("static", [joint + 1 for joint in self.joints])
            self.indices = network.layout.indices("static")
        self.with_dry = np.array(["dry" in laws[joint] for joint in self.joints], bool)
        self._dry_joints = [joint for joint, kinds in enumerate(laws) if "dry" in kinds]
        self._dry = network.layout.indices("dry") if self._dry_joints else self.indices[:0]
        self._joint_count = network.joint_count

    def dry(self, k: Float[np.ndarray, " coefficients"]) -> Joints:
        """(n,) absolute coefficients of dry friction, 0 for joints without."""
        result = np.zeros(self._joint_count)
        result[self._dry_joints] = np.abs(k[self._dry])
        return result


def _scale(
    network: CSLC, patterns: Patterns, torque_error: Joints
) -> Float[np.ndarray, " coefficients"]:
    """One over the length of each column of the regressor, joints weighted by their residual."""
    weights = 1.0 / np.maximum(torque_error, 1e-6 * max(float(torque_error.max()), 1e-12))
    regressor = np.asarray(regressor_of(network, patterns)) * weights[None, :, None]
    length = np.sqrt(np.sum(regressor**2, axis=(0, 1)))
    return 1.0 / np.where(length > 0.0, length, 1.0)
