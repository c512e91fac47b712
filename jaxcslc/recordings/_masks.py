"""Masks of joint-and-sample pairs: backlash, slow motion, reversals, and joints at rest.

The thesis leaves out pairs in backlash (Eqn 2.5-7) and slow pairs (Section 7.2.2).
"""

from collections.abc import Callable, Sequence
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._environment import array_namespace
from ._recording import Samples, Signals
from ._sampling import encoder_resolution, noise_level


Thresholds: TypeAlias = float | int | Sequence[float | int] | Float[np.ndarray, " joints"]
"""Velocities below which static friction matters: one for each joint, or one for all."""

STATIC_FRICTION_PART = 0.1
"""Part of a threshold fraction that a joint with a term of static friction keeps: such pairs
determine the term. Slower ones, at which the joint may be at rest, determine nothing."""


def possible_backlash(
    qd: Float[np.ndarray, "*batch joints"],
    qdd: Float[np.ndarray, "*batch joints"],
    torque: Float[np.ndarray, "*batch joints"],
) -> Bool[np.ndarray, "*batch joints"]:
    r"""Mark the joint-and-sample pairs at which a transmission may be in backlash.

    $\operatorname{sgn}\tau_i = \operatorname{sgn}\dot q_i$ and
    $\operatorname{sgn}\tau_i = \operatorname{sgn}\ddot q_i$ (thesis, Eqn 2.5-7): a free motor is
    pushed the way it moves and speeds up.

    The thesis holds that this includes every occurrence of backlash. Choosing pairs by the sign of
    the torque biases a fit (`scripts/studies/disturbances/budget.py`).

    Backlash is decoupled, so a pair says nothing of the other joints of its sample.

    **Arguments**

    - `qd`, `qdd`: velocities and accelerations, shape `(..., joints)`.
    - `torque`: torques, shape `(..., joints)`.

    **Returns** True where backlash is possible, shape `(..., joints)`. Where velocity, acceleration
    or torque is exactly zero, a sign is *missing* rather than shared by the other two: the
    magnitude is below what the recording resolves and the true sign may be either. A missing sign
    counts as agreeing with the others, so that the mask still includes every occurrence.

    >>> import numpy as np
    >>> from jaxcslc.recordings import possible_backlash
    >>> torque = np.array([1.0, 1.0, -1.0, 1.0])
    >>> qd = np.array([0.5, -0.5, -0.5, 0.5])
    >>> qdd = np.array([2.0, 2.0, -2.0, -2.0])
    >>> possible_backlash(qd, qdd, torque).tolist()
    [True, False, True, False]
    """
    with_velocity = np.sign(torque) * np.sign(qd) >= 0
    with_acceleration = np.sign(torque) * np.sign(qdd) >= 0
    # A zero torque has lost its sign, but that of the motion is still to agree with itself.
    same_direction = np.sign(qd) * np.sign(qdd) >= 0
    return with_velocity & with_acceleration & same_direction


def friction_thresholds(
    qd: Signals, fraction: float | tuple[float, ...]
) -> Float[np.ndarray, " joints"]:
    """Return velocities below which static friction is taken to matter, joint by joint.

    The thesis starts from one hundredth of each joint's greatest velocity in the training
    recording (Section 7.5) and sharpens it once the friction can be seen (Appendix B.6).

    **Arguments**

    - `qd`: velocities, shape `(samples, joints)` [rad/s or m/s].
    - `fraction`: of each joint's greatest speed; one for all joints or one for each.

    **Returns** the thresholds, shape `(joints,)` [rad/s or m/s].

    **Raises** `ValueError`: a fraction below 0 or not below 1, or a wrong number of them.

    >>> import numpy as np
    >>> from jaxcslc.recordings import friction_thresholds
    >>> friction_thresholds(np.array([[0.5, -1.0], [-2.0, 0.25]]), 0.01).tolist()
    [0.02, 0.01]
    """
    fractions, joints = np.asarray(fraction, dtype=np.float64), qd.shape[1]
    if fractions.shape not in ((), (joints,)):
        raise ValueError(
            f"{fractions.size} threshold fractions for {joints} joints; expected one, or one for"
            " each joint"
        )
    if not np.all((fractions >= 0.0) & (fractions < 1.0)):
        raise ValueError(f"threshold fraction is {fraction}; expected at least 0 and below 1")
    return fractions * np.max(np.abs(qd), axis=0)


