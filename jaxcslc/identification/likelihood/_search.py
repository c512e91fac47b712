import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import LinAlgError

from ._band import Factored, Spectrum
from ._motion_equations import MotionEquations
from ._objective import TURN, Linear, Objective, Point, Residuals
from ._readings import Readings
from ._signs import LATEST_TURN, Signs, runs


# Equations left uncertain on either side of a reversal, stage by stage; after these stages,
# reversals are moments to be estimated. Noise levels, estimated from one draw, are fixed after some
# stages: they would go on to change by a tenth.
_MARGINS = (4, 3, 2)
LEVEL_STAGES, _MOST_STAGES = 6, 10
# A stage ends when a step reduces the sum of squares, in units of variances, by less than this.
_STAGE_TOLERANCE, _LAST_TOLERANCE = 2.0, 0.02
_MOST_STEPS, _MOST_TRIALS = 12, 8
# All has converged when a stage moves no coefficient by more than this part of a standard error.
_SETTLED = 0.25
# Levenberg and Marquardt's damping: at first, least, and its factor after good and bad steps.
_DAMPING, _LEAST_DAMPING, _FACTOR = 1e-3, 1e-9, 10.0
# A noise level falls to no less than this part in a stage (continuation: while torque counts for
# little, the sum of squares has no other minima near), and never below this part of the torque,
# where errors of second differences are.
_FALL, _LEAST_TORQUE_NOISE = 0.25, 3e-5
# Standard deviation of friction that is anything up to break-away, and of a reversal's whose moment
# is estimated, as parts of the break-away torque. Simulated: 0.003 to 0.006 for the latter.
_UNCERTAIN, _REVERSAL = 0.6, 0.01
# Huber's constant, in standard deviations: what is beyond counts by its size, not by its square.
_OUTLIER = 4.0
# How far the logarithm of a slope moves in a step.
_SLOPE_STEP = 0.7
# A joint at rest moves by this part of its position noise from sample to sample.
_REST = 0.02


@dataclasses.dataclass(frozen=True)
class Problem:
    """What a search needs to know.

    **Attributes**

    - `equations`: torque as a function of positions.
    - `readings`: of one recording or of several.
    - `stuck`: (intervals, n), where joints are at standstill.
    - `scale`: (border,) of the unknowns that all equations share; 0 fixes one.
    - `known`: from a point, mean and inverse variance, (border,) each, of what is known of these
      beforehand.
    - `slope_bounds`: (n,) each, least and greatest logarithms of slopes.
    - `breakaway`: from a point, (n,) the greatest friction at standstill.
    - `fixed_noise`: whether the noise of positions is that of encoders, not to be estimated,
      (recordings, n).
    """

    equations: MotionEquations
    readings: Readings
    stuck: Bool[np.ndarray, "intervals joints"]
    scale: Float[np.ndarray, " border"]
    known: Callable[[Point], tuple[Float[np.ndarray, " border"], Float[np.ndarray, " border"]]]
    slope_bounds: tuple[Float[np.ndarray, " joints"], Float[np.ndarray, " joints"]]
    breakaway: Callable[[Point], Float[np.ndarray, " joints"]]
    fixed_noise: Bool[np.ndarray, "recordings joints"]


@dataclasses.dataclass(frozen=True)
class Minimum:
    """Where a search ended.

    **Attributes**

    - `point`: all unknowns; `objective`: the sum of squares there; `linear`: its equations.
    - `factored`: the equations, whose information is in units of the border's scale.
    - `torque_noise`, `position_noise`: (recordings, n) standard deviations.
    - `counted`: (equations, n), which equations have the full weight.
    - `steps`: Gauss-Newton steps; `converged`: whether the last stage changed nothing.
    """

    point: Point
    objective: Objective
    linear: Linear
    factored: Factored
    torque_noise: Float[np.ndarray, "recordings joints"]
    position_noise: Float[np.ndarray, "recordings joints"]
    counted: Bool[np.ndarray, "equations joints"]
    steps: int
    converged: bool


