import dataclasses
from collections.abc import Sequence
from typing import Literal

import numpy as np

from ..motion import (
    AbstractSmoothing,
    AveragedSplines,
    Patterns,
    Preparation,
    Recording,
    TorqueAlignment,
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
    averaged splines of 9 samples, velocities from positions, torque of 'sample', thresholds 3 % \
of top speed, filtered alike at 15 Hz, joints weighted by residual
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
        _ = self.preparation  # which checks its options
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
        if self.cutoff is not None and not 0.0 < self.cutoff < np.inf:
            raise ValueError(f"cut-off is {self.cutoff} Hz; expected more than 0, or None")

    def patterns(self, recording: Recording) -> Patterns:
        """What a fit sees of a recording under these settings.

        **Raises** as `jaxcslc.motion.prepare`.
        """
        return self.preparation.patterns(recording)

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
        return self.preparation.trimmed(recording)

    @property
    def preparation(self) -> Preparation:
        """The part of the settings that makes patterns of a recording."""
        names = (field.name for field in dataclasses.fields(Preparation))
        return Preparation(**{name: getattr(self, name) for name in names if hasattr(self, name)})

    def __str__(self) -> str:
        parts = [
            self.preparation.description,
            "" if self.cutoff is None else f"filtered alike at {self.cutoff:g} Hz",
            f"joints weighted {'equally' if self.joint_weights == 'equal' else 'by residual'}",
            "" if self.loss == "squared" else f"loss of {self.loss!r}",
        ]
        return ", ".join(part for part in parts if part)