def static_fractions(fraction: float, joints: Sequence[bool]) -> float | tuple[float, ...]:
    """Return fractions of thresholds, smaller where a term of static friction explains slow pairs.

    **Arguments**

    - `fraction`: of joints without such a term.
    - `joints`: True for each joint with one.

    **Returns** one fraction per joint, or `fraction` itself if no joint has such a term.

    >>> from jaxcslc.recordings import static_fractions
    >>> static_fractions(0.1, [True, False])
    (0.01, 0.1)
    """
    if not any(joints):
        return fraction
    # Rounded, so that 0.3 % is 0.003.
    slower = round(STATIC_FRICTION_PART * fraction, 12)
    return tuple(slower if static else fraction for static in joints)


def friction_mask(qd: Signals, thresholds: Thresholds) -> Bool[np.ndarray, "samples joints"]:
    """Mark the joint-and-sample pairs that move too fast for static friction (Section 7.2.2).

    **Arguments**

    - `qd`: velocities, shape `(samples, joints)` [rad/s or m/s].
    - `thresholds`: one for each joint, shape `(joints,)`, or one for all [rad/s or m/s].

    **Returns** True where `|qd| > threshold`, shape `(samples, joints)`. A joint that does not move
    never slides, whatever its threshold.

    **Raises** `ValueError`: a threshold that is negative or no number, or a wrong number of them.

    >>> import numpy as np
    >>> from jaxcslc.recordings import friction_mask
    >>> friction_mask(np.array([[0.5, -0.01], [0.0, 0.3]]), [0.1, 0.1]).tolist()
    [[True, False], [False, True]]
    """
    limits = np.asarray(thresholds, dtype=np.float64)
    joints = qd.shape[1]
    if limits.shape not in ((), (joints,)):
        raise ValueError(
            f"friction thresholds have shape {limits.shape}; expected one number, "
            f"or one for each of the {joints} joints"
        )
    if not np.all(limits >= 0.0):
        raise ValueError(f"friction thresholds are {limits.tolist()}; expected none below 0")
    return np.abs(qd) > limits


def away_from_reversals(qd: Signals, margin: int) -> Bool[np.ndarray, "samples joints"]:
    """Mark the joint-and-sample pairs further than a margin from every velocity reversal.

    Smoothing spreads the jump that friction puts into an acceleration over about its own
    width, further than a velocity threshold reaches where a joint turns quickly.

    **Arguments**

    - `qd`: velocities, shape `(samples, joints)`.
    - `margin`: how many samples on either side of a reversal are excluded; 0 excludes none.

    **Returns**

    False for the samples around each change of sign, shape `(samples, joints)`. Zero
    velocities between two signs belong to the reversal; standing still between two motions the
    same way is none.

    **Raises** `ValueError`: a negative margin.

    >>> import numpy as np
    >>> from jaxcslc.recordings import away_from_reversals
    >>> qd = np.array([3.0, 2.0, 1.0, 0.0, -1.0, -2.0, -3.0])[:, None]
    >>> away_from_reversals(qd, 2)[:, 0].tolist()
    [True, False, False, False, False, False, True]
    """
    if margin < 0:
        raise ValueError(f"reversal margin is {margin} samples; expected 0 or more")
    away = np.ones(qd.shape, dtype=bool)
    if margin == 0:
        return away
    for joint, velocity in enumerate(qd.T):
        moving = np.flatnonzero(velocity)
        turns = np.flatnonzero(np.diff(np.sign(velocity[moving])))
        for last, first in zip(moving[turns], moving[turns + 1], strict=True):
            away[max(last - margin + 1, 0) : first + margin, joint] = False
    return away


