"""Sines and cosines of generated C: against those in numbers of 200 bits."""

import shutil
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from jaxcslc.codegen import LONG, SINES_TEXT, CArray, CFunction


mpmath: Any = pytest.importorskip("mpmath")
# In units of the last digit; the polynomials are within 0.6, a rounded value within 0.5.
LARGEST_ERROR = 0.8
SOURCE = """#include <math.h>
#define LANES 4
typedef double lanes __attribute__((vector_size(8 * LANES), aligned(8)));
{sines}
void both(const double* x, double* sines, double* cosines, long length)
{{
    sines_and_cosines(x, sines, cosines, length);
}}
"""
pytestmark = pytest.mark.skipif(
    shutil.which("cc") is None, reason="no C compiler (cc) on this machine"
)


def sines_and_cosines(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    written = CArray("x", written=True)
    both = CFunction(SOURCE.format(sines=SINES_TEXT), "both", (CArray("x"), written, written, LONG))
    sines, cosines = np.empty((2, len(x)))
    both(x, sines, cosines, len(x))
    return sines, cosines


def units(value: float, exact: Any) -> float:
    """Distance from an exact number in units of its last digit."""
    return float(abs(mpmath.mpf(value) - exact) / float(np.spacing(abs(float(exact)))))


def test_values_are_those_of_exact_arithmetic(rng: np.random.Generator) -> None:
    """Of angles of all sizes, and of those nearest to quarter turns, whose sines nearly vanish."""
    turns = np.pi / 2 * np.arange(-100.0, 100.0)
    scale = 10.0 ** rng.uniform(-9.0, 5.99, 800)
    x = np.concatenate([turns, scale * rng.choice([-1.0, 1.0], 800), rng.uniform(-4, 4, 200)])
    sines, cosines = sines_and_cosines(x)
    with mpmath.workprec(200):
        errors = [
            max(units(s, mpmath.sin(mpmath.mpf(a))), units(c, mpmath.cos(mpmath.mpf(a))))
            for a, s, c in zip(x.tolist(), sines.tolist(), cosines.tolist(), strict=True)
        ]
    assert max(errors) < LARGEST_ERROR


def test_numbers_that_are_large_or_not_finite() -> None:
    x = np.array([1e6 + 1.0, -1e22, np.inf, np.nan, 0.0, -0.0, 1.0, 1e-310])
    sines, cosines = sines_and_cosines(x)
    with np.errstate(invalid="ignore"):
        expected = np.sin(x), np.cos(x)
    assert_array_equal(np.isfinite(sines), np.isfinite(expected[0]))
    np.testing.assert_allclose(sines, expected[0], rtol=1e-15)
    np.testing.assert_allclose(cosines, expected[1], rtol=1e-15)
