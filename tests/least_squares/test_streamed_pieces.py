"""Pieces of streams: whose products are summed, and whose are not."""

import itertools

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxcslc as jc
from jaxcslc.least_squares import JointFactors, _streaming as streaming
from jaxcslc.least_squares._preconditioned import (
    LARGEST_ERROR,
    Products,
    add_up,
    part_of,
    sample_of,
    triangles_of,
    unpacked,
)
from tests.patterns import ORDINARY, Motion, patterns_of


PIECE = 512
# Coefficients of the same rows in another order of sums, in standard errors.
STANDARD_ERRORS = 1e-9


def chunks_of(patterns: jc.Patterns, *lengths: int) -> list[jc.Patterns]:
    stretches = itertools.pairwise([*np.cumsum([0, *lengths]).tolist(), patterns.samples])
    return [jax.tree.map(lambda x, a=a, b=b: x[a:b], patterns) for a, b in stretches]


@pytest.mark.parametrize("still_first", [False, True], ids=["alike", "another motion first"])
@pytest.mark.parametrize("workers", [1, 3])
@pytest.mark.parametrize("compiler", ["cc", ""], ids=["C", "JAX"])
def test_a_stream_is_a_fit_of_all_its_patterns(
    puma: jc.CSLC,
    puma_k: jax.Array,
    exciting_motion: Motion,
    rng: np.random.Generator,
    monkeypatch: pytest.MonkeyPatch,
    compiler: str,
    workers: int,
    *,
    still_first: bool,
) -> None:
    """Whatever the chunks; the first pieces' preconditioner serves later ones, or does not."""
    if compiler == "":
        monkeypatch.setattr(streaming, "host_kernel_of", lambda network: None)
    monkeypatch.setattr(streaming, "_CPU_LENGTH", PIECE)
    monkeypatch.setattr(streaming, "_MOST_PARTS", 2)
    q, qd, qdd = (0.5 * x for x in exciting_motion)
    if still_first:
        for x in (q, qd, qdd):
            x[:600, 2:] = 0.0
    patterns = patterns_of(puma, puma_k, (q, qd, qdd), 0.1 * rng.normal(size=q.shape))
    expected = ORDINARY.fit(puma, patterns)
    chunks = chunks_of(patterns, 100, 30, 0, 1500)
    fit = ORDINARY.fit_stream(puma, chunks, workers=workers)
    error = np.abs(np.asarray(fit.k - expected.k)) / np.asarray(expected.standard_error)
    assert np.max(error) < STANDARD_ERRORS
    assert_allclose(fit.standard_error, expected.standard_error, rtol=1e-9)


def test_sums_of_products_keep_the_bound_of_errors(
    puma: jc.CSLC, puma_k: jax.Array, exciting_motion: Motion, rng: np.random.Generator
) -> None:
    """Of products that `add_up`, and of their sums; few patterns' products do not."""
    patterns = patterns_of(puma, puma_k, exciting_motion, rng.normal(size=(3000, 6)))
    motion = (patterns.q, patterns.qd, patterns.qdd, patterns.torque, np.ones((3000, 6)))
    preconditioner = sample_of(puma, motion)
    total, counts = np.zeros(()), 0
    for start in (0, 700, 1400):
        stretch = tuple(np.asarray(x)[start : start + 700] for x in motion)
        part, served = part_of(puma, stretch, preconditioner)
        assert isinstance(part, Products) and served is preconditioner
        total = total + part.numbers
        counts += 700
    *grams, summed = unpacked(puma, total)
    assert_array_equal(summed, counts)
    assert np.max(triangles_of(preconditioner, grams)[1]) < LARGEST_ERROR
    few = tuple(np.asarray(x)[:20] for x in motion)  # fewer patterns than columns
    part, served = part_of(puma, few, preconditioner)
    assert isinstance(part, JointFactors)
    assert not add_up(preconditioner, [np.full_like(x, np.nan) for x in grams])
