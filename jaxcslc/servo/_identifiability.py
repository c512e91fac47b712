"""Parameters that recordings of a servo joint can tell apart, and what would separate the rest.

Two parameters are confounded if a change of one is nearly undone by a change of the other. That is
seen in the derivatives of the simulated positions with respect to all parameters of a drive, also
those that the fit keeps at zero.
"""

import dataclasses
import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ._search import UNKNOWNS, JointProblem


CONFOUNDED_FROM = 0.9
"""Correlation of two estimates from which on they count as confounded: the interval of either is
more than twice as wide as with the other known."""
# Of a parameter's size: one that is known better is not confounded, whatever correlates.
_VAGUE = 0.1
EXCHANGED = ("dead_zone", "coulomb")
"""Parameters that act alike where no load holds a joint, both in rad as ratios to the gain."""
_TRIALS = 9  # of exchanges: the cost is rough
_LIKELY = 3.84  # of the cost, twice the negative logarithm of a density: within 95 %


@dataclass(frozen=True)
class ConfoundedParameters:
    """Parameters of a joint that the recordings cannot tell apart, and what would separate them.

    **Attributes**

    - `joint`: index of the joint, from 0.
    - `parameters`: names of the parameters.
    - `reason`: why they have the same effect in these recordings.
    - `remedy`: the motion, load or known value that would separate them.

    >>> from jaxcslc.servo import ConfoundedParameters
    >>> pair = ConfoundedParameters(0, ("delay", "damping"), "slow motion", "add fast motion")
    >>> pair.remedy
    'add fast motion'
    """

    joint: int
    parameters: tuple[str, ...]
    reason: str
    remedy: str


PAIRS: dict[tuple[str, str], tuple[str, str]] = {
    ("gain", "armature"): (
        "no load scales the torque: gravity does not turn this joint, or does so in one pose only",
        "hang a known mass on the arm, move the joint where gravity loads it, or give the gain",
    ),
    ("gain", "coulomb"): (
        "the load is almost constant, so that friction and the gain scale together",
        "record with and without a known payload, or over a wide range of poses",
    ),
    ("gain", "offset"): (
        "gravity was seen in a narrow range of positions",
        "move the joint over at least 60 degrees on both sides of the vertical",
    ),
    ("gain", "load_friction"): (
        "the load has one direction and size",
        "move the joint through poses in which its load changes sign, or add a known payload",
    ),
    ("coulomb", "load_friction"): (
        "the load is almost constant",
        "record slow motion in poses with and without load, or add a known payload",
    ),
    ("delay", "damping"): (
        "the motion is slow: a late servo and a damped one lag alike",
        "add motion near the servo's bandwidth, such as a sine sweep up to 3 Hz or small steps",
    ),
    ("delay", "armature"): (
        "the motion has little acceleration",
        "add steps or a sine sweep up to 3 Hz",
    ),
    ("damping", "armature"): (
        "the motion has little acceleration",
        "add steps or a sine sweep up to 3 Hz",
    ),
    ("damping", "viscous"): (
        "the servo never reaches its torque limit, and both brake in proportion to velocity",
        "give the servo's D gain, or record the same motion with another D gain",
    ),
    ("damping", "lead"): (
        "the command's velocity is nearly that of the joint",
        "add steps of the command",
    ),
    ("dead_zone", "coulomb"): (
        "the joint was never loaded and never at rest under a small error",
        "record small slow steps of one to ten encoder ticks, under a load that gravity reverses",
    ),
    ("dead_zone", "static"): (
        "both hold the joint against a small error",
        "record small slow steps of one to ten encoder ticks, under a load that gravity reverses",
    ),
    ("static", "coulomb"): (
        "the joint seldom starts from rest, or always moves slowly",
        "add slow reversals with pauses, and motion above 0.2 rad/s",
    ),
    ("static", "stribeck"): (
        "motion between rest and sliding is short",
        "add very slow ramps, below 0.05 rad/s",
    ),
    ("play", "dead_zone"): (
        "both let the joint rest away from the command",
        "reverse slowly under a load that gravity reverses, and read the position at the joint",
    ),
    ("play", "static"): (
        "both delay a reversal",
        "reverse at several speeds: play takes a distance, static friction takes a torque",
    ),
    ("integral", "coulomb"): (
        "the command never rests long enough for the integral to act",
        "add pauses of some seconds",
    ),
}
"""Reason and remedy of each pair of parameters that servo recordings often cannot tell apart."""

