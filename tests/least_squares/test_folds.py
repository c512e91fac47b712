"""Fits to all folds but one, against fits of the other equations."""

from typing import Literal

import jax.numpy as jnp
import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.least_squares import triangle_of
from jaxcslc.least_squares._fold_products import FoldProducts
from tests import arms


INTERVAL = 0.002


def test_triangle_keeps_the_products_of_columns(rng: np.random.Generator):
    for rows in (1, 3, 40, 5000):
        batch = rng.normal(size=(2, rows, 7))
        triangle = triangle_of(batch)
        assert triangle.shape == (2, 7, 7)
        np.testing.assert_allclose(
            np.swapaxes(triangle, 1, 2) @ triangle, np.swapaxes(batch, 1, 2) @ batch, atol=1e-9
        )


@pytest.mark.parametrize("weights", ["equal", "residual"])
@pytest.mark.parametrize("cutoff", [None, 8.0])
def test_leaving_a_fold_out_of_triangles_is_leaving_it_out_of_the_patterns(
    weights: Literal["equal", "residual"], cutoff: float | None, rng: np.random.Generator
):
    network = jc.derive(jc.puma560())
    robot = jc.puma560()
    assert robot.links is not None
    true = network.coefficients_from(robot.links, viscous=robot.viscous, dry=robot.dry)
    samples, folds = 1200, 3
    q, qd, qdd = rng.normal(size=(3, samples, 6))
    noise = np.array([3.0, 2.0, 1.0, 0.3, 0.2, 0.1])
    torque = np.asarray(network.torque(true, q, qd, qdd)) + noise * rng.normal(size=q.shape)
    counts = rng.uniform(size=q.shape) < 0.8
    time = np.arange(samples) * INTERVAL
    patterns = jc.Patterns(time, q, qd, qdd, torque, np.ones_like(counts), counts)
    fold = np.arange(samples) // (samples // folds)
    solver = jc.LeastSquares(joint_weights=weights, errors="independent", cutoff=cutoff)
    equations = solver.equations(network, patterns)
    k = solver.fit_folds(network, patterns, fold)
    for number in range(folds):
        others = equations.selected(fold != number)
        oracle = solver.fit_equations(others, samples)
        np.testing.assert_allclose(k[number], oracle.k, rtol=1e-8, atol=1e-8)

    errors = solver.held_out_errors(network, patterns, fold)
    for number in range(folds):
        left_out = fold == number
        predicted = network.torque(jnp.asarray(k[number]), q[left_out], qd[left_out], qdd[left_out])
        np.testing.assert_allclose(errors[left_out], torque[left_out] - predicted, atol=1e-9)


@pytest.mark.parametrize("case", ["noise", "exact torque", "still joint"])
def test_folds_that_determine_everything_or_not(case: str, rng: np.random.Generator):
    network = arms.panda("viscous")
    samples = 600
    q, qd, qdd = rng.normal(size=(3, samples, 7))
    if case == "still joint":
        q[:, 2:], qd[:, 2:], qdd[:, 2:] = 0.5, 0.0, 0.0
    torque = np.asarray(network.torque(rng.normal(size=network.size), q, qd, qdd))
    torque = torque + (case != "exact torque") * rng.normal(size=q.shape)
    everything = np.ones(q.shape, bool)
    patterns = jc.Patterns(
        np.arange(samples) * INTERVAL, q, qd, qdd, torque, everything, everything
    )
    fold = np.arange(samples) // 200
    solver = jc.LeastSquares(errors="independent")
    equations = solver.equations(network, patterns)
    oracle = [solver.coefficients(equations.selected(fold != number)) for number in range(3)]
    np.testing.assert_allclose(solver.fit_folds(network, patterns, fold), oracle, atol=1e-7)
    # Products tell neither a residual of rounding nor what is not determined.
    by_products = FoldProducts.of(equations, fold).coefficients("residual", None)
    assert (by_products is not None) == (case == "noise")
