"""Banded normal equations with a border, by C code and without it, against dense ones."""

import shutil
from typing import Any

import numpy as np
import pytest
import scipy
from numpy.testing import assert_allclose

from jaxcslc.likelihood import (
    JointColumns,
    _banded_solver as _triangle,
    _equation_sums,
    add_equations,
    equation_changes,
    equation_gradients,
    solved,
)


SAMPLES, JOINTS, BORDER = 9, 2, 43  # columns for all parts of rows that registers hold


@pytest.fixture(params=["cc", "numpy"])
def code(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Any:
    """With a compiler, and as without."""
    if request.param == "numpy":
        monkeypatch.setenv("CC", "")
    elif shutil.which("cc") is None:
        pytest.skip("no C compiler (cc) on this machine")


@pytest.fixture(params=[1000, 5], ids=["alone", "in chunks"])
def chunk(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """One thread for all equations, and several, which share samples."""
    monkeypatch.setattr(_equation_sums, "_CHUNK", request.param)


@pytest.mark.usefixtures("code", "chunk")
def test_equations_add_their_squares(rng: np.random.Generator) -> None:
    count, slots = SAMPLES - 2, 3
    # An unknown that is no position is between some samples.
    position = np.arange(SAMPLES)[:, None] * JOINTS + np.arange(JOINTS)
    position[4:] += 1
    weight = rng.uniform(0.5, 1.5, (count, JOINTS))
    by_position = rng.normal(size=(count, JOINTS, slots * JOINTS))
    by_border = rng.normal(size=(count, JOINTS, BORDER))
    by_border[:, 0, 5:14] = by_border[:, 1, 9:24] = 0.0
    size = SAMPLES * JOINTS + 1
    band, mixed = np.zeros((size, slots * JOINTS + 1)), np.zeros((size, BORDER))
    columns = JointColumns.of(by_border)
    add_equations(band, mixed, position, weight, by_position, columns)

    rows = np.zeros((count, JOINTS, size))
    for equation in range(count):
        for slot in range(slots):
            columns = position[equation + slot]
            rows[equation, :, columns] = by_position[
                equation, :, slot * JOINTS : (slot + 1) * JOINTS
            ].T
    weighted = (weight[:, :, None] * rows).reshape(-1, size)
    dense = weighted.T @ rows.reshape(-1, size)
    for below in range(band.shape[1]):
        assert_allclose(band[: size - below, below], np.diag(dense, -below), atol=1e-12)
    assert_allclose(mixed, weighted.T @ by_border.reshape(-1, BORDER), atol=1e-12)


@pytest.mark.usefixtures("code", "chunk")
def test_products_are_those_of_dense_matrices(rng: np.random.Generator) -> None:
    count, slots = SAMPLES - 2, 3
    by_position = rng.normal(size=(count, JOINTS, slots * JOINTS))
    by_border = rng.normal(size=(count, JOINTS, BORDER))
    by_border[:, 0, 5:14] = by_border[:, 1] = 0.0
    rows = np.zeros((count, JOINTS, SAMPLES, JOINTS))
    for equation in range(count):
        for slot in range(slots):
            of_slot = by_position[equation, :, slot * JOINTS : (slot + 1) * JOINTS]
            rows[equation, :, equation + slot] = of_slot
    columns = JointColumns.of(by_border)
    position, border = rng.normal(size=(SAMPLES, JOINTS)), rng.normal(size=BORDER)
    expected = np.einsum("ejsm,sm->ej", rows, position) + by_border @ border
    changes = equation_changes(by_position, columns, position, border)
    assert_allclose(changes, expected, atol=1e-12)
    force = rng.normal(size=(count, JOINTS))
    of_positions, of_border = equation_gradients(by_position, columns, force)
    assert_allclose(of_positions, np.einsum("ej,ejsm->sm", force, rows), atol=1e-12)
    assert_allclose(of_border, np.einsum("ej,ejc->c", force, by_border), atol=1e-12)


@pytest.mark.usefixtures("code")
@pytest.mark.parametrize("long", [1, 1000], ids=["in chunks", "alone"])
@pytest.mark.parametrize("columns", [1, BORDER])
def test_triangles_are_those_of_dense_matrices(
    columns: int, long: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_triangle, "_LONG", long)
    rng = np.random.default_rng(5)
    size, width = 12, 4
    lower = np.tril(np.triu(rng.uniform(0.5, 1.0, (size, size)), 1 - width)) + 2.0 * np.eye(size)
    factor = scipy.linalg.cholesky_banded(
        np.stack([np.append(np.diag(lower @ lower.T, -d), np.zeros(d)) for d in range(width)]),
        lower=True,
    )
    right = rng.normal(size=(size, columns))
    before = right.copy()
    assert_allclose(solved(factor, right), np.linalg.solve(lower, right), atol=1e-12)
    transposed = np.linalg.solve(lower.T, right)
    assert_allclose(solved(factor, right, transposed=True), transposed, atol=1e-12)
    assert_allclose(right, before)


def test_columns_without_zeros_are_those_of_dense_matrices() -> None:
    rng = np.random.default_rng(7)
    dense = rng.normal(size=(50, 3, 8))
    dense[:, 0, 2:5] = dense[:, 1] = dense[:, 2, :6] = 0.0
    columns, flat = JointColumns.of(dense).widened(9), np.zeros((50, 3, 9))
    flat[:, :, :8] = dense
    assert_allclose(columns.dense, flat)
    assert columns.values.shape == (50, 5 + 2)
    vector, factors = rng.normal(size=9), rng.normal(size=(50, 3))
    assert_allclose(columns.times(vector), flat @ vector, atol=1e-12)
    assert_allclose(columns.summed(factors), np.einsum("ej,ejc->c", factors, flat), atol=1e-12)
    square = np.einsum("ej,eja,ejb->ab", factors**2, flat, flat)
    assert_allclose(columns.square(factors**2), square, atol=1e-12)
    some = np.array([7, 0, 3])
    assert_allclose(columns.among(some).dense, flat[:, :, some])
    assert_allclose(columns.scaled(vector).dense, flat * vector)
    equations, joints = np.array([3, 0, 41]), np.array([2, 0, 1])
    assert_allclose(columns.rows(equations, joints), flat[equations, joints])
    same = columns.patterns[:, None] == columns.patterns
    some_joints = (flat != 0.0).any(axis=0).T
    assert_allclose(same, np.all(some_joints[:, None] == some_joints, axis=2))
