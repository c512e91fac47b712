"""Patterns: the prepared motion, torque and masks from which coefficients are fitted."""

import dataclasses
from collections.abc import Collection, Sequence
from typing import Any, Literal, TypeAlias, get_args

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import Bool, Float

from .._display import html_table
from .._text_table import counted
from ._clock import TorqueAlignment, align_torque
from ._masks import (
    STATIC_FRICTION_PART,
    away_from_reversals,
    friction_mask,
    friction_thresholds,
    possible_backlash,
    static_fractions,
    without_motion_at_rest,
)
from ._recording import Recording, Samples, Signals
from ._sampling import Sampling
from ._smoothing import AbstractSmoothing, Derivatives, without_rounding
from ._splines import AveragedSplines


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

    def __repr__(self) -> str:
        if not all(isinstance(x, np.ndarray | jax.Array) for x in vars(self).values()):
            return eqx.tree_pformat(self)
        if isinstance(self.mask, Tracer) or self.mask.ndim != 2:
            return f"Patterns(of shape {self.torque.shape})"
        return (
            f"Patterns({self.samples} samples of {counted(self.joints, 'joint')},"
            f" {100 * float(np.mean(self.mask)):.3g} % of the pairs fitted)"
        )

    def _repr_html_(self) -> str:
        """Return a table of the joints, for notebooks."""
        columns = {
            "joint": [str(i + 1) for i in range(self.joints)],
            "fitted [%]": 100 * np.mean(self.mask, axis=0),
            "not in backlash [%]": 100 * np.mean(self.backlash_mask, axis=0),
            "above the friction threshold [%]": 100 * np.mean(self.friction_mask, axis=0),
            "RMS torque [N m or N]": np.sqrt(np.mean(np.asarray(self.torque) ** 2, axis=0)),
        }
        return html_table(repr(self), columns)

    def between(self, start: float, end: float) -> "Patterns":
        """Return the patterns with `start <= time < end` [s]; there may be none."""
        time = np.asarray(self.time)
        inside = (time >= start) & (time < end)
        return jax.tree_util.tree_map(lambda values: values[inside], self)


def joined_patterns(parts: Sequence[Patterns]) -> Patterns:
    """Join patterns of several recordings of the same columns, one after the other.

    Time goes on at the end of each, after its mean interval.

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

    **Raises** `ValueError`: naming the joints and the mask that leaves nothing of them.
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


DEFAULT_THRESHOLD_FRACTION = 0.03
"""Part of each joint's greatest speed below which static friction is taken to matter."""

VelocitySource: TypeAlias = Literal["position", "recorded"]
"""Where velocities and accelerations come from; see `Preparation`."""

# Sampling intervals that differ by less change no smoothing by more than other errors do.
_SAME_SPAN = 1.1


