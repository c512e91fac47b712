"""Torque that friction bears at rest, as a censored observation of break-away."""

import dataclasses

import numpy as np
import scipy
from jaxtyping import Bool, Float

from ._readings import WorkingReadings
from ._signs import runs


# Equations at the start and at the end of a rest that say nothing of break-away: a joint creeps
# within a step of its encoder before a reading changes.
_START, _END = 4, 16
# Torque beyond this part of break-away, at any time of a rest, is a limit's or a brake's.
_MOST = 1.5
# Standard deviations beyond which the tail of a normal density is that of a parabola.
_FAR = 30.0


@dataclasses.dataclass(frozen=True)
class Sticking:
    """Equations of joints that stick: friction is what motion needs, and at most break-away.

    The torque that friction bears is known, and no more of its coefficients than a bound: a
    censored observation (Tobin 1958). With f the torque less what motion and gravity need, b the
    friction at break-away and s the noise of torque, its probability is Φ((b - |f|) / s). Torque
    well below break-away says nothing; torque that would have moved the joint is excluded.

    **Attributes**

    - `mask`: (equations, n), which equations these are.
    - `direction`: (equations, n) sign of f, in which equations hold b.
    - `noise`: (equations, n) s [N m or N].
    """

    mask: Bool[np.ndarray, "equations joints"]
    direction: Float[np.ndarray, "equations joints"]
    noise: Float[np.ndarray, "equations joints"]

    def working(
        self,
        residual: Float[np.ndarray, "equations joints"],
        weight: Float[np.ndarray, "equations joints"],
    ) -> WorkingReadings:
        """Return values and derivatives at residuals [N m or N]; `weight` of all other
        equations."""
        value, result, working = weight * residual**2, weight.copy(), residual.copy()
        rows, noise = self.mask, self.noise[self.mask]
        of_bound = bound(self.direction[rows] * residual[rows] / noise)
        value[rows] = of_bound.value
        result[rows] = of_bound.weight / noise**2
        working[rows] = self.direction[rows] * of_bound.residual * noise
        return WorkingReadings(value, result, working)


def bound(excess: Float[np.ndarray, " rows"]) -> WorkingReadings:
    """Return the law of quantities that are at most zero, in standard deviations.

    >>> import numpy as np
    >>> bound(np.array([-5.0, 0.0, 5.0])).value.round(2).tolist()
    [0.0, 1.39, 30.13]
    """
    near = np.clip(excess, -_FAR, _FAR)
    log_probability = scipy.special.log_ndtr(-near)
    score = np.exp(-0.5 * near**2 - 0.5 * np.log(2.0 * np.pi) - log_probability)
    curvature = np.maximum(score * (score - near), 1e-12)
    score, curvature = (
        np.where(excess > _FAR, excess, score),
        np.where(excess > _FAR, 1.0, curvature),
    )
    beyond = np.maximum(excess, _FAR) ** 2 - _FAR**2
    return WorkingReadings(beyond - 2.0 * log_probability, curvature, score / curvature)


def sticking_equations(
    at_rest: Bool[np.ndarray, "equations joints"],
    friction: Float[np.ndarray, "equations joints"],
    breakaway: Float[np.ndarray, " joints"],
) -> Bool[np.ndarray, "equations joints"]:
    """Return those that break-away bounds: amid a rest that nothing but friction holds.

    **Arguments**

    - `at_rest`: equations of joints at standstill.
    - `friction`: torque less what motion and gravity need [N m or N].
    - `breakaway`: (n,) at present [N m or N].
    """
    result = np.zeros_like(at_rest)
    for joint in range(at_rest.shape[1]):
        for start, end in runs(at_rest[:, joint]):
            rows = slice(start + _START, max(end - _END, start + _START))
            size = np.abs(friction[rows, joint])
            result[rows, joint] = size.size > 0 and size.max() <= _MOST * breakaway[joint]
    return result
