"""The C code that multiplies columns where it computes them: against NumPy, and without it."""

import shutil

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.least_squares import Preconditioner, host_kernel_of
from tests.patterns import ORDINARY, Motion, patterns_of


needs_compiler = pytest.mark.skipif(
    shutil.which("cc") is None, reason="no C compiler (cc) on this machine"
)
ALL_LAWS = ("viscous", "static", "quadratic", "root", "offset", "spring")


def network_of(name: str) -> jc.CSLC:
    if name == "slide":
        robot = jc.Manipulator.from_modified_dh(
            [(0, 0, 0, 0), (np.pi / 2, 0.3, 0, 0)], kinds="RP", gravity=(0, 0, -9.81)
        )
        return jc.derive(robot.with_friction(*ALL_LAWS), lengths="numeric")
    return jc.derive(getattr(jc, name)(), lengths="auto")


@needs_compiler
@pytest.mark.parametrize("name", ["puma560", "panda", "slide"])
@pytest.mark.parametrize("samples", [1, 300, 4500])
def test_products_are_those_of_the_regressor(
    name: str, samples: int, rng: np.random.Generator
) -> None:
    """By NumPy, from JAX's regressor; of numbers that fill no block, one, and several pieces."""
    network = network_of(name)
    n = network.joint_count
    q, qd, qdd, torque = rng.uniform(-2.0, 2.0, (4, samples, n))
    weight = rng.choice([0.0, 1.0, 0.5], (samples, n))
    kernel = host_kernel_of(network)
    assert kernel is not None
    regressor = np.asarray(jax.jit(network.regressor)(q, qd, qdd))
    rows = [
        np.c_[regressor[:, j, list(support)], torque[:, j]] * weight[:, j, None]
        for j, support in enumerate(network.support)
    ]
    # Pivoted triangles, well conditioned: the order of rows is not that of columns.
    triangles = [np.triu(rng.uniform(1.0, 2.0, (x.shape[1],) * 2)) for x in rows]
    inverses = [x[rng.permutation(len(x))] for x in triangles]
    *products, counts = kernel.products(inverses, q, qd, qdd, torque, weight)
    assert counts.tolist() == np.count_nonzero(weight, axis=0).tolist()
    for product, joint_rows, inverse in zip(products, rows, inverses, strict=True):
        expected = (joint_rows @ inverse).T @ (joint_rows @ inverse)
        assert_allclose(product, expected, atol=1e-12 * max(np.max(np.abs(expected)), 1.0))


@needs_compiler
def test_columns_of_zeros_and_numbers_that_are_not_finite(
    puma: jc.CSLC, rng: np.random.Generator
) -> None:
    kernel = host_kernel_of(puma)
    assert kernel is not None
    q, qd, qdd, torque = rng.uniform(-2.0, 2.0, (4, 50, 6))
    motion = q, 0.0 * qd, 0.0 * qdd, 0.0 * torque, np.ones((50, 6))
    identities = [np.eye(size) for size in kernel.sizes]
    still = Preconditioner.from_products(kernel.products(identities, *motion)[:-1])
    assert all(np.all(np.isfinite(x)) for x in kernel.products(still.inverses, *motion))
    motion[0][20, 1] = np.nan
    assert np.isnan(kernel.products(identities, *motion)[1]).any()


@needs_compiler
def test_a_fit_is_the_same_without_a_compiler(
    puma: jc.CSLC,
    puma_k: jax.Array,
    exciting_motion: Motion,
    rng: np.random.Generator,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    noise = 0.1 * rng.normal(size=(3000, 6))
    patterns = patterns_of(puma, puma_k, exciting_motion, noise)
    compiled = ORDINARY.fit_stream(puma, [patterns])
    monkeypatch.setenv("CC", "")
    assert host_kernel_of(puma) is None
    without = ORDINARY.fit_stream(puma, [patterns])
    error = np.abs(np.asarray(compiled.k) - np.asarray(without.k))
    assert np.max(error / np.asarray(without.standard_error)) < 1e-9