ALONE: dict[str, tuple[str, str]] = {
    "gain": (
        "no known mass loads this joint, so that only ratios to the gain are determined",
        "hang a known mass on the arm where gravity turns this joint, or give the gain",
    ),
    "offset": (
        "gravity does not turn this joint, so that its zero has no effect",
        "none is needed: the arm moves alike whatever this offset is",
    ),
    "load_friction": (
        "the joint carries no load",
        "move it in poses in which gravity loads it, or add a known payload",
    ),
    "delay": ("the motion is slow", "add steps or a sine sweep up to 3 Hz"),
    "armature": ("the motion has little acceleration", "add steps or a sine sweep up to 3 Hz"),
    "static": ("the joint seldom starts from rest", "add slow reversals with pauses"),
    "stribeck": ("the joint seldom starts from rest", "add ramps below 0.05 rad/s"),
    "torque_limit": (
        "the servo never reaches its torque limit",
        "add a step of the command that is larger than the largest error of these recordings",
    ),
}
"""The same of parameters that the recordings do not determine."""


COMPLIANCE = (
    "a compliant gear shows alike, and the model has none",
    "push the joint by hand both ways while its servo holds: play needs no force",
)
"""Reason and remedy for play, wherever it is estimated."""


def confounded(
    joint: int,
    problem: JointProblem,
    x: Float[np.ndarray, " unknowns"],
    masses: float,
    given: Collection[str] = (),
) -> list[tuple[ConfoundedParameters, Float[np.ndarray, "pair pair"]]]:
    """Return the known pairs that the recordings of a joint confound, and their covariances.

    Parameters that the fit left at zero take part: they might explain the motion instead of those
    that it estimated.

    - `x`, `masses`: unknowns of the problem, and the scale of the links' masses.
    - `given`: names of parameters that are known, and take no part.
    """
    row = problem.rows(x[None])[0]
    names = tuple(UNKNOWNS)
    whole = dataclasses.replace(problem, names=names)
    z = whole.unknowns_of(row)
    sizes = np.array([UNKNOWNS[x].size(value) for x, value in zip(names, z, strict=True)])
    A = whole.information(z, masses)
    found: list[tuple[ConfoundedParameters, np.ndarray]] = []
    if "play" in problem.names:
        found.append((ConfoundedParameters(joint, ("play",), *COMPLIANCE), np.zeros((1, 1))))
    for pair, (reason, remedy) in PAIRS.items():
        if not set(pair) & set(problem.names) or set(pair) & set(given):
            continue
        keep = [names.index(name) for name in pair]
        # The others are what the fit estimates, known as well as recordings and priors say.
        others = [names.index(name) for name in problem.names if name not in pair]
        edge = A[np.ix_(keep, others)]
        marginal = A[np.ix_(keep, keep)] - edge @ np.linalg.solve(A[np.ix_(others, others)], edge.T)
        covariance = np.linalg.inv(marginal)
        spread = np.sqrt(np.diag(covariance))
        correlation = covariance[0, 1] / (spread[0] * spread[1])
        vague = np.any(spread > _VAGUE * sizes[keep])
        slope = covariance[0, 1] / covariance[0, 0]
        exchanged = pair == EXCHANGED and _is_exchangeable(problem, x, masses)
        if exchanged or (abs(correlation) > CONFOUNDED_FROM and vague):
            if exchanged or ("dead_zone" in pair and correlation < 0.0):
                covariance = covariance + _exchange(z[keep], -1.0 if exchanged else slope)
            found.append((ConfoundedParameters(joint, pair, reason, remedy), covariance))
    return found


def _is_exchangeable(
    problem: JointProblem, x: Float[np.ndarray, " unknowns"], masses: float
) -> bool:
    """Return True if Coulomb friction may take the part of the dead zone, or the reverse.

    Where no load holds a joint, both leave it where it is while the error is small. Derivatives
    tell them apart by the roughness of simulated positions: whole exchanges do not.
    """
    if not set(EXCHANGED) <= set(problem.names):
        return False
    zone, friction = (problem.names.index(name) for name in EXCHANGED)
    amounts = np.linspace(-x[zone], x[friction], _TRIALS)
    amounts = amounts[np.abs(amounts) > _VAGUE * (x[zone] + x[friction])]
    trials = np.tile(x, (1 + len(amounts), 1))
    trials[1:, zone] += amounts
    trials[1:, friction] -= amounts
    cost, *others = problem.cost(trials, masses)
    return bool(min(others, default=math.inf) < cost + _LIKELY)


def _exchange(values: Float[np.ndarray, "2"], slope: float) -> Float[np.ndarray, "pair pair"]:
    """Return the covariance of two values, one of which may be zero if the other takes its part.

    - `slope`: change of the second value over that of the first.

    A dead zone acts as friction whenever the joint moves. What separates them is less than the
    roughness of simulated positions, which counts as information in derivatives.
    """
    # Two standard deviations take the first value to where either is zero.
    deviation = 0.5 * max(values[0], -values[1] / slope)
    return deviation**2 * np.outer([1.0, slope], [1.0, slope])