def search(
    problem: Problem,
    point: Point,
    torque_noise: Float[np.ndarray, "recordings joints"],
    position_noise: Float[np.ndarray, "recordings joints"],
    progress: Callable[[str], None],
    *,
    level_stages: int = LEVEL_STAGES,
) -> Minimum:
    """Minimises stage by stage: signs, weights and noise levels are fixed within each stage.

    - `level_stages`: after how many stages noise levels and weights of outliers are fixed; 0 for
      those of the start.
    """
    readings = problem.readings
    samples, n = readings.position.shape
    of_equation, of_interval = readings.part[1:-1], readings.part[:-1]
    torque_scale = np.sqrt(np.mean(readings.torque**2, axis=0))
    least = np.maximum(_LEAST_TORQUE_NOISE * torque_scale, 1e-9)
    torque_noise = np.maximum(torque_noise, least)
    outlier_weight = np.ones((samples - 2, n))
    signs: Signs | None = None
    result: Minimum | None = None
    damping, steps = _DAMPING, 0
    border_before = point.border
    for stage in range(_MOST_STAGES):
        modelled = stage >= len(_MARGINS)
        margin = _MARGINS[min(stage, len(_MARGINS) - 1)]
        turned = point.turn
        before, signs = (
            signs,
            Signs.of(
                point.q,
                readings.time,
                problem.stuck,
                margin=margin,
                modelled=modelled,
                joined=readings.joined,
            ),
        )
        turn = signs.turn if before is None else signs.carried(before, turned)
        point = dataclasses.replace(point, turn=turn)
        extra, at_rest = _friction_variance(problem, signs, point)
        weight = outlier_weight / (torque_noise[of_equation] ** 2 + extra)
        without = at_rest | readings.joined[:, None]
        weight[without] = 0.0
        expected, known = problem.known(point)
        weights = Residuals(
            torque=weight,
            position=_reading_weights(problem.stuck) / position_noise[readings.part] ** 2,
            standstill=np.where(
                problem.stuck, 1.0 / (_REST * position_noise[of_interval]) ** 2, 0.0
            ),
            turn=np.full(len(signs.samples), TURN**-2),
            border=known,
        )
        objective = Objective(
            problem.equations,
            readings.position,
            readings.torque,
            readings.part,
            signs,
            weights,
            expected,
            problem.scale,
        )
        tolerance = _LAST_TOLERANCE if modelled else _STAGE_TOLERANCE
        point, damping, used, stage_converged = _minimise(
            problem, objective, point, damping, tolerance
        )
        steps += used
        progress(f"maximum likelihood: stage {stage + 1}, {steps} steps")
        counted = (extra == 0.0) & ~without
        linear = objective.linearised(point)
        factored = linear.factored(0.0)
        if stage < level_stages:
            torque_noise, position_noise = _noise_levels(
                problem, linear, factored, counted, torque_noise, position_noise, least
            )
            size = np.maximum(np.abs(linear.residuals.torque), 1e-300)
            # Uncertain friction is within break-away; what pushes a joint at its limit is not.
            deviation = np.sqrt(
                torque_noise[of_equation] ** 2 + np.where(signs.uncertain, extra, 0)
            )
            robust = (counted | signs.uncertain) & ~without
            outlier_weight = np.where(robust, np.minimum(1.0, _OUTLIER * deviation / size), 1.0)
        moved = np.abs(point.border - border_before)
        settled = bool(np.all(moved <= _SETTLED * problem.scale * _deviation(factored)))
        same = before is not None and np.array_equal(before.samples, signs.samples)
        converged = modelled and stage_converged and same and settled
        border_before = point.border
        result = Minimum(
            point,
            objective,
            linear,
            factored,
            torque_noise,
            position_noise,
            counted,
            steps,
            converged,
        )
        if converged:
            break
    assert result is not None
    return result


def _friction_variance(
    problem: Problem, signs: Signs, point: Point
) -> tuple[Float[np.ndarray, "equations joints"], Bool[np.ndarray, "equations joints"]]:
    """Variance of friction that signs do not tell, and where joints are at standstill."""
    breakaway = problem.breakaway(point)
    extra = np.where(signs.uncertain, (_UNCERTAIN * breakaway) ** 2, 0.0)
    for offset in (-1, 0, 1):
        extra[signs.samples - 1 + offset, signs.joints] = (_REVERSAL * breakaway[signs.joints]) ** 2
    return extra, problem.stuck[1:] | problem.stuck[:-1]


def _reading_weights(stuck: Bool[np.ndarray, "intervals joints"]) -> Float[np.ndarray, "..."]:
    """(samples, n): the readings of a rest are one reading, for they have one error."""
    weights = np.ones((len(stuck) + 1, stuck.shape[1]))
    for joint in range(stuck.shape[1]):
        for start, end in runs(stuck[:, joint]):
            weights[start : end + 1, joint] = 1.0 / (end + 1 - start)
    return weights


