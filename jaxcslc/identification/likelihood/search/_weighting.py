"""The residual blocks of a step: their weights, and which equations count."""

import dataclasses

import numpy as np
from jaxtyping import Float

from .._blocks import TURN, MotionBlock, PriorBlock, ReadingBlock, RestBlock, ReversalBlock
from .._levenberg import LevenbergStep
from .._objective import Objective
from .._point import Point
from .._problem import Problem
from .._signs import Signs
from .._sticking import Sticking, sticking_equations
from ..equations import AbstractEquations
from ._state import MARGINS, Mask, State


# Standard deviation of friction that is anything up to break-away, and of a reversal's whose moment
# is estimated, as parts of the break-away torque. Simulated: 0.003 to 0.006 for the latter.
_UNCERTAIN, _REVERSAL = 0.6, 0.01
# Huber's constant, in standard deviations: what is beyond counts by its size, not by its square.
_OUTLIER = 4.0
# A joint at rest moves by this part of its position noise from sample to sample.
_REST = 0.02


def objective_of(problem: Problem, state: State, number: int) -> tuple[Objective, Mask]:
    """Return the sum of squares, and which equations have their full weight; `number`: of the
    step."""
    readings, signs, point = problem.readings, state.signs, state.point
    assert signs is not None
    of_equation, of_interval = readings.part[1:-1], readings.part[:-1]
    equations = problem.equations.about(point.q, readings.time, readings.part)
    scale = state.of_friction or point
    breakaway = problem.breakaway(scale)
    of_friction = _friction_variance(problem, equations, signs, point, breakaway)
    weight = state.outlier_weight / (state.torque_noise[of_equation] ** 2 + of_friction)
    without = problem.at_rest | state.undecided | readings.joined[:, None]
    weight[without] = 0.0
    others = equations.noise(state.torque_noise)[of_equation, problem.joints :] ** -2.0
    others[readings.joined] = 0.0
    left_out = state.truncation
    if left_out is None:
        left_out = _truncation(problem, equations, signs, point)
    expected, known = problem.known(point, scale)
    at_rest = 1.0 / (_REST * state.position_noise[of_interval]) ** 2
    position_weight = problem.reading_shares / state.position_noise[readings.part] ** 2
    weight = np.concatenate([weight, others], axis=1)
    blocks = {
        "torque": MotionBlock(equations, readings.torque, signs, weight, truncation=left_out),
        "position": ReadingBlock(
            readings.position, readings.part, position_weight, state.intervals
        ),
        "standstill": RestBlock(np.where(problem.stuck, at_rest, 0.0)),
        "turn": ReversalBlock(signs.turn, np.full(len(signs.samples), TURN**-2)),
        "border": PriorBlock(expected, known),
        **problem.added,
    }
    objective = Objective(blocks, problem.scale)
    if number >= len(MARGINS):
        objective = _with_sticking(problem, state, objective)
    return objective, (of_friction == 0.0) & ~without


def _truncation(
    problem: Problem, equations: AbstractEquations, signs: Signs, point: Point
) -> Float[np.ndarray, "equations series"] | float:
    """Return what equations of sampled torque leave out at present positions."""
    readings = problem.readings
    if readings.torque.sampling == "held":
        return 0.0
    motion = point.q, readings.time, readings.part, signs.turns(point.turn), signs.direction
    return equations.truncation(point.k, point.laws, *motion)


def _with_sticking(problem: Problem, state: State, objective: Objective) -> Objective:
    """Add equations of joints that stick, which bound friction at break-away.

    Not of joints whose friction has a state, which bears what it does where they rest. Nor where
    all coefficients are fixed, of which alone bounds say something: wrong ones would draw positions
    to where friction bears what they make of the torque.
    """
    point, breakaway = state.point, problem.breakaway(state.point)
    fixed = not problem.scale[: len(point.k)].any()
    if fixed or not problem.at_rest.any():
        return objective
    part, motion, n = problem.readings.part, objective.motion, problem.joints
    signs = motion.signs
    friction = motion.residuals(point)[:, :n] + signs.direction * breakaway
    mask = sticking_equations(problem.at_rest, friction, breakaway) & (
        problem.equations.lengths == 0.0
    )
    mask &= ~problem.readings.joined[:, None]
    if not mask.any():
        return objective
    direction = np.where(mask, np.where(friction < 0.0, -1.0, 1.0), signs.direction)
    mask, direction_of_all = (
        np.concatenate([values, np.zeros((len(mask), motion.weight.shape[1] - n))], axis=1)
        for values in (mask, direction)
    )
    noise = motion.equations.noise(state.torque_noise)[part[1:-1]]
    return objective.with_blocks(
        torque=dataclasses.replace(
            motion,
            signs=dataclasses.replace(signs, direction=direction),
            sticking=Sticking(mask.astype(bool), direction_of_all, noise),
        )
    )


def _friction_variance(
    problem: Problem,
    equations: AbstractEquations,
    signs: Signs,
    point: Point,
    breakaway: Float[np.ndarray, " joints"],
) -> Float[np.ndarray, "equations joints"]:
    """Return variance of friction that signs do not tell, and of states at the start of a
    recording."""
    sizes, unknown = equations.states(point.k)
    of_states = (_UNCERTAIN * sizes * unknown) ** 2
    breakaway = np.maximum(breakaway - sizes, 0.0)
    extra = np.where(signs.uncertain, (_UNCERTAIN * breakaway) ** 2, 0.0)
    for offset in (-1, 0, 1):
        extra[signs.samples - 1 + offset, signs.joints] = (_REVERSAL * breakaway[signs.joints]) ** 2
    return extra + of_states


def outlier_weights(
    problem: Problem, state: State, step: LevenbergStep, counted: Mask
) -> Float[np.ndarray, "equations joints"]:
    """Return Huber's weights of a step's residuals.

    Uncertain friction is within break-away; what pushes a joint at its limit is not.
    """
    linear = step.minimum.linear
    motion, noise = linear.objective.motion, state.torque_noise[problem.readings.part[1:-1]]
    signs = motion.signs
    breakaway = problem.breakaway(step.point)
    of_friction = _friction_variance(problem, motion.equations, signs, step.point, breakaway)
    extra = np.where(signs.uncertain, of_friction, 0.0)
    deviation = np.sqrt(noise**2 + extra)
    weight, residual = (
        values["torque"][:, : problem.joints] for values in (linear.weights, step.residuals)
    )
    robust = (counted | (extra > 0.0)) & (weight > 0.0)
    size = np.maximum(np.abs(residual), 1e-300)
    return np.where(robust, np.minimum(1.0, _OUTLIER * deviation / size), 1.0)
