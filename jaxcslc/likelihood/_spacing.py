"""Spacing of the positions that are unknown, and its reason: vibration, and noise that excites."""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float

from ..network import CSLC
from ._banded_solver import Factored, Spectrum
from ._equation_sums import JointColumns
from ._objective import Linear
from ._problem import LikelihoodProblem
from ._search import Minimum


# A standard error that smooth motion would make larger by more than this factor.
_GREATEST_RATIO = 1.5
# Spacings that noise may ask for, and how many positions remain at least.
_SPACINGS, _FEWEST_POSITIONS = (2, 3, 6, 12), 50
# Positions with more than so many times the noise of readings move as rigid links do not; they are
# then unknown at every so many samples. (docs/likelihood.md, "Compliant gears and backlash", has
# errors with 1, 2, 3 and 6 on four arms.)
_EXCESS, _OF_VIBRATION = 1.3, 3


@dataclasses.dataclass(frozen=True)
class NoiseExcitation:
    """Part of a fit's information on coefficients that comes from noise of accelerations.

    The estimated motion contains noise: of accelerations, that of readings over the square of the
    time between positions. Columns of the regressor at that motion vary with it, which the normal
    equations take for excitation. Where the motion itself barely tells two coefficients apart, as
    a single sine cannot tell an inertia from gravity's spring, the fit follows the noise, and its
    standard errors are too small. At the smoothed motion columns do without: what they make of
    standard errors, over what the fit reports, is 1 where motion excites and 10 and more where
    noise does.

    **Attributes**

    - `every`: positions were unknown at every so many samples.
    - `ratio`: of standard errors, the greatest of all of rigid bodies; `name`: of that coefficient.

    >>> from jaxcslc.likelihood import NoiseExcitation
    >>> noise = NoiseExcitation(1, 11.2, "kB1")
    >>> noise.excessive, noise.line
    (True, 'every 1: noise of accelerations makes the standard error of kB1 11.2 times too small')
    """

    every: int
    ratio: float
    name: str

    @classmethod
    def of(
        cls,
        network: CSLC,
        minimum: Minimum,
        smooth: Float[np.ndarray, "samples joints"],
        every: int,
    ) -> "NoiseExcitation":
        """Judge the end of a search.

        **Arguments**

        - `smooth`: positions at the search's samples, smoothed [rad or m].
        """
        linear, inertial = minimum.linear, network.layout.inertial
        there = Linear.of(minimum.objective, dataclasses.replace(minimum.point, q=smooth))
        # Friction has no accelerations, and slow reversals, which smoothing takes out, excite it.
        columns = linear.motion.by_border.dense
        columns[:, :, inertial] = there.motion.by_border.dense[:, :, inertial]
        motion = dataclasses.replace(linear.motion, by_border=JointColumns.of(columns))
        smoother = linear.with_motion(motion)
        at_smooth_motion = smoother.factored(0.0)
        errors = (_errors(factored)[inertial] for factored in (at_smooth_motion, minimum.factored))
        there_error, error = errors
        ratios = there_error / np.where(error > 0.0, error, np.inf)  # 0 for what is fixed
        worst = int(np.argmax(ratios))
        return cls(every, float(ratios[worst]), network.names[inertial][worst])

    @property
    def excessive(self) -> bool:
        """True if positions should be further apart."""
        return self.ratio > _GREATEST_RATIO

    def wider_spacing(self, samples: int) -> int | None:
        """Return the next larger spacing where noise excites; None if recordings of so many
        samples have none, and where it does not."""
        wider = [every for every in _SPACINGS if every > self.every]
        return wider[0] if self.excessive and wider and _enough(samples, wider[0]) else None

    @property
    def line(self) -> str:
        """Sentence about the excitation by noise."""
        return (
            f"every {self.every}: noise of accelerations makes the standard error of {self.name}"
            f" {self.ratio:.3g} times too small"
        )

    def document(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {"every": self.every, "ratio": self.ratio, "coefficient": self.name}


@dataclasses.dataclass(frozen=True)
class SpacingChoice:
    """Choice of the spacing of estimated positions, with its reason.

    **Attributes**

    - `every`: positions are unknown at every so many samples.
    - `excess`: by joint, noise of positions over what readings explain, with `every` 1.
    - `noisy`: spacings that were left for a larger one, since noise of accelerations excited.

    >>> from jaxcslc.likelihood import SpacingChoice
    >>> for line in SpacingChoice(3, (1.0, 1.52), ()).lines:
    ...     print(line)
    every 1: noise of positions is 1, 1.52 times what readings explain
    every 3, used: vibration averages out
    """

    every: int
    excess: tuple[float, ...]
    noisy: tuple[NoiseExcitation, ...] = ()

    @property
    def lines(self) -> tuple[str, ...]:
        """The reasons, a line each."""
        values = ", ".join(f"{value:.3g}" for value in self.excess)
        first = f"every 1{', used' * (self.every == 1)}: noise of positions is {values} times what"
        lines = [f"{first} readings explain", *(noise.line for noise in self.noisy)]
        if self.every > 1:
            reason = "motion excites" if self.noisy else "vibration averages out"
            lines.append(f"every {self.every}, used: {reason}")
        return tuple(lines)

    def document(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {
            "every": self.every,
            "excess_position_noise": list(self.excess),
            "excited_by_noise": [noise.document() for noise in self.noisy],
            "lines": list(self.lines),
        }


def excess_noise(problem: LikelihoodProblem, minimum: Minimum) -> Float[np.ndarray, " joints"]:
    """Return (n,) estimated noise of positions over that of encoders' steps, or over what readings
    without steps scatter by; the greatest of several recordings.

    Above 1, joints move as the equations of rigid links do not.
    """
    steps = problem.encoder_step > 0.0
    expected = np.where(steps, problem.least_position_noise, problem.scatter)
    return np.max(minimum.position_noise / np.maximum(expected, 1e-300), axis=0)


def spacing_for(excess: Float[np.ndarray, " joints"], samples: int) -> int:
    """Return the spacing for joints that vibrate, 1 for others and for recordings of few samples.

    >>> spacing_for(np.array([1.0, 1.2]), 1000), spacing_for(np.array([1.0, 1.5]), 1000)
    (1, 3)
    """
    vibrates = bool(excess.max() > _EXCESS)
    return _OF_VIBRATION if vibrates and _enough(samples, _OF_VIBRATION) else 1


def _enough(samples: int, every: int) -> bool:
    return samples >= _FEWEST_POSITIONS * every


def _errors(factored: Factored) -> Float[np.ndarray, " border"]:
    """Return standard errors in units of the border's scale; 0 where nothing is known."""
    return np.sqrt(np.diag(Spectrum.of(factored.information).covariance))
