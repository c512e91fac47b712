"""Methods that identify static friction from a training recording."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc.recordings import choose_spacing
from scripts.studies.static_friction.windows import fit_windows, motion_windows


CUTOFF = 15.0  # Hz
SLOWEST = 5e-3  # rad/s, of smoothed motion; slower joints may be at rest
_MARGIN = 2  # samples on either side of a reversal
_LENGTH = 100  # samples of a window, at most
# Windows start from static friction of a tenth of dry friction, gone to exp(-3) at a tenth of the
# greatest speed.
_START = 0.1
METHODS = ("masked", "all pairs", "moving pairs", "away from reversals", "windows")

_SELECTIONS: dict[str, dict[str, Any]] = {
    "all pairs": {"thresholds": 0.0},
    "moving pairs": {"thresholds": SLOWEST},
    "away from reversals": {"thresholds": SLOWEST, "reversal_margin": _MARGIN},
}


class Model(NamedTuple):
    """A network with identified coefficients, and its static friction with standard errors.

    `converged`: whether the fit has found a minimum.
    """

    network: jc.CSLC
    k: Float[np.ndarray, " coefficients"]
    magnitude: Float[np.ndarray, " joints"] | None = None
    magnitude_error: Float[np.ndarray, " joints"] | None = None
    slope: Float[np.ndarray, " joints"] | None = None
    slope_error: Float[np.ndarray, " joints"] | None = None
    converged: bool = True


class Identifier:
    """Identifies a robot with and without static friction, all recordings alike.

    **Attributes**

    - `spacing`: of averaged splines; selected on the first recording, if it is None.
    """

    def __init__(
        self,
        robot: jc.Manipulator,
        resolution: Float[np.ndarray, " joints"],
        spacing: tuple[int, ...] | None = None,
    ) -> None:
        self.without_static = jc.derive(robot)
        self.network = jc.derive(robot.with_friction("viscous", "dry", "static"))
        self._resolution = resolution
        self.spacing = spacing

    def models(self, recording: jc.Recording, methods: Sequence[str]) -> dict[str, Model]:
        """The model that each method identifies from a training recording."""
        if self.spacing is None:
            self.spacing = choose_spacing(
                recording.time, recording.position, resolution=self._resolution
            )
        splines = jc.AveragedSplines(self.spacing)
        trim = max(self.spacing)

        def prepared(**options: Any) -> jc.Patterns:
            return jc.prepare(
                recording, smoothing=splines, torque_alignment="mean", trim=trim, **options
            )

        solver = jc.LeastSquares(joint_weights="residual", errors="independent", cutoff=CUTOFF)
        masked = solver.fit(self.without_static, prepared(threshold_fraction=0.01))
        models: dict[str, Model] = {}
        for method in methods:
            if method == "masked":
                models[method] = Model(self.without_static, np.asarray(masked.k))
            elif method == "windows":
                models[method] = self._windows(recording, splines, trim, np.asarray(masked.k))
            else:
                models[method] = self._slopes(prepared(**_SELECTIONS[method]))
        return models

    def _slopes(self, patterns: jc.Patterns) -> Model:
        fit = jc.fit_slopes(self.network, patterns)
        slopes = np.asarray(fit.slopes), np.asarray(fit.slope_error)
        # Joints whose slope is not determined have no static friction left.
        magnitude, error = np.zeros(slopes[0].size), np.full(slopes[0].size, np.inf)
        joints = np.setdiff1d(np.arange(magnitude.size), np.array(fit.dropped, int) - 1)
        if joints.size:
            static = fit.network.layout.term_slice("static")
            magnitude[joints] = fit.fit.k[static]
            error[joints] = fit.fit.standard_error[static]
        static_friction = magnitude, error, *slopes
        return Model(fit.network, np.asarray(fit.fit.k), *static_friction, bool(fit.converged))

    def _windows(
        self,
        recording: jc.Recording,
        splines: jc.AveragedSplines,
        trim: int,
        masked: Float[np.ndarray, " coefficients"],
    ) -> Model:
        q, qd, _ = splines.smooth(recording.time, recording.position)
        windows = motion_windows(qd, length=_LENGTH, slowest=SLOWEST, trim=trim)
        dry = masked[self.without_static.layout.term_slice("dry")]
        start = self.network.with_static_slopes(3.0 / (_START * np.max(np.abs(qd), axis=0)))
        fit = fit_windows(
            start, np.concatenate([masked, _START * np.abs(dry)]), recording, windows, (q, qd)
        )
        static = self.network.layout.term_slice("static")
        network = self.network.with_static_slopes(fit.slopes)
        static_friction = fit.k[static], fit.error[static], fit.slopes, fit.slope_error
        return Model(network, fit.k, *static_friction, fit.converged)
