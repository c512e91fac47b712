import dataclasses
from collections.abc import Sequence
from typing import Literal

import numpy as np

from ..motion import (
    AbstractSmoothing,
    AveragedSplines,
    Butterworth,
    Patterns,
    Recording,
    SavitzkyGolay,
    TorqueAlignment,
    prepare,
)
from ..network import CSLC
from ._reidentification import reidentify
from .solver import ERRORS, LOSSES, Errors, Identification, LeastSquares, Loss, Previous


@dataclasses.dataclass(frozen=True)
class Settings:
    """Everything that stands between a recording and its coefficients, in one place.

    The defaults do for a first look; `choose_settings` finds better ones from the recording. What
    they mean is said where they are used, in `jaxcslc.motion.prepare` and in `LeastSquares`.

    **Attributes**

    - `smoothing`: how positions are smoothed and differentiated (thesis, Section 7.3).
    - `torque_alignment`: which torque belongs to a sample (7.4).
    - `torque_lag`: how much later than the positions the torques were measured, as by sensors
      behind a filter of their own [s]. The torque of a sample is read so much later in the
      recording, by linear interpolation.
    - `threshold_fraction`: of each joint's greatest speed, below which static friction is taken
      to matter (7.2.2).
    - `thresholds`: speeds below which it is taken to matter, one for each joint [rad/s or m/s], in
      place of `threshold_fraction`; or None. See `refine_thresholds`.
    - `backlash`: leave out pairs that may be in backlash (Eqn. 2.5-7).
    - `cutoff`: filter regressor and torque alike at this frequency and decimate [Hz]; or None.
    - `joint_weights`: `"equal"` or `"residual"`.
    - `loss`: `"squared"`, or, if some of the recording may be wrong, `"huber"` or `"bisquare"`.
    - `errors`: what standard errors allow for, `"correlated"` or only `"independent"` noise.
    - `trim`: samples to drop at both ends; by default as far as the smoothing sees one side only.

    **Raises**

    - `ValueError`: numbers that make no sense.

    >>> import numpy as np, jaxcslc as jc
    >>> print(jc.Settings(cutoff=15.0))
    averaged splines of 9 samples, torque of 'sample', thresholds 3 % of top speed, filtered \
alike at 15 Hz, joints weighted by residual
    >>> time = np.arange(400) * 0.01
    >>> recording = jc.Recording(time, np.sin(time)[:, None], np.cos(time)[:, None])
    >>> jc.Settings(trim=10).patterns(recording).samples
    380
    """

    smoothing: AbstractSmoothing = dataclasses.field(default_factory=AveragedSplines)
    torque_alignment: TorqueAlignment = "sample"
    torque_lag: float = 0.0
    threshold_fraction: float = 0.03
    backlash: bool = False
    cutoff: float | None = None
    joint_weights: Literal["equal", "residual"] = "residual"
    trim: int | None = None
    thresholds: tuple[float, ...] | None = None
    loss: Loss = "squared"
    errors: Errors = "correlated"

    def __post_init__(self) -> None:
        if self.torque_alignment not in ("sample", "previous", "mean"):
            raise ValueError(
                f"torque alignment is {self.torque_alignment!r}; expected 'sample', 'previous' or"
                " 'mean'"
            )
        if self.joint_weights not in ("equal", "residual"):
            raise ValueError(
                f"joint weights are {self.joint_weights!r}; expected 'equal' or 'residual'"
            )
        if self.loss not in LOSSES:
            raise ValueError(f"loss is {self.loss!r}; expected {', '.join(map(repr, LOSSES))}")
        if self.errors not in ERRORS:
            raise ValueError(
                f"errors are {self.errors!r}; expected {' or '.join(map(repr, ERRORS))}"
            )
        if not np.isfinite(self.torque_lag):
            raise ValueError(f"torque lag is {self.torque_lag} s; expected a finite number")
        if not 0.0 <= self.threshold_fraction < 1.0:
            raise ValueError(
                f"threshold fraction is {self.threshold_fraction}; expected at least 0 and below 1"
            )
        if self.thresholds is not None:
            object.__setattr__(self, "thresholds", tuple(float(v) for v in self.thresholds))
            if not all(0.0 <= threshold < np.inf for threshold in self.thresholds):
                raise ValueError(
                    f"thresholds are {list(self.thresholds)}; expected finite numbers, none below 0"
                )
        if self.cutoff is not None and not 0.0 < self.cutoff < np.inf:
            raise ValueError(f"cut-off is {self.cutoff} Hz; expected more than 0, or None")

    def patterns(self, recording: Recording) -> Patterns:
        """What a fit sees of a recording under these settings.

        **Raises** as `jaxcslc.motion.prepare`.
        """
        torque = recording.torque
        if self.torque_lag:
            at = recording.time + self.torque_lag
            torque = np.stack([np.interp(at, recording.time, x) for x in torque.T], axis=1)
        return prepare(
            Recording(recording.time, recording.position, torque),
            smoothing=self.smoothing,
            torque_alignment=self.torque_alignment,
            thresholds=self.thresholds,
            threshold_fraction=self.threshold_fraction,
            backlash=self.backlash,
            trim=self.trimmed(recording),
        )

    def fit(self, network: CSLC, patterns: Patterns) -> Identification:
        """The direct solve under these settings.

        **Raises** as `LeastSquares.fit`.
        """
        return self.solver.fit(network, patterns)

    def reidentify(
        self, network: CSLC, patterns: Patterns, previous: Previous, groups: Sequence[str]
    ) -> Identification:
        """A part of the coefficients under these settings.

        **Raises** as `reidentify`.
        """
        return reidentify(network, patterns, previous, groups=groups, solver=self.solver)

    @property
    def solver(self) -> LeastSquares:
        """The solver with these options."""
        return LeastSquares(
            joint_weights=self.joint_weights, loss=self.loss, errors=self.errors, cutoff=self.cutoff
        )

    def trimmed(self, recording: Recording) -> int:
        """How many samples `patterns` drops at both ends of a recording."""
        if self.trim is not None:
            return self.trim
        interval = float(np.median(np.diff(recording.time)))
        match self.smoothing:
            case AveragedSplines():
                seen = max(self.smoothing.spacings(recording.joints))
            case Butterworth(cutoff=cutoff):
                seen = int(np.ceil(0.5 / (cutoff * interval)))
            case SavitzkyGolay(window=window):
                seen = window // 2
            case _:
                seen = 0
        # Beyond the ends there is no torque to read.
        return max(seen, int(np.ceil(abs(self.torque_lag) / interval)))

    def __str__(self) -> str:
        match self.smoothing:
            case AveragedSplines(spacing=spacing):
                smoothing = f"averaged splines of {spacing} samples"
            case Butterworth(cutoff=cutoff):
                smoothing = f"Butterworth at {cutoff:g} Hz"
            case SavitzkyGolay(window=window, order=order):
                smoothing = f"Savitzky-Golay of {window} samples and order {order}"
            case _:
                smoothing = repr(self.smoothing)
        if self.thresholds is None:
            thresholds = f"thresholds {100 * self.threshold_fraction:g} % of top speed"
        else:
            listed = ", ".join(f"{threshold:.3g}" for threshold in self.thresholds)
            thresholds = f"thresholds {listed}"
        parts = [
            smoothing,
            f"torque of {self.torque_alignment!r}",
            f"torque lag {1e3 * self.torque_lag:g} ms" if self.torque_lag else "",
            thresholds,
            "backlash left out" if self.backlash else "",
            "" if self.cutoff is None else f"filtered alike at {self.cutoff:g} Hz",
            f"joints weighted {'equally' if self.joint_weights == 'equal' else 'by residual'}",
            "" if self.loss == "squared" else f"loss of {self.loss!r}",
        ]
        return ", ".join(part for part in parts if part)
