"""Patterns: the prepared motion, torque and masks from which coefficients are fitted."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float


class Patterns(eqx.Module):
    """Motion, torque and masks that a fit uses of a recording.

    A disturbance of one joint leaves the equations of the others whole (thesis, Section 7.2.4),
    so the masks belong to pairs of a joint and a sample, never to whole samples.

    **Attributes**

    - `time`: instants of the samples, shape `(samples,)` [s].
    - `q`, `qd`, `qdd`: positions, velocities and accelerations, shape `(samples, motion)`
        [rad, rad/s, rad/s² or m, m/s, m/s²]; of a robot, a column a joint. Other systems
        (`jaxcslc.systems`) may have more or fewer columns of motion than equations.
    - `torque`: the torques that drove that motion, shape `(samples, joints)` [N m or N].
    - `backlash_mask`: True where the joint is not possibly in backlash (Eqn 2.5-7), shape
        `(samples, joints)`.
    - `friction_mask`: True where the joint moves faster than its static friction threshold
        (Section 7.2.2), shape `(samples, joints)`.

    >>> import numpy as np
    >>> from jaxcslc.recordings import Patterns
    >>> motion = np.ones((3, 2))
    >>> friction_mask = np.array([[True, False], [True, True], [False, True]])
    >>> patterns = Patterns(
    ...     np.arange(3.0), motion, motion, motion, motion, np.ones((3, 2), bool), friction_mask
    ... )
    >>> int(patterns.mask.sum())
    4
    """

    time: Float[np.ndarray | jax.Array, " samples"]
    q: Float[np.ndarray | jax.Array, "samples motion"]
    qd: Float[np.ndarray | jax.Array, "samples motion"]
    qdd: Float[np.ndarray | jax.Array, "samples motion"]
    torque: Float[np.ndarray | jax.Array, "samples joints"]
    backlash_mask: Bool[np.ndarray | jax.Array, "samples joints"]
    friction_mask: Bool[np.ndarray | jax.Array, "samples joints"]

    @property
    def mask(self) -> Bool[np.ndarray | jax.Array, "samples joints"]:
        """The pairs that take part in a fit: those of both masks, shape `(samples, joints)`."""
        return self.backlash_mask & self.friction_mask

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.q.shape[0]

    @property
    def joints(self) -> int:
        """Number of joints: columns of torque."""
        return self.torque.shape[1]

    def between(self, start: float, end: float) -> "Patterns":
        """The patterns of a stretch of time, as for a fit on one part and a test on another.

        **Arguments**

        - `start`, `end`: the stretch, its start included and its end not [s].

        **Returns**

        The patterns with `start <= time < end`. There may be none.
        """
        time = np.asarray(self.time)
        inside = (time >= start) & (time < end)
        return jax.tree_util.tree_map(lambda values: values[inside], self)


def joined_patterns(parts: Sequence[Patterns]) -> Patterns:
    """Patterns of several recordings, one after the other.

    **Arguments**

    - `parts`: of the same columns each.

    **Returns**

    The patterns; time goes on at the end of a part, after the part's mean interval.

    >>> import numpy as np
    >>> from jaxcslc.recordings import Patterns, joined_patterns
    >>> motion, pairs = np.ones((3, 1)), np.ones((3, 1), bool)
    >>> part = Patterns(np.arange(3.0), motion, motion, motion, motion, pairs, pairs)
    >>> joined_patterns([part, part]).time.tolist()
    [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    """
    moved: list[Patterns] = []
    start: float | None = None
    for part in parts:
        time = np.asarray(part.time)
        time = time if start is None else time - time[0] + start
        moved.append(dataclasses.replace(part, time=time))
        start = float(time[-1] + np.mean(np.diff(time)))
    return jax.tree_util.tree_map(lambda *values: np.concatenate(values), *moved)


def check_some_left(patterns: Patterns) -> None:
    """Check that masks leave some pair of a joint and a sample.

    **Raises**

    - `ValueError`: naming the joints and the mask that leaves nothing of them.
    """
    if np.any(patterns.mask):
        return
    masks = {
        "none is above the friction threshold": patterns.friction_mask,
        "all may be in backlash": patterns.backlash_mask,
    }
    reasons = "; ".join(
        f"{reason} at joint {_numbers(~np.any(mask, axis=0))}"
        for reason, mask in masks.items()
        if not np.all(np.any(mask, axis=0))
    )
    raise ValueError(
        f"masking leaves nothing of {patterns.samples} samples of {patterns.joints} joints"
        + (f" ({reasons})" if reasons else "")
        + "; expected some pair of joint and sample above its threshold and out of backlash"
    )


def _numbers(which: Bool[np.ndarray, " joints"]) -> str:
    return ", ".join(str(joint + 1) for joint in np.flatnonzero(which))