# Of the greatest speed: what is slower is at rest, and determines nothing. It is the least speed
# that static friction is fitted from.
_SLOWEST = 0.003
# Seconds that a rest lasts at least. A joint that turns back leaves a step sooner; one that creeps
# past the finest of encoders shows its direction within it (a KUKA KR300's joints, filtered to
# 1e-6 rad: in two samples nine in ten of what stayed within that had the direction of the motion
# after, and errors of joint 1 were twice as large by the mean of both).
_REST = 0.1
# A position that stays within so many steps, or standard deviations of its noise, does not move: it
# may be next to the edge between two counts, and normal noise has a range of five in most of a
# hundred samples.
_STEPS, _DEVIATIONS = 1.5, 5.0


def resting_range(position: Signals) -> Float[np.ndarray, " joints"]:
    """Return the range that readings of a joint at rest stay in, of steps and noise [rad or m].

    >>> import numpy as np
    >>> from jaxcslc.recordings import resting_range
    >>> position = 1e-3 * np.round(1e3 * np.sin(np.linspace(0.0, 3.0, 1000)))[:, None]
    >>> bool(0.0015 <= resting_range(position)[0] < 0.002)
    True
    """
    return np.maximum(_STEPS * encoder_resolution(position), _DEVIATIONS * noise_level(position))


def without_motion_at_rest(
    time: Samples,
    position: Signals,
    qd: Signals,
    ranges: Float[np.ndarray, " joints"] | None = None,
) -> Signals:
    """Return velocities that are zero where the encoder cannot tell that a joint moves.

    A joint is at rest while its position stays within a step of its encoder, or within its noise,
    for 0.1 s at least, and as long as the slowest motion that counts (0.3 % of its greatest speed)
    needs to leave it: however many samples that are. Smoothing leaves a velocity of noise there,
    whose sign is no direction of friction.

    **Arguments**

    - `time`: instants of the samples, shape `(samples,)` [s].
    - `position`: as recorded, shape `(samples, joints)` [rad or m].
    - `qd`: smoothed velocities, shape `(samples, joints)` [rad/s or m/s].
    - `ranges`: of `resting_range`, if they are known already.

    >>> import numpy as np
    >>> from jaxcslc.recordings import without_motion_at_rest
    >>> time = np.arange(100) * 0.01
    >>> moves = np.where(time < 0.5, time - 0.5, 0.0)
    >>> position = 1e-3 * np.round(moves / 1e-3 + 0.1 * np.sin(70 * time))
    >>> noisy = np.gradient(position, time)
    >>> at_rest = without_motion_at_rest(time, position[:, None], noisy[:, None])[:, 0] == 0.0
    >>> int(at_rest[:50].sum()), int(at_rest[51:].sum())
    (0, 49)
    """
    interval = float(np.median(np.diff(time)))
    ranges = resting_range(position) if ranges is None else ranges
    moved = np.array(qd)
    for joint, (values, extent) in enumerate(zip(position.T, ranges.tolist(), strict=True)):
        slowest = _SLOWEST * float(np.max(np.abs(qd[:, joint])))
        if slowest > 0.0 and extent > 0.0:
            length = max(int(np.ceil(max(extent / slowest, _REST) / interval)) + 1, 2)
            moved[_within(values, extent, min(length, len(values))), joint] = 0.0
    return moved


def _within(values: Samples, extent: float, length: int) -> Bool[np.ndarray, " samples"]:
    """Mark every sample of each stretch of a length within which values stay in an extent."""
    highest, lowest = (_running(values, length, of_two) for of_two in (np.maximum, np.minimum))
    starts = np.flatnonzero(highest - lowest <= extent)
    ends = np.zeros(len(values) + 1, int)
    np.add.at(ends, starts, 1)
    np.add.at(ends, starts + length, -1)
    return np.cumsum(ends[:-1]) > 0


def _running(values: np.ndarray, length: int, of_two: Callable[..., np.ndarray]) -> np.ndarray:
    """The largest, or smallest, value of each stretch of a length: of halves, again and again."""
    span = 1
    while 2 * span <= length:
        values = of_two(values[:-span], values[span:])
        span *= 2
    rest = length - span
    return of_two(values[: len(values) - rest], values[rest:])


