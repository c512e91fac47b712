"""Noise levels by marginal likelihood, from draws of the present noise."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int

from ._linear import Linear
from ._normal_equations import Factored
from ._objective import Residuals


# A noise level falls to no less than this part in a step (continuation: while torque counts for
# little, the sum of squares has no other minima near).
_FALL = 0.25
Levels = Float[np.ndarray, "recordings joints"]


@dataclasses.dataclass(frozen=True)
class NoiseDraws:
    """Residuals that a fit of all unknowns leaves of noise of the present levels, one draw of each.

    Errors of readings that are intervals are uniform, and count by their scores.

    **Attributes**

    - `by_torque`, `by_position`: residuals of torque's noise alone, and of positions' alone.
    - `torque`: (equations, n) the noise of torques that was drawn, in standard deviations;
      `position`: (samples, n) that of positions.
    """

    by_torque: Residuals
    by_position: Residuals
    torque: Float[np.ndarray, "equations series"]
    position: Float[np.ndarray, "samples joints"]

    @classmethod
    def of(
        cls,
        linear: Linear,
        factored: Factored,
        part: Int[np.ndarray, " samples"],
        torque_noise: Levels,
        position_noise: Levels,
    ) -> "NoiseDraws":
        """Draw noise and fit it; `part`: number of the recording of each sample."""
        rng = np.random.default_rng(0)
        counts = linear.weights["torque"] > 0.0
        normal = np.where(counts, rng.normal(size=counts.shape), 0.0)
        noise = linear.objective.motion.equations.noise(torque_noise)
        torque = normal * noise[part[1:-1]]
        weight = linear.weights["position"]
        position = rng.normal(size=weight.shape) * position_noise[part]
        intervals = linear.objective.readings.intervals
        if intervals is not None:
            counts = intervals.edge > 0.0
            errors = rng.uniform(-0.5, 0.5, weight.shape) * intervals.step
            readings = intervals.working(np.where(counts, errors, 0.0), weight)
            position = np.where(counts, readings.weight * readings.residual / weight, position)

        drawn = [linear.zeros(torque=torque), linear.zeros(position=position)]
        steps = linear.steps(factored, drawn)
        by_torque, by_position = map(linear.after, steps, drawn)
        return cls(by_torque, by_position, normal, position)


def noise_levels(
    residuals: Residuals,
    draws: NoiseDraws,
    counted: Bool[np.ndarray, "equations joints"],
    moving: Bool[np.ndarray, "samples joints"],
    part: Int[np.ndarray, " samples"],
    torque_noise: Levels,
    position_noise: Levels,
) -> tuple[Levels, Levels]:
    """Return the levels at which residuals would be as large as they are.

    The squares of what is left of both kinds of noise add up, so that the level of torque noise
    follows from what positions do not explain (a fixed point of the marginal likelihood, whose
    trace is estimated from one draw; Harville 1977).

    **Arguments**

    - `residuals`: at the minimum; `draws`: of the present levels.
    - `counted`: equations, `moving`: readings that count fully.
    - `part`: number of the recording of each sample.
    - `torque_noise`, `position_noise`: the present levels.
    """
    new_torque, new_position = torque_noise.copy(), position_noise.copy()
    for index in np.ndindex(*torque_noise.shape):
        number, joint = index
        rows = counted[:, joint] & (part[1:-1] == number)
        if rows.any():
            square, alone, others = (
                np.median(np.abs(x["torque"][rows, joint])) ** 2
                for x in (residuals, draws.by_torque, draws.by_position)
            )
            ratio = (square - others) / alone if alone > 0.0 else 0.0
            new_torque[index] = torque_noise[index] * np.sqrt(np.clip(ratio, _FALL**2, 9.0))
        rows = moving[:, joint] & (part == number)
        if rows.any():
            square, alone, others = (
                np.mean(x["position"][rows, joint] ** 2)
                for x in (residuals, draws.by_position, draws.by_torque)
            )
            ratio = (square - others) / alone if alone > 0.0 else 1.0
            new_position[index] = position_noise[index] * np.sqrt(np.clip(ratio, 0.1, 9.0))
    return new_torque, new_position


def hidden_noise(
    seen: Levels,
    linear: Linear,
    part: Int[np.ndarray, " samples"],
    torque_noise: Levels,
) -> Levels:
    """Return the least noise of positions beside torque noise that would hide it.

    Where noise of positions makes less of an equation's error than torque noise does, residuals say
    little of its level, and a small one is as likely as none; with none, noise of accelerations
    makes inertias too small. So there the level is at least what readings themselves scatter by. If
    it is motion that they see, torque noise has made it: little is lost, for that is at the highest
    frequencies, which say nothing of coefficients.

    **Arguments**

    - `seen`: (recordings, n) scatter of readings about a smooth motion [rad or m].
    - `linear`: equations about the present point; `part` of the recording of each sample.
    - `torque_noise`: the present levels.
    """
    count, n = seen.shape
    by_position = linear.motion.by_position
    series = by_position.shape[1]
    stencil = by_position.reshape(len(by_position), series, -1, series)[:, :n, :, :n]
    size = np.sqrt(np.sum(stencil**2, axis=2))  # of the equation of one joint, by another's noise
    result = np.zeros_like(seen)
    for number in range(count):
        rows = part[1:-1] == number
        of_noise = np.median(size[rows], axis=0) / torque_noise[number][:, None]
        result[number] = np.minimum(
            seen[number], 1.0 / np.maximum(np.max(of_noise, axis=0), 1e-300)
        )
    return result


def position_errors(
    draws: NoiseDraws,
    moving: Bool[np.ndarray, "samples joints"],
    part: Int[np.ndarray, " samples"],
    recordings: int,
) -> Levels:
    """Return standard deviations of estimated positions with their offsets; infinite if none
    moves."""
    of_torque, of_position = draws.by_torque["position"], draws.by_position["position"]
    squares = (draws.position - of_position) ** 2 + of_torque**2
    result = np.full((recordings, squares.shape[1]), np.inf)
    for index in np.ndindex(*result.shape):
        number, joint = index
        rows = moving[:, joint] & (part == number)
        if rows.any():
            result[index] = np.sqrt(np.mean(squares[rows, joint]))
    return result
