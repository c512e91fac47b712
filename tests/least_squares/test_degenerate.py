"""Recordings that determine little: weights of joints, and columns of nothing but rounding."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.least_squares import regressor_of, residual_weights
from jaxcslc.recordings import joined_patterns
from jaxcslc.uncertainty import fit_recordings
from tests import arms


SAMPLES = 600
STILL = 1e-9
"""A column that is smaller, in an arm of metres and radians a second, is none."""


def patterns_of(
    network: jc.CSLC, rng: np.random.Generator, *, still: tuple[int, ...] = (), noise: float = 0.01
) -> jc.Patterns:
    """Two sines a joint; joints of `still`, from 0, stay where rounding leaves them."""
    n = network.joint_count
    time = np.arange(SAMPLES)[:, None] / 100.0
    q, qd, qdd = np.zeros((3, SAMPLES, n))
    for _ in range(2):
        rate, size = rng.uniform(1.0, 5.0, n), rng.uniform(0.2, 0.5, n)
        angle = rate * time + rng.uniform(0.0, 6.0, n)
        q += size * np.sin(angle)
        qd += size * rate * np.cos(angle)
        qdd -= size * rate**2 * np.sin(angle)
    at = list(still)
    q[:, at] = 0.7 + 1e-16 * rng.normal(size=(SAMPLES, len(at)))
    qd[:, at], qdd[:, at] = 0.0, 0.0
    k = 1.0 + np.arange(network.size) % 3
    torque = np.array(network.torque(k, q, qd, qdd))
    torque += noise * np.std(torque, axis=0) * rng.normal(size=torque.shape)
    everything = np.ones((SAMPLES, n), bool)
    return jc.Patterns(time[:, 0], q, qd, qdd, torque, everything, everything)


class TestWeights:
    """Of joints by residual: no joint is known better than its equations can tell."""

    counts, sizes = np.array([3000.0, 2000.0, 1000.0]), np.array([20.0, 12.0, 5.0])
    torque = np.array([50.0, 20.0, 2.0])

    def test_they_are_the_reciprocals_of_usual_residuals(self) -> None:
        error = np.array([2.0, 0.3, 0.2])
        weights = residual_weights(error, self.counts, self.torque, self.sizes)
        assert_allclose(weights, 1.0 / error, rtol=1e-15)

    @pytest.mark.parametrize("count", [1.0, 5.0])
    def test_a_joint_that_its_coefficients_follow_is_as_noisy_as_others(self, count: float) -> None:
        error, counts = np.array([2.0, 0.8, 5e-17]), np.array([3000.0, 2000.0, count])
        weights = residual_weights(error, counts, self.torque, self.sizes)
        assert_allclose(1.0 / weights, [2.0, 0.8, 0.04 * self.torque[2]], rtol=1e-12)

    def test_what_a_fit_can_hide_of_noise_falls_with_equations(self) -> None:
        error = np.array([2.0, 0.8, 1e-6])
        weights = residual_weights(error, self.counts, self.torque, self.sizes)
        hidden = 1.0 / np.sqrt(self.counts[2] - self.sizes[2] + 1.0)
        assert_allclose(1.0 / weights[2], hidden * 0.04 * self.torque[2], rtol=1e-12)

    def test_no_joint_has_more_equations_than_coefficients(self) -> None:
        weights = residual_weights(np.zeros(3), np.ones(3), self.torque, self.sizes)
        assert_allclose(weights, 1.0 / self.torque, rtol=1e-15)

    def test_a_torque_that_is_always_zero_counts_as_the_noisiest(self) -> None:
        torque = np.array([50.0, 20.0, 0.0])
        weights = residual_weights(np.array([2.0, 0.8, 0.0]), self.counts, torque, self.sizes)
        assert_allclose(weights[2], 0.5)

    def test_nothing_at_all(self) -> None:
        nothing = np.zeros(3)
        assert residual_weights(nothing, nothing, nothing, self.sizes).tolist() == [1.0] * 3
        assert residual_weights(nothing, self.counts, nothing, self.sizes).tolist() == [1.0] * 3

    def test_transformations(self, rng: np.random.Generator) -> None:
        error = rng.uniform(0.0, 0.1, (4, 3)) * self.torque * rng.choice([1.0, 1e-12], (4, 3))
        counts, torque = np.tile(self.counts, (4, 1)), np.tile(self.torque, (4, 1))
        expected = [
            residual_weights(*some, self.sizes) for some in zip(error, counts, torque, strict=True)
        ]
        assert_allclose(residual_weights(error, counts, torque, self.sizes), expected, rtol=1e-14)
        each = lambda error, counts, torque: residual_weights(
            error, counts, torque, jnp.asarray(self.sizes)
        )
        traced = jax.jit(jax.vmap(each))(error, counts, torque)
        assert_allclose(traced, expected, rtol=1e-12)


class TestRounding:
    """Of sums whose terms cancel: their columns count as zero."""

    @pytest.mark.parametrize("still", [(1,), (1, 3, 5), (0, 2, 4, 6)])
    def test_rank_with_joints_that_stand_still(
        self, still: tuple[int, ...], rng: np.random.Generator
    ) -> None:
        network = arms.panda("viscous", "dry")
        patterns = patterns_of(network, rng, still=still)
        fit = jc.LeastSquares(errors="independent").fit(network, patterns)
        # Oracle: columns in their own units, of which none that is not rounding is so small.
        columns = np.asarray(regressor_of(network, patterns)).reshape(-1, network.size)
        lengths = np.linalg.norm(columns, axis=0) / np.sqrt(len(columns))
        left = columns[:, lengths > STILL] / lengths[lengths > STILL]
        assert int(fit.rank) == np.linalg.matrix_rank(left, tol=1e-9 * np.linalg.norm(left))
        assert np.max(np.abs(fit.k)) < 30.0  # of true ones up to 3
        vanish = lengths < STILL
        assert np.any(vanish) and not np.any(np.asarray(fit.determined)[vanish])

    def test_a_follower_that_turns_back_as_far(self, rng: np.random.Generator) -> None:
        """The second link of a parallelogram keeps its direction: all of its speed is rounding."""
        network = arms.planar_arm("viscous", "dry")
        patterns = patterns_of(network, rng)
        q, qd, qdd = (np.array(x) for x in (patterns.q, patterns.qd, patterns.qdd))
        for values, size in ((q, 1e-16), (qd, 1e-14), (qdd, 1e-12)):
            values[:, 1] = -values[:, 0] * (1.0 + size * rng.normal(size=SAMPLES))
        patterns = dataclasses.replace(patterns, q=q, qd=qd, qdd=qdd)
        fit = jc.LeastSquares().fit(network, patterns)
        assert np.max(np.abs(fit.k)) < 1e3 * np.max(np.abs(patterns.torque))

    def test_a_joint_that_moves_in_one_stretch_only(self, rng: np.random.Generator) -> None:
        """Fits without that stretch predict no torque beyond reason."""
        network = arms.planar_arm("viscous", "dry")
        patterns = patterns_of(network, rng, still=(1,))
        moving = patterns_of(network, rng)
        last = slice(500, None)
        for name in ("q", "qd", "qdd", "torque"):
            getattr(patterns, name)[last] = getattr(moving, name)[last]
        fold = np.arange(SAMPLES) // 100
        errors = jc.LeastSquares().held_out_errors(network, patterns, fold)
        assert np.max(np.abs(errors)) < 10.0 * np.max(np.abs(patterns.torque))

    def test_motion_of_all_joints_is_left_as_it_is(self, rng: np.random.Generator) -> None:
        """A vertical axis has columns of gravity that cancel whatever the motion."""
        network = arms.panda("viscous", "dry")
        patterns = patterns_of(network, rng)
        fit = jc.LeastSquares(joint_weights="equal").fit(network, patterns)
        columns = np.asarray(regressor_of(network, patterns)).reshape(-1, network.size)
        expected = np.linalg.lstsq(columns, np.ravel(patterns.torque), rcond=None)[0]
        assert int(fit.rank) == network.size
        assert_allclose(fit.k, expected, rtol=1e-8, atol=1e-9)


def test_friction_of_a_joint_that_often_rests(rng: np.random.Generator) -> None:
    """The sign of its velocity jumps with rounding there, and is no rounding elsewhere."""
    network = arms.panda("viscous", "dry")
    patterns = patterns_of(network, rng)
    qd = np.where(np.arange(SAMPLES)[:, None] % 100 < 60, patterns.qd, 0.0)
    fit = jc.LeastSquares().fit(network, dataclasses.replace(patterns, qd=qd))
    assert np.all(fit.determined)


def test_a_joint_that_hardly_moves_in_one_of_two(rng: np.random.Generator) -> None:
    """Few equations of it count there: they follow any torque, and must not outweigh others."""
    network = arms.planar_arm("viscous", "dry")
    first, second, third = (patterns_of(network, rng) for _ in range(3))
    mask = np.array(second.friction_mask)
    mask[3:, 1] = False
    second = dataclasses.replace(second, friction_mask=mask)
    several = fit_recordings(network, {"first": first, "second": second})
    left = np.asarray(third.torque) - np.asarray(
        network.torque(several.fit.k, third.q, third.qd, third.qdd)
    )
    assert np.all(np.std(left, axis=0) < 0.02 * np.std(third.torque, axis=0))


def test_as_many_equations_as_coefficients_say_nothing_of_errors(rng: np.random.Generator) -> None:
    network = arms.pendulum()
    patterns = jax.tree.map(lambda x: x[: network.size], patterns_of(network, rng))
    fit = jc.LeastSquares(errors="independent").fit(network, patterns)
    assert int(fit.rank) == network.size and np.all(np.isinf(fit.standard_error))


@pytest.mark.parametrize("every", [2, 3])
def test_recordings_at_different_rates_are_filtered_one_by_one(
    every: int, rng: np.random.Generator
) -> None:
    """Oracle: the equations of each, behind each other."""
    network = arms.planar_arm("viscous", "dry")
    first, second = patterns_of(network, rng), patterns_of(network, rng)
    second = jax.tree.map(lambda x: x[::every], second)
    solver = jc.LeastSquares(cutoff=8.0)
    both = solver.equations(network, joined_patterns([first, second]))
    alone = [solver.equations(network, patterns) for patterns in (first, second)]
    for joint, rows in enumerate(both.rows):
        assert_allclose(rows, np.concatenate([part.rows[joint] for part in alone]), rtol=1e-9)
    jitter = dataclasses.replace(first, time=first.time + 1e-3 * rng.normal(size=SAMPLES))
    with pytest.raises(ValueError, match="time is not uniform"):
        solver.equations(network, jitter)