@dataclasses.dataclass(frozen=True)
class Preparation:
    """Settings that turn a recording of positions and torques into patterns for a fit.

    The defaults suit a first look; `jaxcslc.choose_settings` finds better values by
    cross-validation.

    **Attributes**

    - `smoothing`: smooths and differentiates (thesis, Section 7.3): `AveragedSplines`,
      `Butterworth`, `SavitzkyGolay` or any other `AbstractSmoothing`.
    - `velocity`: `"position"` differentiates positions once for velocities and twice for
      accelerations; `"recorded"` smooths the recorded velocities and differentiates them once.
    - `torque_alignment`: which torque belongs to a sample, `"sample"`, `"previous"` or `"mean"`;
      see `align_torque` (Section 7.4).
    - `torque_lag`: how much later than the positions the torques were measured, as by sensors
      behind a filter of their own [s]. The torque of a sample is read so much later in the
      recording, by linear interpolation.
    - `smooth_torque`: smooth the aligned torque by the filter of the positions.
    - `threshold_fraction`: of each joint's greatest speed, below which static friction is taken
      to matter and pairs are excluded (Section 7.2.2); one for all joints or one for each. None
      stands for `DEFAULT_THRESHOLD_FRACTION`, and for a tenth of it at joints whose network has a
      term of static friction: see `with_static_friction`.
    - `thresholds`: these speeds themselves, one for all joints or one for each [rad/s or m/s], in
      place of `threshold_fraction`; or None.
    - `backlash`: exclude the pairs that may be in backlash (Eqn 2.5-7), up to half of them. For
      transmissions that have it.
    - `reversal_margin`: samples to exclude on either side of each velocity reversal of a joint.
    - `trim`: samples to drop at both ends; by default as far as the smoothing reaches or the
      torque lags.

    **Raises** `ValueError`: options that make no sense.

    >>> import numpy as np, jaxcslc as jc
    >>> preparation = jc.Preparation(jc.Butterworth(20.0), torque_alignment="mean")
    >>> print(preparation)
    Butterworth at 20 Hz, velocities from positions, torque of 'mean', masked below 3 % of top speed
    >>> time = np.arange(500) * 0.002
    >>> recording = jc.Recording(time, np.sin(time)[:, None], np.cos(time)[:, None])
    >>> preparation.patterns(recording).samples
    474
    """

    smoothing: AbstractSmoothing = dataclasses.field(default_factory=AveragedSplines)
    velocity: VelocitySource = "position"
    torque_alignment: TorqueAlignment = "sample"
    torque_lag: float = 0.0
    smooth_torque: bool = False
    threshold_fraction: float | tuple[float, ...] | None = None
    thresholds: float | int | tuple[float | int, ...] | None = None
    backlash: bool = False
    reversal_margin: int = 0
    trim: int | None = None

    def __post_init__(self) -> None:
        for name, value, kinds in (
            ("velocity", self.velocity, get_args(VelocitySource)),
            ("torque alignment", self.torque_alignment, get_args(TorqueAlignment)),
        ):
            if value not in kinds:
                raise ValueError(f"{name} is {value!r}; expected {' or '.join(map(repr, kinds))}")
        if not np.isfinite(self.torque_lag):
            raise ValueError(f"torque lag is {self.torque_lag} s; expected a finite number")
        for fraction in _listed(self.threshold_fraction):
            if not 0.0 <= fraction < 1.0:
                raise ValueError(
                    f"threshold fraction is {fraction}; expected at least 0 and below 1"
                )
        if not all(0.0 <= threshold < np.inf for threshold in _listed(self.thresholds)):
            raise ValueError(
                f"thresholds are {list(_listed(self.thresholds))}; expected finite numbers, none"
                " below 0"
            )
        if self.reversal_margin < 0:
            raise ValueError(
                f"reversal margin is {self.reversal_margin} samples; expected 0 or more"
            )

    def derivatives(
        self, recording: Recording, ranges: Float[np.ndarray, " joints"] | None = None
    ) -> Derivatives:
        """Return smoothed positions, velocities and accelerations of a recording's samples.

        Velocities are zero where a joint is at rest (`without_motion_at_rest`).

        - `ranges`: of `resting_range`, if they are known already.

        **Raises** `ValueError`: time that the smoothing cannot use, too few samples, or recorded
        velocities that are to be used and are absent.
        """
        time = recording.time
        q, qd, qdd = self.smoothing.smooth(time, recording.position)
        if self.velocity == "recorded":
            if recording.velocity is None:
                raise ValueError(
                    "the recording has no velocity; expected velocity columns, or a preparation"
                    " with velocity='position'"
                )
            qd = self.smoothing.low_pass(time, recording.velocity)
            qdd = np.gradient(qd, time, axis=0, edge_order=2)
        qd = without_motion_at_rest(time, recording.position, qd, ranges)
        return without_rounding(recording.position, (q, qd, qdd))

    def patterns(self, recording: Recording, derivatives: Derivatives | None = None) -> Patterns:
        """Compute the patterns that a fit uses of a recording.

        **Arguments**

        - `recording`: n joints, in order of time.
        - `derivatives`: positions, velocities and accelerations of all its samples, if they are
          known already; by default those of `self.derivatives`.

        **Returns** the patterns, `trimmed` samples fewer at both ends.

        **Raises** `ValueError`: as `derivatives`, or a selection that leaves nothing. Joints of
        which nothing is left are named; a joint alone without a pair is an error only when no other
        joint has one, since its coefficients may show in the others' torques.
        """
        if derivatives is None:
            derivatives = self.derivatives(recording)
        trim, samples = self.trimmed(recording), recording.samples
        if not 0 <= trim < samples / 2:
            raise ValueError(
                f"trim of {trim} samples at both ends leaves nothing of {samples} samples; "
                f"expected from 0 to {(samples - 1) // 2}"
            )
        inside = slice(trim, samples - trim)
        q, qd, qdd = (values[inside] for values in derivatives)
        torque = self.aligned(recording.time, recording.torque)[inside]
        patterns = Patterns(
            time=recording.time[inside],
            q=q,
            qd=qd,
            qdd=qdd,
            torque=torque,
            backlash_mask=~possible_backlash(qd, qdd, torque)
            if self.backlash
            else np.ones(q.shape, dtype=bool),
            friction_mask=friction_mask(qd, self.speed_thresholds(qd).tolist())
            & away_from_reversals(qd, self.reversal_margin),
        )
        check_some_left(patterns)
        return patterns

    def speed_thresholds(self, qd: Signals) -> Float[np.ndarray, " thresholds"]:
        """Return the speed of each joint below which its samples are excluded [rad/s or m/s].

        **Arguments**

        - `qd`: velocities, shape `(samples, joints)` [rad/s or m/s].

        **Raises** `ValueError`: fractions of another number of joints.

        >>> import numpy as np, jaxcslc as jc
        >>> jc.Preparation(threshold_fraction=0.1).speed_thresholds(np.array([[2.0], [-4.0]]))
        array([0.4])
        """
        if self.thresholds is None:
            return friction_thresholds(qd, self._fraction)
        listed = np.array(_listed(self.thresholds), float)
        return np.full(qd.shape[1], listed[0]) if listed.size == 1 else listed

    @property
    def _fraction(self) -> float | tuple[float, ...]:
        fraction = self.threshold_fraction
        return DEFAULT_THRESHOLD_FRACTION if fraction is None else fraction

    def trimmed(self, recording: Recording) -> int:
        """Return the number of samples that `patterns` drops at each end of a recording.

        It is `trim`, or as far as smoothing or torque lag reach.
        """
        return self.trimmed_of(recording.time, recording.joints)

    def trimmed_of(self, time: Samples, columns: int) -> int:
        """Return the number of samples dropped at each end, for columns sampled at `time`.

        >>> import numpy as np, jaxcslc as jc
        >>> jc.Preparation(jc.AveragedSplines(9)).trimmed_of(np.arange(100) * 0.01, 1)
        9
        """
        if self.trim is not None:
            return self.trim
        interval = float(np.median(np.diff(time)))
        # Beyond the ends there is no torque to read.
        lag = int(np.ceil(abs(self.torque_lag) / interval))
        return max(self.smoothing.reach(interval, columns), lag)

    def with_static_friction(self, joints: Sequence[bool]) -> "Preparation":
        """Return the preparation for a network that has terms of static friction.

        Masks of slow pairs exist because viscous and dry friction alone cannot explain them. A
        term of static friction can, and is determined by slow pairs only: by default, joints
        with such a term keep them, down to a tenth of the usual threshold, below which a joint
        may be at rest. A `threshold_fraction` or `thresholds` that were set stay.

        **Arguments**

        - `joints`: True for each joint with a term of static friction.

        >>> from jaxcslc.recordings import Preparation
        >>> Preparation().with_static_friction([True, False]).threshold_fraction
        (0.003, 0.03)
        >>> set_by_hand = Preparation(threshold_fraction=0.1)
        >>> set_by_hand.with_static_friction([True, False]).threshold_fraction
        0.1
        """
        if self.threshold_fraction is not None or self.thresholds is not None or not any(joints):
            return self
        fractions = static_fractions(DEFAULT_THRESHOLD_FRACTION, joints)
        return dataclasses.replace(self, threshold_fraction=fractions)

    def without_static_friction(self, joints: Collection[int]) -> "Preparation":
        """Return the preparation when joints, from 1, lose their term of static friction.

        They mask slow pairs by the usual threshold fraction again, if fractions are spelled out
        joint by joint as by `with_static_friction`.

        >>> from jaxcslc.recordings import Preparation
        >>> both = Preparation().with_static_friction([True, True])
        >>> both.without_static_friction([2]).threshold_fraction
        (0.003, 0.03)
        """
        if not isinstance(self.threshold_fraction, tuple):
            return self
        fractions = tuple(
            round(fraction / STATIC_FRICTION_PART, 12) if joint in joints else fraction
            for joint, fraction in enumerate(self.threshold_fraction, 1)
        )
        return dataclasses.replace(self, threshold_fraction=fractions)

    def check(self, recording: Recording, chosen_on: Sampling | None = None) -> tuple[str, ...]:
        """List the reasons against using this preparation for a recording, in sentences.

        **Arguments**

        - `recording`: to be prepared.
        - `chosen_on`: the sampling of the recording that the preparation was chosen on, if any.

        >>> import numpy as np, jaxcslc as jc
        >>> time = np.arange(1000) * 0.002
        >>> fine = jc.Recording(time, np.sin(time)[:, None], np.cos(time)[:, None])
        >>> slow = fine.rows(slice(None, None, 2))
        >>> jc.Preparation().check(slow, jc.recordings.Sampling.of(fine))
        ('sampled every 4 ms, 2 ms where the settings were chosen: averaged splines of 9 samples \
reach over 36 ms to either side instead of 18 ms',)
        """
        sampling = Sampling.of(recording)
        sentences: list[str] = []
        if self.velocity == "recorded" and recording.velocity is None:
            sentences.append("no recorded velocities, which the settings use")
        if chosen_on is None:
            return tuple(sentences)
        span, chosen_span = (
            interval * self.smoothing.reach(interval, recording.joints)
            for interval in (sampling.interval, chosen_on.interval)
        )
        if not 1.0 / _SAME_SPAN < span / max(chosen_span, 1e-300) < _SAME_SPAN:
            sentences.append(
                f"sampled every {1e3 * sampling.interval:.3g} ms,"
                f" {1e3 * chosen_on.interval:.3g} ms where the settings were chosen:"
                f" {self.smoothing.description} reach over {1e3 * span:.3g} ms to either side"
                f" instead of {1e3 * chosen_span:.3g} ms"
            )
        return (*sentences, *sampling.coarser_than(chosen_on))

    @property
    def description(self) -> str:
        """Options that matter, in words."""
        fractions, limits = _listed(self._fraction), _listed(self.thresholds)
        if limits:
            thresholds = "thresholds " + ", ".join(f"{limit:.3g}" for limit in limits)
        elif any(fractions):
            slow = ", ".join(f"{100 * part:g}" for part in fractions)
            thresholds = f"masked below {slow} % of top speed"
        else:
            thresholds = "slow samples kept"
        recorded = self.velocity == "recorded"
        source = "recorded velocities" if recorded else "velocities from positions"
        margin = self.reversal_margin
        parts = [
            self.smoothing.description,
            source,
            f"torque of {self.torque_alignment!r}",
            f"torque lag {1e3 * self.torque_lag:g} ms" if self.torque_lag else "",
            "torque smoothed with the same filter" if self.smooth_torque else "",
            thresholds,
            "possible backlash masked" if self.backlash else "",
            f"{margin} samples masked next to reversals" if margin else "",
        ]
        return ", ".join(part for part in parts if part)

    def __str__(self) -> str:
        return self.description

    def aligned(self, time: Samples, torque: Signals) -> Signals:
        """Return torques, or other inputs, of the samples' instants: lag, alignment, smoothing.

        >>> import numpy as np, jaxcslc as jc
        >>> torque = np.array([0.0, 1.0, 2.0])[:, None]
        >>> jc.Preparation(torque_alignment="mean").aligned(np.arange(3.0), torque)[:, 0].tolist()
        [0.0, 0.5, 1.5]
        """
        if self.torque_lag:
            at = time + self.torque_lag
            torque = np.stack([np.interp(at, time, x) for x in torque.T], axis=1)
        torque = align_torque(torque, self.torque_alignment)
        return self.smoothing.low_pass(time, torque) if self.smooth_torque else torque


def _listed(values: float | tuple[float, ...] | None) -> tuple[float, ...]:
    return () if values is None else tuple(np.atleast_1d(values).tolist())


def prepare(recording: Recording, **options: Any) -> Patterns:
    """Turn a recording of positions and torques into patterns for a fit.

    **Arguments**

    - `recording`: positions and torques.
    - `options`: those of `Preparation`, with the same defaults.

    **Returns** the patterns; errors are those of `Preparation` and `Preparation.patterns`.

    >>> import numpy as np, jaxcslc as jc
    >>> time = np.arange(500) * 0.002
    >>> position = np.sin(2 * np.pi * time)[:, None].round(4)
    >>> recording = jc.Recording(time, position, np.cos(time)[:, None])
    >>> patterns = jc.prepare(recording, smoothing=jc.AveragedSplines(9))
    >>> patterns.samples
    482
    >>> error = patterns.qd[:, 0] - 2 * np.pi * np.cos(2 * np.pi * patterns.time)
    >>> bool(np.max(np.abs(error)) < 0.01)
    True
    """
    return Preparation(**options).patterns(recording)
