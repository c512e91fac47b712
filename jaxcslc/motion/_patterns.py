import dataclasses

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float

from ._alignment import TorqueAlignment, align_torque
from ._masks import (
    Thresholds,
    away_from_reversals,
    friction_mask,
    friction_thresholds,
    possible_backlash,
)
from ._recording import Recording
from ._smoothing import AbstractSmoothing, without_rounding
from ._splines import AveragedSplines


class Patterns(eqx.Module):
    """What a fit sees of a recording: motion, torque, and which joint-and-sample pairs count.

    A disturbance of one joint leaves the equations of the others whole (thesis, Section 7.2.4),
    so the masks belong to pairs of a joint and a sample, never to whole samples.

    **Attributes:**

    - `time`: instants of the samples, shape `(samples,)` [s].
    - `q`, `qd`, `qdd`: positions, velocities and accelerations, shape `(samples, joints)`
        [rad, rad/s, rad/s² or m, m/s, m/s²].
    - `torque`: the torques that drove that motion, shape `(samples, joints)` [N m or N].
    - `backlash_mask`: True where the joint is not possibly in backlash (Eqn 2.5-7), shape
        `(samples, joints)`.
    - `friction_mask`: True where the joint moves faster than its static friction threshold
        (Section 7.2.2), shape `(samples, joints)`.

    ```python
    >>> import numpy as np
    >>> from jaxcslc.motion import Patterns
    >>> motion = np.ones((3, 2))
    >>> friction_mask = np.array([[True, False], [True, True], [False, True]])
    >>> patterns = Patterns(
    ...     np.arange(3.0), motion, motion, motion, motion, np.ones((3, 2), bool), friction_mask
    ... )
    >>> int(patterns.mask.sum())
    4

    ```
    """

    time: Float[np.ndarray | jax.Array, " samples"]
    q: Float[np.ndarray | jax.Array, "samples joints"]
    qd: Float[np.ndarray | jax.Array, "samples joints"]
    qdd: Float[np.ndarray | jax.Array, "samples joints"]
    torque: Float[np.ndarray | jax.Array, "samples joints"]
    backlash_mask: Bool[np.ndarray | jax.Array, "samples joints"]
    friction_mask: Bool[np.ndarray | jax.Array, "samples joints"]

    @property
    def mask(self) -> Bool[np.ndarray | jax.Array, "samples joints"]:
        """The pairs that take part in a fit: those of both masks, shape `(samples, joints)`."""
        return self.backlash_mask & self.friction_mask

    @property
    def samples(self) -> int:
        """How many samples there are."""
        return self.q.shape[0]

    @property
    def joints(self) -> int:
        """How many joints there are."""
        return self.q.shape[1]

    def between(self, start: float, end: float) -> "Patterns":
        """The patterns of a stretch of time, as for a fit on one part and a test on another.

        **Arguments:**

        - `start`, `end`: the stretch, its start included and its end not [s].

        **Returns:**

        The patterns with `start <= time < end`. There may be none.
        """
        time = np.asarray(self.time)
        chosen = (time >= start) & (time < end)
        return jax.tree_util.tree_map(lambda values: values[chosen], self)


def prepare(
    recording: Recording,
    *,
    spacing: int | tuple[int, ...] = 9,
    smoothing: AbstractSmoothing | None = None,
    torque_alignment: TorqueAlignment = "sample",
    smooth_torque: bool = False,
    thresholds: Thresholds | None = None,
    threshold_fraction: float = 0.01,
    backlash: bool = False,
    reversal_margin: int = 0,
    trim: int | None = None,
) -> Patterns:
    """Turns a recording of positions and torques into patterns for a fit.

    **Arguments:**

    - `recording`: positions and torques; its velocities and accelerations, if any, are not
        used. See `as_recorded` for those.
    - `spacing`: of the averaged splines that smooth the positions, in samples (Section 7.3);
        one for all joints or one for each. A larger one smooths more: the splines pass motion
        up to about 1 / (2 spacing interval) Hz, 28 Hz for 9 at 2 ms.
    - `smoothing`: another way to smooth and differentiate, in place of `spacing`.
    - `torque_alignment`: which torque belongs to a sample, `"sample"`, `"previous"` or
        `"mean"`; see `align_torque`.
    - `smooth_torque`: smooth the aligned torque by the filter that the positions went through.
    - `thresholds`: velocities below which static friction matters, shape `(joints,)` or one for
        all [rad/s or m/s].
    - `threshold_fraction`: without `thresholds`, they are this fraction of each joint's greatest
        speed (one hundredth in Section 7.5).
    - `backlash`: leave out the pairs that may be in backlash (Eqn 2.5-7). For transmissions
        that have it: it costs up to half of the pairs.
    - `reversal_margin`: how many samples on either side of each velocity reversal of a joint
        to leave out of that joint's pairs, beyond its threshold.
    - `trim`: how many samples to drop at both ends, where every smoothing sees one side only.
        By default as many as the widest spline's spacing, or none with a `smoothing` of
        one's own.

    **Returns:**

    The patterns. Their `friction_mask` is False within `reversal_margin` too.

    **Raises:**

    - `ValueError`: settings that make no sense, or a selection that leaves nothing. Joints of
        which nothing is left are named; a joint alone without a pair is an error as well only
        when no other joint has one, since its coefficients may show in the others' torques.

    ```python
    >>> import numpy as np
    >>> from jaxcslc.motion import prepare, Recording
    >>> time = np.arange(500) * 0.002
    >>> position = np.sin(2 * np.pi * time)[:, None].round(4)
    >>> patterns = prepare(Recording(time, position, np.cos(time)[:, None]), spacing=9)
    >>> patterns.samples
    482
    >>> error = patterns.qd[:, 0] - 2 * np.pi * np.cos(2 * np.pi * patterns.time)
    >>> bool(np.max(np.abs(error)) < 0.01)
    True

    ```
    """
    if smoothing is None:
        smoothing = AveragedSplines(spacing)
        trim = max(smoothing.spacings(recording.joints)) if trim is None else trim
    derivatives = smoothing.smooth(recording.time, recording.position)
    q, qd, qdd = without_rounding(recording.position, derivatives)
    torque = align_torque(recording.torque, torque_alignment)
    if smooth_torque:
        torque = smoothing.low_pass(recording.time, torque)
    return _masked(
        Motion(recording.time, q, qd, qdd, torque),
        thresholds=thresholds,
        threshold_fraction=threshold_fraction,
        backlash=backlash,
        reversal_margin=reversal_margin,
        trim=0 if trim is None else trim,
    )


