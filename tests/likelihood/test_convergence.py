"""What lets a search end: damping that says nothing, sums of squares that are one function from
step to step, steps as long as they should be."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxcslc as jc
from jaxcslc.likelihood import LikelihoodProblem, Minimum, Point, SearchState, search, search_on
from jaxcslc.likelihood._levenberg import PROMISE, LinearMinimum
from jaxcslc.likelihood._objective import Linear
from jaxcslc.likelihood._possible_bodies import Profile
from jaxcslc.likelihood._search_state import (
    SIGN_STEPS,
    Stage,
    objective_of,
    with_common_shafts,
    with_intervals,
    with_signs,
)
from tests import arms


COUNT = 1e-4


def swing(seed: int, samples: int, noise: float) -> jc.Recording:
    """Friction that grows little by little with speed, which no law of the model does."""
    rng = np.random.default_rng(seed)
    time, w = 0.01 * np.arange(samples)[:, None], rng.uniform(2, 4)
    speeds, sizes, phases = (w, 2.3 * w), (1.0, 0.3), (0.0, 1.0)
    parts = list(zip(sizes, speeds, phases, strict=True))
    q = np.sum([size * np.sin(speed * time + phase) for size, speed, phase in parts], axis=0)
    qd = np.sum(
        [size * speed * np.cos(speed * time + phase) for size, speed, phase in parts], axis=0
    )
    qdd = np.sum(
        [-size * speed**2 * np.sin(speed * time + phase) for size, speed, phase in parts], axis=0
    )
    torque = np.asarray(
        arms.pendulum("viscous").torque(np.array([0.5, 0.3, -0.1, 0.2]), q, qd, qdd)
    )
    torque = torque + np.sign(qd) * (1 - 0.9 * np.exp(-0.3 * np.abs(qd)))
    torque = torque + noise * rng.normal(size=torque.shape)
    return jc.Recording(time[:, 0], COUNT * np.round(q / COUNT), torque)


def start(
    network: jc.CSLC, recording: jc.Recording
) -> tuple[LikelihoodProblem, Point, SearchState]:
    problem, (point, torque_noise, position_noise) = jc.MaximumLikelihood("sampled").start(
        network, [recording], None, 1
    )
    state = SearchState.start(
        problem, point, torque_noise, position_noise, fixed=True, edge=None, moments=None
    )
    return problem, point, state


@pytest.fixture(scope="module")
def viscous() -> tuple[LikelihoodProblem, Minimum]:
    """A search with coefficients fixed."""
    problem, point, state = start(arms.pendulum("viscous", "dry"), swing(0, 400, 0.1))
    fixed = problem.fixing("k")
    return fixed, search(
        fixed,
        point,
        state.torque_noise,
        state.position_noise,
        lambda words: None,
        fixed_levels=True,
    )


def test_friction_that_grows_little_by_little() -> None:
    # Steps of linear equations go twice as far as they should: it took 44.
    estimator = jc.MaximumLikelihood(torque_sampling="sampled", every=1)
    result = estimator.fit(arms.pendulum("viscous", "dry", "static"), swing(5, 800, 0.1))
    assert result.converged
    assert result.steps <= 25


@pytest.mark.parametrize("damping", [1e-6, 1e4])
def test_damping_does_not_make_positions_known(damping: float) -> None:
    # Single counts say more of positions than equations do: none is an interval.
    problem, _, state = start(arms.pendulum("viscous", "dry"), swing(0, 400, 0.5))
    state, _ = with_signs(problem, state, 3)
    objective, _ = objective_of(problem, state, 0)
    linear = Linear.of(objective, state.point)
    minimum = LinearMinimum.of(linear, damping, PROMISE)
    after = with_intervals(problem, state, minimum)
    assert after.intervals is None
    assert after.stage is Stage.FINAL


def test_equations_in_which_a_common_shaft_turns_do_not_count() -> None:
    robot = jc.Manipulator.from_modified_dh(
        [(0, 0, 0, 0), ("-pi/2", 0.1, 0, 0)], gravity=(0, -9.81, 0)
    ).with_friction("viscous", "dry")
    time = 0.01 * np.arange(300)
    q = np.stack([np.sin(3 * time), -0.7 * np.sin(2.2 * time + 0.4)], axis=1)
    recording = jc.Recording(time, q, np.cos(q))
    alone = jc.derive(robot, lengths="numeric")
    problem, _, state = start(alone, recording)
    assert with_common_shafts(problem, state, 0) == (state, True)
    problem, point, state = start(
        jc.derive(robot.with_coupling((1, 2, -1.0)), lengths="numeric"), recording
    )
    first, same = with_common_shafts(problem, state, 0)
    last, _ = with_common_shafts(problem, state, SIGN_STEPS)
    assert not same
    turns = np.flatnonzero(last.undecided[:, 0])
    shaft = np.diff(point.q @ [1.0, -1.0])
    assert_array_equal(np.flatnonzero(shaft[1:] * shaft[:-1] <= 0.0), turns)
    assert_array_equal(last.undecided[:, 0], last.undecided[:, 1])
    assert first.undecided.sum() > 3 * last.undecided.sum() > 0
    last, _ = with_signs(problem, last, SIGN_STEPS)
    _, counted = objective_of(problem, last, 0)
    assert not counted[turns].any()
    # Later, none comes back.
    elsewhere = dataclasses.replace(last, point=dataclasses.replace(point, q=point.q[::-1]))
    moved, same = with_common_shafts(problem, elsewhere, SIGN_STEPS)
    assert not same
    assert np.all(moved.undecided >= last.undecided)


def test_a_search_goes_on_from_its_end(viscous: tuple[LikelihoodProblem, Minimum]) -> None:
    problem, minimum = viscous
    again = search_on(problem, minimum.state, minimum.point.k, lambda words: None)
    assert minimum.converged and again.converged
    assert again.steps <= 2 < minimum.steps
    assert again.state.same_motion(minimum.state)
    assert_allclose(again.linear.present_value, minimum.linear.present_value, rtol=1e-4)


@pytest.mark.parametrize("bend", [0.0, 1.5])
def test_steps_of_bodies_are_as_long_as_the_sum_of_squares_lets_them(
    viscous: tuple[LikelihoodProblem, Minimum], bend: float
) -> None:
    problem, minimum = viscous
    free, _, _ = start(arms.pendulum("viscous", "dry"), swing(0, 400, 0.1))
    profile = Profile.of(minimum, free.scale)
    change = 0.8 * (profile.target - profile.k)

    def search_with(k: np.ndarray, state: SearchState) -> Minimum:
        trial = search_on(problem, state, k, lambda words: None)
        moved = k - profile.k
        more = bend * float(moved @ profile.information @ moved)
        value = trial.linear.present_value + more
        linear = dataclasses.replace(trial.linear, present_value=value)
        return dataclasses.replace(trial, linear=linear)

    lower, part, _ = profile.towards(change, 1.0, search_with)
    assert lower.linear.present_value < minimum.linear.present_value
    assert_allclose(part, 1.0 / (1.0 + bend), rtol=0.1)
    assert_allclose(lower.point.k, profile.k + part * change, rtol=0.1)