Velocities = Float[Array | np.ndarray, "samples joints"]

# A joint that is slower than this part of its greatest speed, for so many samples, is at rest.
# The creep of a position controller is there; a joint that turns back passes through in less than a
# sample.
_REST_FRACTION, _REST_SAMPLES = 1e-4, 5


def at_rest(qd: Velocities) -> Bool[Array | np.ndarray, "samples joints"]:
    """Mark the joint-and-sample pairs of joints that stand still.

    **Arguments**

    - `qd`: velocities in order of time, shape `(samples, joints)` [rad/s or m/s].

    **Returns** True where a joint is slower than 1e-4 of its greatest speed for five samples at
    least, and where its velocity is zero (`without_motion_at_rest`), shape `(samples, joints)`. A
    joint that never moves is not marked.

    >>> import numpy as np
    >>> from jaxcslc.recordings import at_rest
    >>> qd = np.array([1.0, 1e-6, 0.5, 0.0, 1e-6, -1e-6, 0.0, 1e-6])[:, None]
    >>> at_rest(qd)[:, 0].tolist()
    [False, False, False, True, True, True, True, True]
    """
    xp = array_namespace(qd)
    samples = qd.shape[0]
    fastest = xp.max(xp.abs(qd), axis=0, keepdims=True, initial=0.0)
    stopped = (qd == 0.0) & (fastest > 0.0)
    if samples < _REST_SAMPLES:
        return stopped
    slow = xp.abs(qd) < _REST_FRACTION * fastest
    starts = samples - _REST_SAMPLES + 1
    lasting = xp.ones((starts, qd.shape[1]), bool)
    for shift in range(_REST_SAMPLES):
        lasting = lasting & slow[shift : shift + starts]
    # Every sample of a run that is long enough, not only the first ones.
    padded = xp.pad(lasting, ((_REST_SAMPLES - 1, _REST_SAMPLES - 1), (0, 0)))
    still = xp.zeros(qd.shape, bool)
    for shift in range(_REST_SAMPLES):
        still = still | padded[shift : shift + samples]
    return still | stopped


def directions_beside(
    qd: Velocities, still: Bool[Array | np.ndarray, "samples joints"]
) -> tuple[
    Float[Array | np.ndarray, "samples joints"], Float[Array | np.ndarray, "samples joints"]
]:
    """Find the direction of each joint before it stands still, and afterwards.

    **Arguments**

    - `qd`: velocities in order of time, shape `(samples, joints)` [rad/s or m/s].
    - `still`: where joints stand still, as of `at_rest`.

    **Returns**

    The signs of the last velocity before and of the first one after, outside `still`, shape
    `(samples, joints)` each; 0 where there is none. Outside `still` both are the sign of the
    velocity itself.

    >>> import numpy as np
    >>> from jaxcslc.recordings import directions_beside
    >>> qd = np.array([0.0, -1.0, 1e-6, 1e-6, 2.0])[:, None]
    >>> before, after = directions_beside(qd, np.abs(qd) < 1e-3)
    >>> before[:, 0].tolist(), after[:, 0].tolist()
    ([0.0, -1.0, -1.0, -1.0, 1.0], [-1.0, -1.0, 1.0, 1.0, 1.0])
    """
    return _before(qd, still), _before(qd[::-1], still[::-1])[::-1]


def _before(
    qd: Velocities, still: Bool[Array | np.ndarray, "samples joints"]
) -> Float[Array | np.ndarray, "samples joints"]:
    xp = array_namespace(qd, still)
    index = xp.where(still, -1, xp.arange(qd.shape[0])[:, None])
    last = np.maximum.accumulate(index) if xp is np else jax.lax.cummax(jnp.asarray(index))
    before = xp.take_along_axis(qd, xp.maximum(last, 0), axis=0)
    return xp.where(last < 0, 0.0, xp.sign(before))
