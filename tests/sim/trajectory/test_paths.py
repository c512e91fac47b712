"""Paths: shape, ends and stops."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sim
from sim.trajectory._paths import AbstractPath, MinimumJerk, Oscillation, SampledPath, ViaPoints


PATHS = {
    "minimum jerk": MinimumJerk(np.array([0.5, -1.0]), 0.8),
    "oscillation": Oscillation(np.array([0.5, -1.0]), np.array([0.2, 0.3]), 0.7),
    "via points": ViaPoints(
        np.array([[0.5, -1.0], [0.2, 0.1], [0.2, 0.5]]),
        np.array([0.3, 0.2, 0.4]),
        np.array([0.1, 0.0, 0.2]),
    ),
}


@pytest.mark.parametrize("name", sorted(PATHS))
def test_references_are_derivatives_of_positions(name: str):
    """By automatic differentiation of the position, at times that include the ends of segments."""
    path, origin = PATHS[name], jnp.array([0.3, 0.4])

    def position(time: jax.Array) -> Any:
        return path.position(time[None], origin)

    rate = jax.jacfwd(position)
    times = np.linspace(-0.05, 1.45, 61)
    ends = np.isclose(times[:, None], [0.0, 0.3, 0.4, 0.6, 0.8, 1.0], atol=1e-6).any(axis=1)
    result = path.reference(times[:, None], np.tile(origin, (61, 1)))
    qd, qdd = (
        jax.jit(jax.vmap(function))(jnp.array(times)) for function in (rate, jax.jacfwd(rate))
    )
    np.testing.assert_allclose(result.qd, qd, atol=1e-11)
    np.testing.assert_allclose(result.qdd[~ends], qdd[~ends], atol=1e-9)


@pytest.mark.parametrize("name", sorted(PATHS))
def test_paths_take_either_library_and_any_batch(name: str, rng: np.random.Generator):
    path, time, origin = PATHS[name], rng.uniform(0, 2, (4, 3, 1)), rng.normal(size=(4, 3, 2))
    result = path.reference(time, origin)
    other = jax.jit(path.reference)(jnp.asarray(time), jnp.asarray(origin))
    for i in range(4):
        row = path.reference(time[i], origin[i])
        for one, two, three in zip(
            *(jax.tree_util.tree_leaves(item) for item in (result, other, row)), strict=True
        ):
            np.testing.assert_allclose(one, two, atol=1e-12)
            np.testing.assert_allclose(one[i], three, atol=1e-14)


def test_via_points_rest_at_every_pose():
    path = PATHS["via points"]
    assert isinstance(path, ViaPoints)
    np.testing.assert_allclose(path.arrivals, [0.3, 0.6, 1.0])
    for begin, end, pose in zip([0.3, 0.6, 1.0], [0.4, 0.6, 9.0], path.poses, strict=True):
        for time in np.linspace(begin, end, 4):
            at = path.reference(np.array([time]), np.zeros(2))
            np.testing.assert_allclose(at.q, pose, atol=1e-14)
            np.testing.assert_allclose(at.qd, 0.0, atol=1e-12)
            np.testing.assert_allclose(at.qdd, 0.0, atol=1e-8)


def test_via_points_of_each_machine_are_its_own(rng: np.random.Generator):
    poses, durations, stays = (
        rng.normal(size=(3, 4, 2)),
        rng.uniform(0.2, 0.5, (3, 4)),
        rng.uniform(0.0, 0.2, (3, 4)),
    )
    together = ViaPoints(poses, durations, stays)
    time, origin = rng.uniform(0, 2, (3, 1)), rng.normal(size=(3, 2))
    result = together.reference(time, origin)
    traced = jax.jit(together.reference)(jnp.asarray(time), jnp.asarray(origin))
    for i in range(3):
        alone = ViaPoints(poses[i], durations[i], stays[i])
        np.testing.assert_allclose(together.arrivals[i], alone.arrivals)
        expected = alone.reference(time[i], origin[i])
        for name in ("q", "qd", "qdd"):
            np.testing.assert_allclose(
                getattr(result, name)[i], getattr(expected, name), atol=1e-12
            )
            np.testing.assert_allclose(
                getattr(traced, name)[i], getattr(expected, name), atol=1e-11
            )
    with pytest.raises(sim.MachineError, match="expected one of each a pose"):
        ViaPoints(poses, durations[0], stays)


def test_one_pose_is_minimum_jerk(rng: np.random.Generator):
    end, time, origin = rng.normal(size=3), rng.uniform(0, 3, (9, 1)), rng.normal(size=(9, 3))
    one = ViaPoints(end[None], np.array([2.0]), np.zeros(1)).reference(time, origin)
    other = MinimumJerk(end, 2.0).reference(time, origin)
    for result, expected in zip(
        (one.q, one.qd, one.qdd), (other.q, other.qd, other.qdd), strict=True
    ):
        np.testing.assert_allclose(result, expected, atol=1e-12)


def test_a_sampled_path_is_its_rows_and_holds_the_last(rng: np.random.Generator):
    tables = rng.normal(size=(3, 6, 2))
    path: AbstractPath = SampledPath(*tables, interval=0.002)
    time = 0.002 * np.arange(9)[:, None]
    rows = np.minimum(np.arange(9), 5)
    for at in (time, time + 0.0009):
        result = path.reference(at, np.zeros((9, 2)))
        for values, table in zip((result.q, result.qd, result.qdd), tables, strict=True):
            np.testing.assert_array_equal(values, table[rows])
    traced = jax.jit(path.position)(jnp.asarray(time), jnp.zeros((9, 2)))
    np.testing.assert_array_equal(traced, tables[0][rows])


def test_paths_that_cannot_be_are_refused():
    with pytest.raises(sim.MachineError, match="0 poses, 0 durations and 0 stays"):
        ViaPoints(np.zeros((0, 3)), np.zeros(0), np.zeros(0))
    with pytest.raises(sim.MachineError, match="expected durations above zero"):
        ViaPoints(np.zeros((1, 3)), np.zeros(1), np.zeros(1))
    with pytest.raises(sim.MachineError, match=r"tables of shapes \(4, 2\), \(4, 2\), \(3, 2\)"):
        SampledPath(np.zeros((4, 2)), np.zeros((4, 2)), np.zeros((3, 2)))


def test_minimum_jerk_is_a_rest_to_rest_quintic():
    s = np.linspace(0, 1, 11)
    path = np.polynomial.Polynomial.fit(s, sim.minimum_jerk(s), 5)
    path = path.convert()
    assert path.degree() == 5
    for derivative in (path.deriv(1), path.deriv(2)):
        np.testing.assert_allclose([derivative(0.0), derivative(1.0)], 0.0, atol=1e-9)
    beyond = np.array([-0.5, 0.0, 1.0, 3.0])
    assert sim.minimum_jerk(beyond).tolist() == [0.0, 0.0, 1.0, 1.0]


def test_minimum_jerk_path_runs_straight_from_where_it_begins(rng: np.random.Generator):
    origin, end = rng.normal(size=(4, 3)), rng.normal(size=3)
    path = MinimumJerk(end, 2.0)
    at = [path.position(np.full((4, 1), time), origin) for time in (0.0, 1.0, 2.0, 5.0)]
    for result, expected in zip(at, [origin, (origin + end) / 2, end, end], strict=True):
        np.testing.assert_allclose(result, np.broadcast_to(expected, (4, 3)), atol=1e-15)


def test_oscillation_begins_at_rest_and_has_its_mean():
    mean, amplitude, period = np.array([0.3, -1.0]), np.array([0.2, 0.0]), 0.8
    path = Oscillation(mean, amplitude, period)
    time = np.linspace(0.0, period, 1000, endpoint=False)[:, None]
    positions = path.position(time, np.zeros((1000, 2)))
    np.testing.assert_allclose(positions.mean(0), mean, atol=1e-14)
    np.testing.assert_allclose(positions[0], mean - amplitude)
    np.testing.assert_allclose(positions[500], mean + amplitude)
    # At rest: it leaves with the square of the time, 2 (π / 1000)² of an amplitude a sample.
    np.testing.assert_allclose(positions[1] - positions[0], 2e-5 * amplitude, rtol=0.02)
