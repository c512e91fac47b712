"""Noise levels and intervals that follow the steps of a search."""

import dataclasses

import numpy as np

from .._levels import Levels, NoiseDraws, hidden_noise, noise_levels, position_errors
from .._levenberg import DAMPING, SMALL_DAMPING, LevenbergStep
from .._linear_minimum import LinearMinimum
from .._objective import Residuals
from .._problem import Problem
from ._state import MARGINS, Mask, Stage, State, intervals_of
from ._weighting import outlier_weights


# Noise levels go all the way to where residuals would have them in so many steps, then half of it;
# they are fixed when they change by less than this part in a step, or after so many steps.
_FREE_LEVEL_STEPS, _LEVEL_TOLERANCE, _MOST_LEVEL_STEPS, _MOST_STEPS_OF_ADDED = 6, 0.05, 14, 40
# Counts become intervals when a step moves no coefficient by more than this part of its standard
# error. Where all of them will, the level of torque noise need not be settled: it follows later.
NEAR = 0.3
# Beside intervals, edges and the level of torque noise follow so many steps. The level goes all the
# way, and in later ones half of it.
_REFINEMENTS, _FREE_REFINEMENTS = 5, 3
# Readings of an encoder whose noise is less than so many times that of its steps have that.
_MORE_THAN_STEPS = 1.3
# Counts are intervals where positions are known better than this part of a step. The width of an
# edge is so many times the error of positions, for then scores are linear in errors, and at least
# that of an encoder, in steps. Intervals reduce the error, and their width follows.
_SHARP, _EDGE, _LEAST_EDGE = 0.1, 2.0, 0.01
# With less damping than this part of the readings' weights, draws of noise are fitted all the same.
LITTLE_DAMPING = 1e-2


def with_levels(
    problem: Problem, state: State, step: LevenbergStep, counted: Mask, number: int
) -> State:
    """Let noise levels and weights of outliers follow the residuals of a step."""
    draws = _draws(problem, state, step.minimum)
    torque_noise, position_noise = _levels_of(problem, state, step.residuals, draws, counted)
    hidden = hidden_noise(problem.scatter, step.minimum.linear, problem.readings.part, torque_noise)
    position_noise = np.maximum(position_noise, hidden)
    if number > _FREE_LEVEL_STEPS:
        torque_noise = np.sqrt(torque_noise * state.torque_noise)
        position_noise = np.sqrt(position_noise * state.position_noise)
    change = max(
        np.abs(np.log(new / old)).max()
        for new, old in (
            (torque_noise, state.torque_noise),
            (position_noise, state.position_noise),
        )
    )
    modelled = number > len(MARGINS)
    settled = modelled and bool(change <= _LEVEL_TOLERANCE)
    if not problem.added:
        final = settled or number >= _MOST_LEVEL_STEPS
    else:  # what added blocks let bodies do shows little by little
        final = (settled and step.change <= NEAR) or number >= _MOST_STEPS_OF_ADDED
    if modelled and step.change <= NEAR:
        final |= _all_sharp(problem, draws, position_noise)
    if final:
        least = problem.least_position_noise
        counted_steps = (problem.encoder_step > 0.0) & (position_noise <= _MORE_THAN_STEPS * least)
        position_noise = np.where(counted_steps, least, position_noise)
    levelled = dataclasses.replace(state, torque_noise=torque_noise, position_noise=position_noise)
    return dataclasses.replace(
        levelled,
        outlier_weight=outlier_weights(problem, levelled, step, counted),
        stage=Stage.COUNTS if final else Stage.LEVELS,
    )


def _draws(problem: Problem, state: State, minimum: LinearMinimum) -> NoiseDraws:
    # Damped positions do not follow noise that is drawn: they would seem to be known better than
    # readings say (a Stäubli TX40 with damping of 1e4: to 0.005 of a step in place of 0.28).
    little = minimum.damping <= LITTLE_DAMPING
    factored = minimum.factored if little else minimum.linear.factored(SMALL_DAMPING)
    return NoiseDraws.of(
        minimum.linear,
        factored,
        problem.readings.part,
        state.torque_noise,
        state.position_noise,
    )


def _levels_of(
    problem: Problem, state: State, residuals: Residuals, draws: NoiseDraws, counted: Mask
) -> tuple[Levels, Levels]:
    """Return noise levels that residuals have, of torque and of positions, none below its least."""
    torque_noise, position_noise = noise_levels(
        residuals,
        draws,
        counted,
        problem.moving,
        problem.readings.part,
        state.torque_noise,
        state.position_noise,
    )
    return (
        np.maximum(torque_noise, problem.least_torque_noise),
        np.maximum(position_noise, problem.least_position_noise),
    )


def _all_sharp(problem: Problem, draws: NoiseDraws, position_noise: Levels) -> bool:
    """Return whether positions of all joints that move are known much better than steps."""
    errors = _in_steps(problem, draws)
    steps = position_noise <= _MORE_THAN_STEPS * problem.least_position_noise
    return bool(np.all(np.isinf(errors) | (steps & (errors <= _SHARP))))


def with_intervals(problem: Problem, state: State, minimum: LinearMinimum) -> State:
    """Make counts intervals, where positions are known much better than a step."""
    errors = _in_steps(problem, _draws(problem, state, minimum))
    counts = state.position_noise <= problem.least_position_noise
    edge = np.where(counts & (errors <= _SHARP), np.maximum(_EDGE * errors, _LEAST_EDGE), 0.0)
    intervals = intervals_of(problem, edge)
    # What linear equations say of intervals holds near only.
    damping = state.damping if intervals is None else max(state.damping, DAMPING)
    stage = Stage.FINAL if intervals is None else Stage.INTERVALS
    return dataclasses.replace(state, intervals=intervals, stage=stage, damping=damping)


def with_refined_intervals(
    problem: Problem, state: State, step: LevenbergStep, counted: Mask
) -> State:
    """Let torque noise and edges follow what intervals leave.

    Single counts hide torque noise far below what they leave of torque. Intervals show it, and with
    a level that is too large, standard errors would be.
    """
    part, intervals = problem.readings.part, state.intervals
    assert intervals is not None
    draws = _draws(problem, state, step.minimum)
    errors = _in_steps(problem, draws)
    torque_noise, _ = _levels_of(problem, state, step.residuals, draws, counted)
    if state.refinements >= _FREE_REFINEMENTS:
        torque_noise = np.sqrt(torque_noise * state.torque_noise)
    edge = np.clip(_EDGE * errors, _LEAST_EDGE, _EDGE * _SHARP)[part]
    refinements = state.refinements + 1
    return dataclasses.replace(
        state,
        intervals=dataclasses.replace(intervals, edge=np.where(intervals.edge > 0.0, edge, 0.0)),
        torque_noise=torque_noise,
        refinements=refinements,
        stage=Stage.FINAL if refinements == _REFINEMENTS else Stage.INTERVALS,
    )


def _in_steps(problem: Problem, draws: NoiseDraws) -> Levels:
    """Return errors of estimated positions in steps of encoders; infinite where there are none."""
    step = problem.encoder_step
    errors = position_errors(draws, problem.moving, problem.readings.part, len(step))
    return errors / np.where(step > 0.0, step, 1e-300)
