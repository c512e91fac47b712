"""The kernel that multiplies columns where it computes them: what of it runs without a GPU."""

import shutil
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.codegen import (
    CArray,
    CFunction,
    KernelText,
    Motion as Symbols,
    Operation,
    kernels_run,
)
from jaxcslc.least_squares import (
    Preconditioner,
    dense_factors,
    factors_of,
    fused_gram_matrices,
    fused_kernel_of,
    gram_kernel,
    packed_inverses,
    unpacked_products,
)
from tests.patterns import ORDINARY, Motion, patterns_of


SIZES = (11, 5, 16)


def test_tiles_are_those_of_the_products(rng: np.random.Generator) -> None:
    """The kernel's loops over tiles, by NumPy: rows by pivots, a triangle, products, 8 x 8 each."""
    rows = [rng.normal(size=(100, size)) * np.logspace(0, 3, size) for size in SIZES]
    inverses = Preconditioner.from_rows(rows).inverses
    of_kernel = packed_inverses(SIZES, [jnp.asarray(inverse) for inverse in inverses])
    packed, row_of = (np.asarray(x) for x in of_kernel)
    tiles: list[np.ndarray] = []
    first, base = 0, 0
    for size, joint_rows in zip(SIZES, rows, strict=True):
        high = -(-size // 8)
        memory = np.zeros((8 * high, 100))
        memory[row_of[base : base + size] - base] = joint_rows.T
        y = np.zeros((high, 8, 100))
        for i in range(high):
            for k in range(2 * i + 2):
                piece = packed[first + (i * (i + 1) + k) * 32 :][:32].reshape(8, 4)
                y[i] += piece @ memory[4 * k : 4 * k + 4]
        tiles += [y[i] @ y[j].T for i in range(high) for j in range(i + 1)]
        first, base = first + 32 * high * (high + 1), base + size
    products = unpacked_products(SIZES, jnp.asarray(np.array(tiles)))
    for product, joint_rows, inverse in zip(products, rows, inverses, strict=True):
        transformed = joint_rows @ inverse
        np.testing.assert_allclose(product, transformed.T @ transformed, atol=1e-13)


def statements_in_c(network: jc.CSLC) -> Any:
    """The columns' statements as a C function of one sample."""
    motion = Symbols(network.joint_count)
    entries = list(network.column_entries(motion))

    def reading(operation: Operation) -> str | None:
        return operation.text if operation.name == "input" else None

    outputs = [(value, f"out[{i}] = {{0}};") for i, (_, _, value) in enumerate(entries)]
    lines = KernelText(motion.graph, reading).statements(outputs)
    arguments = "const real *q, const real *qd, const real *qdd, real *out"
    source = "\n".join(
        [
            "#include <math.h>",
            "typedef double real;",
            f"void columns({arguments})",
            "{",
            *lines,
            "}",
        ]
    )
    kinds = (*(CArray("joints"),) * 3, CArray("entries", written=True))
    return CFunction(source, "columns", kinds), entries


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler (cc) on this machine")
@pytest.mark.parametrize("name", ["puma560", "panda"])
def test_statements_compute_the_columns(name: str, rng: np.random.Generator) -> None:
    friction = ("viscous", "dry", "offset", "spring")
    robot = getattr(jc, name)().with_friction(*friction)
    network = jc.derive(robot, lengths="auto")
    function, entries = statements_in_c(network)
    q, qd, qdd = rng.uniform(-3, 3, (3, network.joint_count, 1))
    out = np.empty(len(entries))
    function(q[:, 0], qd[:, 0], qdd[:, 0], out)
    columns = [np.zeros(network.size) for _ in network.support]
    for (joint, index, _), value in zip(entries, out, strict=True):
        columns[joint][index] += value
    for joint, (row, values) in enumerate(
        zip(network.support, network.columns(q, qd, qdd), strict=True)
    ):
        np.testing.assert_allclose(columns[joint][list(row)], np.ravel(values), atol=1e-11)


def test_the_kernel_fits_a_multiprocessor(puma: jc.CSLC) -> None:
    kernel = gram_kernel(puma)
    assert kernel.sizes == tuple(len(row) + 1 for row in puma.support)
    assert kernel.kernel.shared_bytes * kernel.resident <= 227 * 1024
    # Every row of columns is written once, whichever warp computes it.
    rows = [kernel.kernel.source.count(f"row_of[{row}]") for row in range(sum(kernel.sizes))]
    assert set(rows) == {1}


def test_there_is_a_kernel_where_it_runs(puma: jc.CSLC) -> None:
    assert (fused_kernel_of(puma) is not None) == kernels_run()


def test_factors_behind_the_kernel_without_a_gpu(
    puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All but the kernel's own products, which JAX computes; oracle: reflections."""

    def products(kernel: Any, inverses: Any, *motion: jax.Array) -> Any:
        q, qd, qdd, torque, weight = (x.T for x in motion)
        joints = zip(puma.columns(q, qd, qdd), torque, weight, inverses, strict=True)
        rows = (
            (jnp.concatenate([columns, right[None]]) * factor[None]).T @ inverse
            for columns, right, factor, inverse in joints
        )
        return tuple(x.T @ x for x in rows)

    monkeypatch.setattr("jaxcslc.least_squares._gpu_kernel.fused_gram_matrices", products)
    noise = np.random.default_rng(0).normal(size=exciting_motion[0].shape)
    patterns = patterns_of(puma, puma_k, exciting_motion, noise)
    mask = np.asarray(patterns.mask)
    motion = (*exciting_motion, np.asarray(patterns.torque), mask)
    factors, _ = factors_of(puma, tuple(map(jnp.asarray, motion)), gram_kernel(puma))
    expected = dense_factors(puma, patterns)
    assert np.array_equal(factors.counts, expected.counts)
    for mine, theirs in zip(factors.triangles, expected.triangles, strict=True):
        np.testing.assert_allclose(mine.T @ mine, theirs.T @ theirs, rtol=1e-9, atol=1e-9)


@pytest.mark.gpu
@pytest.mark.parametrize("samples", [1, 33, 5000])
@pytest.mark.parametrize("name", ["puma560", "panda"])
def test_the_kernel_multiplies_the_columns(
    name: str, samples: int, rng: np.random.Generator
) -> None:
    """Oracle: columns computed and multiplied by NumPy, behind the same preconditioner."""
    robot = getattr(jc, name)().with_friction("viscous", "dry", "offset")
    network = jc.derive(robot, lengths="auto")
    n = network.joint_count
    q, qd, qdd, torque = rng.uniform(-3, 3, (4, samples, n))
    weight = np.where(rng.uniform(size=(samples, n)) < 0.1, 0.0, rng.uniform(0.5, 2.0, n))
    rows = [
        np.concatenate([columns, right[None]]) * factor
        for columns, right, factor in zip(
            network.columns(q.T, qd.T, qdd.T), torque.T, weight.T, strict=True
        )
    ]
    some = [x + rng.normal(size=(len(x), 100)) for x in (r[:, :1] for r in rows)]
    inverses = Preconditioner.from_rows([x.T for x in some]).inverses
    kernel = fused_kernel_of(network)
    assert kernel is not None
    motion = [jnp.asarray(x) for x in (q, qd, qdd, torque, weight)]
    products = jax.jit(lambda *motion: fused_gram_matrices(kernel, inverses, *motion))(*motion)
    for product, joint_rows, inverse in zip(products, rows, inverses, strict=True):
        transformed = inverse.T @ joint_rows
        expected = transformed @ transformed.T
        np.testing.assert_allclose(product, expected, atol=1e-12 * np.max(np.abs(expected)))


@pytest.mark.gpu
def test_a_fit_on_a_gpu_is_that_of_the_processor(
    puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion
) -> None:
    noise = np.random.default_rng(0).normal(size=exciting_motion[0].shape)
    patterns = patterns_of(puma, puma_k, exciting_motion, noise)
    expected = ORDINARY.fit(puma, jax.tree.map(np.asarray, patterns))
    twice = jax.tree.map(lambda x: jnp.concatenate([jnp.asarray(x)] * 2), patterns)
    fit = ORDINARY.fit(puma, twice)
    # Twice the same patterns: the same coefficients.
    error = np.abs(np.asarray(fit.k) - np.asarray(expected.k)) / np.asarray(expected.standard_error)
    assert np.max(error) < 1e-9
    assert int(fit.rank) == int(expected.rank)
