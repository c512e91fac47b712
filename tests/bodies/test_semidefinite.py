"""Least squares over bodies by Clarabel's cones are those that CVXPY states and solves."""

from typing import Any

import numpy as np
import pytest

from jaxcslc.bodies._nearest_bodies import semidefinite_least_squares


cp: Any = pytest.importorskip("cvxpy")

# Interior-point methods end at 1e-8 of the objective, which is its root of the unknowns.
SOLVERS = 1e-4
BODIES, LEAST = 2, 0.05
BOUNDED = np.array([1.0, 0.0, 1.0])


@pytest.mark.parametrize("with_bounds", [False, True])
def test_the_optimum_is_that_of_an_independent_statement(
    with_bounds: bool, rng: np.random.Generator
) -> None:
    """Two bodies, numbers of which some are bounded, an equation, and linear inequalities."""
    size = 16 * BODIES + len(BOUNDED)
    matrix, target = rng.normal(size=(60, size)), 3.0 * rng.normal(size=60)
    rows, values = rng.normal(size=(1, size)), np.array([2.0])
    above, limits = rng.normal(size=(3, size)), np.array([0.5, 1.0, -0.2])
    x, solved = semidefinite_least_squares(
        matrix,
        target,
        rows,
        values,
        bodies=BODIES,
        bounded=BOUNDED,
        least=LEAST,
        above=above if with_bounds else None,
        limits=limits if with_bounds else None,
    )
    assert solved and x is not None

    blocks = [cp.Variable((4, 4), symmetric=True) for _ in range(BODIES)]
    others = cp.Variable(len(BOUNDED))
    whole = cp.hstack([*(cp.reshape(block, (16,), order="C") for block in blocks), others])
    constraints = [block >> LEAST * np.eye(4) for block in blocks]
    constraints += [others[BOUNDED > 0] >= 0, rows @ whole == values]
    if with_bounds:
        constraints.append(above @ whole >= limits)
    problem = cp.Problem(cp.Minimize(cp.sum_squares(matrix @ whole - target)), constraints)
    problem.solve(solver=cp.CLARABEL)
    np.testing.assert_allclose(x, whole.value, atol=SOLVERS)
    # A body and a bound are at their limits: the cones were needed.
    lowest = np.linalg.eigvalsh(x[: 16 * BODIES].reshape(-1, 4, 4)).min()
    assert lowest == pytest.approx(LEAST, abs=SOLVERS)


def test_no_body_meets_a_contradiction(rng: np.random.Generator) -> None:
    matrix, nothing = rng.normal(size=(20, 16)), np.zeros((0, 16))
    trace = np.eye(4).reshape(1, 16)
    x, solved = semidefinite_least_squares(
        matrix,
        np.ones(20),
        nothing,
        np.zeros(0),
        bodies=1,
        bounded=np.zeros(0),
        least=0.0,
        above=-trace,
        limits=np.array([1.0]),  # a trace of -1 at most, of no negative eigenvalue
    )
    assert x is None and not solved