def as_recorded(
    recording: Recording,
    *,
    torque_alignment: TorqueAlignment = "sample",
    thresholds: Thresholds | None = None,
    threshold_fraction: float = 0.01,
    backlash: bool = False,
    reversal_margin: int = 0,
    trim: int = 0,
) -> Patterns:
    """Takes velocities and accelerations from the recording itself.

    For simulated truth, and for machines that measure them.

    **Arguments:**

    - `recording`: with velocity and acceleration.
    - the others: as for `prepare`.

    **Returns:**

    The patterns.

    **Raises:**

    - `ValueError`: a recording without velocity or acceleration, settings that make no sense,
        or a selection that leaves nothing.

    ```python
    >>> import numpy as np
    >>> from jaxcslc.motion import as_recorded, Recording
    >>> time = np.linspace(0.0, 1.0, 50)
    >>> columns = [f(time)[:, None] for f in (np.sin, np.cos, np.cos)]
    >>> recording = Recording(time, columns[0], columns[1], columns[2], -columns[0])
    >>> bool((as_recorded(recording).qdd == -columns[0]).all())
    True

    ```
    """
    if recording.velocity is None or recording.acceleration is None:
        missing = "velocity" if recording.velocity is None else "acceleration"
        raise ValueError(f"the recording has no {missing}; expected velocity and acceleration")
    return _masked(
        Motion(
            recording.time,
            recording.position,
            recording.velocity,
            recording.acceleration,
            align_torque(recording.torque, torque_alignment),
        ),
        thresholds=thresholds,
        threshold_fraction=threshold_fraction,
        backlash=backlash,
        reversal_margin=reversal_margin,
        trim=trim,
    )


@dataclasses.dataclass(frozen=True)
class Motion:
    """Motion and torque before any of it is masked."""

    time: Float[np.ndarray, " samples"]
    q: Float[np.ndarray, "samples joints"]
    qd: Float[np.ndarray, "samples joints"]
    qdd: Float[np.ndarray, "samples joints"]
    torque: Float[np.ndarray, "samples joints"]


def _masked(
    motion: Motion,
    *,
    thresholds: Thresholds | None,
    threshold_fraction: float,
    backlash: bool,
    reversal_margin: int,
    trim: int,
) -> Patterns:
    samples = motion.time.size
    if not 0 <= trim < samples / 2:
        raise ValueError(
            f"trim of {trim} samples at both ends leaves nothing of {samples} samples; "
            f"expected from 0 to {(samples - 1) // 2}"
        )
    kept = slice(trim, samples - trim)
    q, qd, qdd = motion.q[kept], motion.qd[kept], motion.qdd[kept]
    torque = motion.torque[kept]
    limits = friction_thresholds(qd, threshold_fraction) if thresholds is None else thresholds
    patterns = Patterns(
        time=motion.time[kept],
        q=q,
        qd=qd,
        qdd=qdd,
        torque=torque,
        backlash_mask=~possible_backlash(qd, qdd, torque)
        if backlash
        else np.ones(q.shape, dtype=bool),
        friction_mask=friction_mask(qd, limits) & away_from_reversals(qd, reversal_margin),
    )
    if not np.any(patterns.mask):
        masks = {
            "none is above the friction threshold": patterns.friction_mask,
            "all may be in backlash": patterns.backlash_mask,
        }
        empty = "; ".join(
            f"{reason} at joint {_listed(~np.any(mask, axis=0))}"
            for reason, mask in masks.items()
            if not np.all(np.any(mask, axis=0))
        )
        raise ValueError(
            f"masking leaves nothing of {q.shape[0]} samples of {q.shape[1]} joints"
            + (f" ({empty})" if empty else "")
            + "; expected some pair of joint and sample above its threshold and out of backlash"
        )
    return patterns


def joints_left_out(patterns: Patterns) -> tuple[int, ...]:
    """The joints of which masking leaves nothing: their own torques teach a fit nothing.

    **Arguments:**

    - `patterns`: as prepared.

    **Returns:**

    Their numbers, counted from 1; empty where every joint has some pair that counts.

    ```python
    >>> import numpy as np
    >>> from jaxcslc.motion import joints_left_out, prepare, Recording
    >>> time = np.arange(200) * 0.01
    >>> position = np.stack([np.sin(time), np.zeros(200)], axis=1)
    >>> joints_left_out(prepare(Recording(time, position, position)))
    (2,)

    ```
    """
    some = np.any(np.asarray(patterns.mask), axis=0)
    return tuple(int(joint) + 1 for joint in np.flatnonzero(~some))


def _listed(which: Bool[np.ndarray, " joints"]) -> str:
    return ", ".join(str(joint + 1) for joint in np.flatnonzero(which))
