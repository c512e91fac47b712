"""Blocks of streams: behind a preconditioner that serves them, or does not."""

import itertools

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.least_squares import _blocks
from tests.patterns import ORDINARY, Motion, patterns_of


PIECE = 512
# Coefficients of the same rows in another order of sums, in standard errors.
STANDARD_ERRORS = 1e-9


def chunks_of(patterns: jc.Patterns, *lengths: int) -> list[jc.Patterns]:
    stretches = itertools.pairwise([*np.cumsum([0, *lengths]).tolist(), patterns.samples])
    return [jax.tree.map(lambda x, a=a, b=b: x[a:b], patterns) for a, b in stretches]


@pytest.mark.parametrize("still_first", [False, True], ids=["alike", "another motion first"])
@pytest.mark.parametrize("workers", [1, 3])
@pytest.mark.parametrize("compiler", ["cc", ""], ids=["C", "NumPy"])
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
        monkeypatch.setattr(_blocks, "kernel_of", lambda *_: None)
    monkeypatch.setattr(_blocks, "_CPU_LENGTH", PIECE)
    monkeypatch.setattr(_blocks, "_MOST_PARTS", 2)
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
