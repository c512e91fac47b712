"""The equation of motion as a function of positions: derivatives, and steps against dense ones."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.likelihood import (
    MotionEquations,
    Point,
    RowSums,
    Step,
    TorqueRecord,
    _likelihood_fit as _rows,
    eliminated_rows,
)
from jaxcslc.likelihood._blocks import (
    MotionBlock,
    PriorBlock,
    ReadingBlock,
    RestBlock,
    ReversalBlock,
)
from jaxcslc.likelihood._objective import Linear, Objective
from jaxcslc.likelihood._signs import LATEST_TURN, Signs
from tests import arms
from tests.likelihood.traced_equations import TracedEquations


SAMPLES = 12


@pytest.fixture(scope="module")
def arm() -> jc.CSLC:
    """Two joints that swing in a vertical plane, with three laws of friction."""
    return arms.planar_arm("viscous", "dry", "static")


@pytest.fixture(scope="module")
def objective(arm: jc.CSLC) -> tuple[Objective, Point]:
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(0.009, 0.011, SAMPLES))
    q = np.stack([np.sin(22 * time), np.cos(5 * time)], axis=1)
    signs = Signs.of(q, time, np.zeros((SAMPLES - 1, 2), bool), margin=1, modelled=True)
    assert len(signs.samples) == 1
    k = rng.uniform(0.2, 1.0, arm.size)
    border = arm.size + 6
    equations = MotionEquations(arm, np.diff(time))
    record = TorqueRecord((time,), (rng.normal(size=(SAMPLES, 2)),), "held")
    resting = rng.uniform(size=(SAMPLES - 1, 2)) < 0.2
    part = np.repeat([0, 1], [5, SAMPLES - 5])  # encoder offsets of two recordings
    blocks = {
        "torque": MotionBlock(equations, record, signs, rng.uniform(1.0, 2.0, (SAMPLES - 2, 2))),
        "position": ReadingBlock(q + 1e-3, part, rng.uniform(1e4, 2e4, (SAMPLES, 2))),
        "standstill": RestBlock(np.where(resting, 1e4, 0.0)),
        "turn": ReversalBlock(signs.turn, np.full(1, 4.0)),
        "border": PriorBlock(np.zeros(border), rng.uniform(0.1, 1.0, border)),
    }
    result = Objective(blocks, rng.uniform(0.5, 2, border))
    values = {"k": k, "slopes": np.log([2.0, 3.0]), "offset": np.zeros((2, 2))}
    return result, Point.of(values, q, signs.turn)


def test_derivatives(objective: tuple[Objective, Point]) -> None:
    problem, point = objective
    motion = problem.motion
    turns, direction = motion.signs.turns(point.turn), motion.signs.direction
    network, intervals = motion.equations.network, motion.equations.intervals
    traced = TracedEquations(network)
    linear = motion.equations.linearised(motion.at(point))

    def torque(k: jax.Array, slopes: jax.Array, q: jax.Array, turns: jax.Array) -> jax.Array:
        return traced._torque(intervals, k, slopes, q, turns, direction)

    by_k, by_slopes, by_q, by_turns = jax.jacfwd(torque, (0, 1, 2, 3))(
        jnp.asarray(point.k), jnp.asarray(point.slopes), jnp.asarray(point.q), jnp.asarray(turns)
    )
    p = len(point.k)
    by_coefficient = linear.by_coefficient.dense
    assert_allclose(by_coefficient[:, :, :p], by_k, atol=1e-9)
    assert_allclose(by_coefficient[:, :, p:], by_slopes, atol=1e-9)
    for row in range(SAMPLES - 2):
        stencil = np.asarray(by_q[row, :, row : row + 3]).reshape(2, 6)
        assert_allclose(linear.by_position[row], stencil, rtol=1e-6, atol=1e-4)
        assert_allclose(linear.by_turn[row], np.diag(by_turns[row, :, row]), atol=1e-9)
    product = by_coefficient[:, :, :p] @ point.k
    assert_allclose(product, linear.torque, atol=1e-10)


def test_a_step_is_that_of_dense_equations(objective: tuple[Objective, Point]) -> None:
    problem, point = objective
    linear = Linear.of(problem, point)
    step = linear.step(linear.factored(0.0), linear.residuals)

    # A dense regression of all residuals on all unknowns, columns from unit steps.
    zero = linear.zeros()
    unknowns = [np.size(x) for x in (step.border, step.position, step.turn)]
    columns = []
    for index in range(sum(unknowns)):
        unit = np.split(np.eye(sum(unknowns))[index], np.cumsum(unknowns)[:-1])
        change = Step(unit[0], unit[1].reshape(SAMPLES, 2), unit[2])
        after = linear.after(change, zero)
        columns.append(np.concatenate([-np.ravel(x) for x in after.values()]))
    root = np.concatenate([np.sqrt(np.ravel(x)) for x in problem.weights.values()])
    target = np.concatenate([np.ravel(x) for x in linear.residuals.values()])
    dense = np.linalg.lstsq(np.stack(columns, axis=1) * root[:, None], target * root)[0]
    obtained = np.concatenate([np.ravel(x) for x in (step.border, step.position, step.turn)])
    # Normal equations of second differences lose half of the digits.
    assert_allclose(obtained, dense, rtol=5e-5, atol=1e-6)


def test_rows_without_positions_make_up_the_information(
    objective: tuple[Objective, Point], monkeypatch: pytest.MonkeyPatch
) -> None:
    problem, point = objective
    others = {
        name: dataclasses.replace(block, weight=np.zeros_like(block.weight))  # type: ignore[type-var]
        for name, block in problem.blocks.items()
        if name not in ("torque", "position")
    }
    linear = Linear.of(problem.with_blocks(**others), point)
    factored = linear.factored(0.0)
    rows, scores = eliminated_rows(linear, factored, slice(0, SAMPLES))
    information = np.einsum("srb,src->bc", rows, rows)
    # Stretch by stretch they are the same.
    monkeypatch.setattr(_rows, "_STRETCHES", 7)
    sums = RowSums.of(linear, factored)
    assert_allclose(sums.scores, scores, atol=1e-9 * np.abs(scores).max())
    assert sums.grams.shape[0] == sums.middles.size == 7
    assert_allclose(sums.grams.sum(axis=0), information, rtol=1e-9)
    assert_allclose(sums.noise, information, rtol=1e-9)  # no count is an interval
    assert_allclose(sums.middles.mean(), (SAMPLES - 1) / 2, atol=0.5)
    # Normal equations of second differences lose half of the digits.
    size = np.abs(information).max()
    assert_allclose(information, factored.information, atol=1e-6 * size)
    step = linear.step(factored, linear.residuals)
    assert_allclose(information @ step.border, scores.sum(axis=0), atol=1e-5 * size)


def test_linear_residuals_are_those_of_a_small_step(objective: tuple[Objective, Point]) -> None:
    problem, point = objective
    linear = Linear.of(problem, point)
    rng = np.random.default_rng(1)
    size = 1e-6
    step = Step(
        size * rng.normal(size=len(problem.scale)),
        1e-3 * size * rng.normal(size=point.q.shape),
        size * rng.normal(size=1),
    )
    predicted = linear.after(step, linear.residuals)
    actual = problem.residuals(problem.moved(point, step))
    for name, values in actual.items():
        assert_allclose(predicted[name], values, atol=1e-9)


def test_fixed_unknowns_of_the_border_stay(objective: tuple[Objective, Point]) -> None:
    problem, point = objective
    fixed = np.arange(len(problem.scale)) % 3 == 0
    fixed[-1] = True  # an offset, too
    linear = Linear.of(
        dataclasses.replace(problem, scale=np.where(fixed, 0.0, problem.scale)), point
    )
    factored = linear.factored(0.0)
    step = linear.step(factored, linear.residuals)
    assert np.all(step.border[fixed] == 0.0)
    assert np.all(step.border[~fixed] != 0.0)
    # Among the others it is a minimum: from there, no step leads further down.
    further = linear.step(factored, linear.after(step, linear.residuals))
    assert_allclose(further.border, 0.0, atol=1e-7 * np.abs(step.border).max())
    assert_allclose(further.position, 0.0, atol=1e-7 * np.abs(step.position).max())
    # What is not looked at is known exactly: the information is a part of that of all.
    whole = Linear.of(problem, point).factored(0.0).information
    expected = np.where(fixed[:, None] | fixed, 0.0, whole)
    assert_allclose(factored.information, expected, atol=1e-9 * np.abs(whole).max())
    assert np.all(factored.eliminated[:, fixed] == 0.0)


@pytest.mark.parametrize("bound", [-LATEST_TURN, LATEST_TURN])
def test_moments_of_reversals_stay_within_bounds(
    objective: tuple[Objective, Point], bound: float
) -> None:
    # What is expected of the moment draws it, more than torque does.
    problem, point = objective
    at_bound = dataclasses.replace(point, turn=np.array([bound]))
    for outwards in (True, False):
        expected = bound + (1e6 if outwards else -1e6) * np.sign(bound)
        drawn = ReversalBlock(np.array([expected]), problem.weights["turn"])
        linear = Linear.of(problem.with_blocks(turn=drawn), at_bound)
        step = linear.step(linear.factored(0.0), linear.residuals)
        if outwards:
            assert_allclose(step.turn, 0.0, atol=1e-12)
        else:
            assert np.sign(step.turn[0]) == -np.sign(bound)
