"""The likelihood that chooses between rigid gears and others: against a dense normal density."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from jaxtyping import Float
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.identification import Settings
from jaxcslc.identification.likelihood._problem import Problem
from jaxcslc.identification.likelihood._start import starting_point
from jaxcslc.identification.likelihood.search import Minimum, search
from jaxcslc.identification.likelihood.transmission import _staged_search
from jaxcslc.identification.likelihood.transmission._choice import choice_line, criterion
from jaxcslc.identification.likelihood.transmission._first_gears import FirstGears
from jaxcslc.identification.likelihood.transmission._search_start import SearchStart
from jaxcslc.identification.likelihood.transmission._widened import with_transmission
from scripts.studies.likelihood.two_masses import TwoMasses


SAMPLES, INTERVAL = 24, 0.05
TORQUE_NOISE, POSITION_NOISE, LINK_NOISE = 0.1, 1e-2, 0.01
# A density that is flat as good as everywhere [rad].
WIDE = 10.0


def columns(function: Callable[[np.ndarray], np.ndarray], size: int) -> np.ndarray:
    """The matrix of a linear function."""
    zero = function(np.zeros(size))
    return np.stack([function(row) - zero for row in np.eye(size)], axis=1)


def minus_twice_log(
    torque: np.ndarray,
    reading: np.ndarray,
    of_torque: np.ndarray,
    of_reading: np.ndarray,
    deviation: np.ndarray,
) -> float:
    """Of torques and readings that are linear in normal variables of these deviations."""
    map_ = np.concatenate([of_torque, of_reading]) * deviation
    noise = np.concatenate(
        [np.full(len(torque), TORQUE_NOISE**2), np.full(len(reading), POSITION_NOISE**2)]
    )
    covariance, values = map_ @ map_.T + np.diag(noise), np.concatenate([torque, reading])
    white = np.linalg.solve(np.linalg.cholesky(covariance), values)
    return float(np.linalg.slogdet(2.0 * np.pi * covariance)[1] + white @ white)


def test_rigid_gears_and_others(rng: np.random.Generator) -> None:
    robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)])
    network = jc.derive(robot.with_friction("viscous"), lengths="numeric")
    time = np.arange(SAMPLES) * INTERVAL
    # It moves one way, so that all equations are linear.
    position = time + 0.05 * np.sin(3.0 * time) + POSITION_NOISE * rng.normal(size=SAMPLES)
    recording = jc.Recording(time, position[:, None], rng.normal(size=(SAMPLES, 1)))
    problem, point, *_ = starting_point(network, [recording], Settings(), "held", np.zeros(1), None)
    k = np.array([1.5, 1.0])
    levels = np.full((1, 1), TORQUE_NOISE), np.full((1, 1), POSITION_NOISE)
    start = SearchStart(dataclasses.replace(point, k=k), *levels)
    gears = FirstGears(
        np.array([0.02]), np.array([0.03]), np.array([0.5]), k, np.zeros((SAMPLES, 1))
    )
    wide, apart = with_transmission(problem, start, [0], gears)
    torque = problem.readings.torque.averaged()[:, 0]

    def minimum_of(problem: Problem, start: SearchStart) -> Minimum:
        fixed = dataclasses.replace(problem, scale=np.zeros_like(problem.scale))
        return search(fixed, *start, lambda words: None, fixed_levels=True)

    minima = minimum_of(problem, start), minimum_of(wide, apart)
    windup = np.std(minima[1].point.q[:, 0] - minima[1].point.q[:, 1])

    def of_positions(q: Float[np.ndarray, "_"]) -> np.ndarray:
        series = q.reshape(-1, SAMPLES).T
        one = np.ones((SAMPLES - 2, series.shape[1]))
        equations, laws = (
            (wide.equations, apart.point.laws)
            if series.shape[1] > 1
            else (problem.equations, point.laws)
        )
        # About a motion one way: velocities of unit vectors have both signs.
        moving = 100.0 * np.tile(time[:, None], series.shape[1])
        return np.asarray(equations.torque(k, laws, series + moving, -one, one)).T.ravel()

    rows, log = SAMPLES - 2, np.log(2.0 * np.pi * WIDE**2)
    rigid = columns(of_positions, SAMPLES)
    expected = minus_twice_log(torque, position, rigid, np.eye(SAMPLES), np.full(SAMPLES, WIDE))
    assert_allclose(criterion(minima[0]), expected - SAMPLES * log, atol=0.5)

    # Links from rotors, two first positions, and errors of the equations of gears.
    both = columns(of_positions, 2 * SAMPLES)
    motors, links = both[:rows], both[rows:]
    later = np.linalg.inv(links[:, SAMPLES + 2 :])
    link = np.zeros((SAMPLES, 2 * SAMPLES))
    link[:2, SAMPLES : SAMPLES + 2] = np.eye(2)
    link[2:, :SAMPLES] = -later @ links[:, :SAMPLES]
    link[2:, SAMPLES : SAMPLES + 2] = -later @ links[:, SAMPLES : SAMPLES + 2]
    link[2:, SAMPLES + 2 :] = later
    of_torque = motors[:, SAMPLES:] @ link
    of_torque[:, :SAMPLES] += motors[:, :SAMPLES]
    of_reading = np.eye(SAMPLES, 2 * SAMPLES)
    deviation = np.r_[np.full(SAMPLES + 2, WIDE), np.full(rows, LINK_NOISE)]
    expected = minus_twice_log(torque, position, of_torque, of_reading, deviation)
    expected += -(SAMPLES + 2) * log + 2.0 * np.log(2.0 * np.pi * windup**2)
    assert_allclose(criterion(minima[1]), expected + 6.0 * np.log(rows), atol=0.5)


def test_a_search_that_did_not_converge_is_not_used(
    network: jc.CSLC, with_play: TwoMasses, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Though its criterion is far below that of rigid gears."""
    recording = with_play.recording(5e-5, 0.05, np.random.default_rng(1), 600)
    stages = tuple((free, 8, speed) for free, _, speed in _staged_search._STAGES)
    monkeypatch.setattr(_staged_search, "_STAGES", stages)
    fit = jc.MaximumLikelihood(unknowns=("transmission",)).fit(network, recording)
    choice = fit.transmission_choice
    assert choice is not None and choice.apart < choice.rigid and choice.joints == (1,)
    assert not choice.converged and not choice.supported
    assert fit.transmission is None and fit.converged
    assert choice_line(choice.document()).endswith(
        "joint 1: not used, their search did not converge"
    )
