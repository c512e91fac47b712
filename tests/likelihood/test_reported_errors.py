"""Which errors are reported: the bound of white residuals, or the sandwich of correlated ones."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from jaxcslc.likelihood import RowSums
from jaxcslc.likelihood._likelihood_fit import Whiteness, cosine_sums


COMPONENTS, SAMPLES, COLUMNS = 12, 600, 8
USED = (np.arange(32) < COMPONENTS).astype(float)


def whiteness_of(noise: np.ndarray) -> Whiteness:
    """Of a regression with this noise in two equations at each time."""
    rows = np.random.default_rng(0).normal(size=(SAMPLES, 2, COLUMNS))
    gram = np.einsum("trb,trc->bc", rows, rows)
    inverse = np.linalg.inv(gram)
    fit = inverse @ np.einsum("trb,tr->b", rows, noise)
    scores = np.einsum("trb,tr->tb", rows, noise - rows @ fit)
    grams = np.einsum("trb,trc->tbc", rows, rows)
    sums = cosine_sums(RowSums(scores, grams, np.arange(float(SAMPLES)), gram), USED)
    return Whiteness.of(sums, inverse, gram, COMPONENTS)


def test_white_noise_is_seldom_rejected() -> None:
    """Its ratio is one with the scatter of a chi-squared variable."""
    rng = np.random.default_rng(1)
    all_of_noise = [whiteness_of(rng.normal(size=(SAMPLES, 2))) for _ in range(400)]
    ratios = np.array([one.ratio for one in all_of_noise])
    degrees = all_of_noise[0].degrees_of_freedom
    assert_allclose(degrees, COMPONENTS * COLUMNS, rtol=0.02)
    assert_allclose(ratios.mean(), 1.0, atol=4 * np.sqrt(2 / degrees / len(ratios)))
    assert_allclose(ratios.std(), np.sqrt(2 / degrees), rtol=0.15)
    assert 0.01 < np.mean([not one.white() for one in all_of_noise]) < 0.10


@pytest.mark.parametrize("size", [1.3, 2.0])
def test_larger_noise_is_rejected(size: float) -> None:
    rng = np.random.default_rng(2)
    rejected = [not whiteness_of(size * rng.normal(size=(SAMPLES, 2))).white() for _ in range(20)]
    assert np.mean(rejected) >= 0.9


def test_one_coefficient_among_many() -> None:
    """Chance exceeds the limit of a single one as seldom as that says."""
    rng = np.random.default_rng(3)
    ratio = rng.chisquare(COMPONENTS, 4000) / COMPONENTS
    test = Whiteness(COMPONENTS, 1.0, 100.0)
    assert_allclose(np.mean(test.exceeds(ratio)), 0.05, atol=0.015)