def _minimise(
    problem: Problem, objective: Objective, point: Point, damping: float, tolerance: float
) -> tuple[Point, float, int, bool]:
    """Levenberg and Marquardt's method for one objective."""
    value = objective.value(objective.residuals(point))
    for step in range(_MOST_STEPS):
        linear = objective.linearised(point)
        expected = np.inf
        for _ in range(_MOST_TRIALS):
            try:
                factored = linear.factored(damping)
            except LinAlgError:
                damping = _FACTOR * max(damping, 1e-6)
                continue
            change = linear.step(factored, linear.residuals, damping)
            if expected == np.inf:  # what linear equations promise, before damping grows
                expected = value - objective.value(linear.after(change, linear.residuals))
            moved = _bounded(problem, objective.moved(point, change), point)
            moved_value = objective.value(objective.residuals(moved))
            if moved_value <= value * (1.0 + 1e-12):
                break
            damping = _FACTOR * max(damping, 1e-5)
        else:  # a minimum up to rounding, if nothing was to be expected
            return point, _DAMPING, step, expected < tolerance
        gain, point, value = value - moved_value, moved, moved_value
        damping = max(damping / _FACTOR, _LEAST_DAMPING)
        if gain < tolerance:
            return point, damping, step + 1, True
    return point, damping, _MOST_STEPS, False


def _bounded(problem: Problem, point: Point, before: Point) -> Point:
    low, high = problem.slope_bounds
    near = np.clip(point.slopes, before.slopes - _SLOPE_STEP, before.slopes + _SLOPE_STEP)
    return dataclasses.replace(
        point,
        slopes=np.clip(near, low, high),
        turn=np.clip(point.turn, -LATEST_TURN, LATEST_TURN),
    )


def _noise_levels(
    problem: Problem,
    linear: Linear,
    factored: Factored,
    counted: Bool[np.ndarray, "equations joints"],
    torque_noise: Float[np.ndarray, "recordings joints"],
    position_noise: Float[np.ndarray, "recordings joints"],
    least: Float[np.ndarray, " joints"],
) -> tuple[Float[np.ndarray, "recordings joints"], Float[np.ndarray, "recordings joints"]]:
    """The levels at which residuals would be as large as they are.

    Residuals are what fitting the same unknowns leaves of the noise of torque and of positions. One
    draw of each, of the present levels, is fitted: their squares add up, so that the level of
    torque noise follows from what positions do not explain (a fixed point of the marginal
    likelihood, whose trace is estimated from one draw; Harville 1977).
    """
    weights, rng, part = linear.objective.weights, np.random.default_rng(0), problem.readings.part
    zeros = Residuals(
        **{
            part.name: np.zeros_like(getattr(weights, part.name))
            for part in dataclasses.fields(Residuals)
        }
    )
    counts = weights.torque > 0.0
    noise = rng.normal(size=counts.shape) * np.where(counts, torque_noise[part[1:-1]], 0.0)
    by_torque = _left(linear, factored, dataclasses.replace(zeros, torque=noise))
    noise = rng.normal(size=weights.position.shape) * position_noise[part]
    by_position = _left(linear, factored, dataclasses.replace(zeros, position=noise))
    new_torque, new_position = torque_noise.copy(), position_noise.copy()
    for index in np.ndindex(*torque_noise.shape):
        number, joint = index
        rows = counted[:, joint] & (part[1:-1] == number)
        if rows.any():
            square, alone, others = (
                np.median(np.abs(x.torque[rows, joint])) ** 2
                for x in (linear.residuals, by_torque, by_position)
            )
            ratio = (square - others) / alone if alone > 0.0 else 0.0
            new_torque[index] = torque_noise[index] * np.sqrt(np.clip(ratio, 0.0, 9.0))
        if not problem.fixed_noise[index]:
            moving = ~np.r_[problem.stuck[:, joint], False] & (part == number)
            square, alone, others = (
                np.mean(x.position[moving, joint] ** 2)
                for x in (linear.residuals, by_position, by_torque)
            )
            ratio = (square - others) / alone if alone > 0.0 else 1.0
            new_position[index] = position_noise[index] * np.sqrt(np.clip(ratio, 0.1, 9.0))
    return np.maximum(np.maximum(new_torque, _FALL * torque_noise), least), new_position


def _left(linear: Linear, factored: Factored, drawn: Residuals) -> Residuals:
    """What fitting all unknowns leaves of residuals."""
    return linear.after(linear.step(factored, drawn), drawn)


def _deviation(factored: Factored) -> Float[np.ndarray, " border"]:
    """Standard deviations of the border in units of its scale."""
    return np.sqrt(np.diag(Spectrum.of(factored.information).covariance))
