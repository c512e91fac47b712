"""The one rule of rank, and the inverse by it."""

import numpy as np
import pytest

from jaxcslc._rank import null_vectors, numerical_rank, pseudo_inverse
from jaxcslc.likelihood import Spectrum


@pytest.mark.parametrize("rank", [1, 3, 5])
@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_inverse_solves_least_squares_in_any_units(
    rank: int, unit: float, rng: np.random.Generator
) -> None:
    matrix = rng.normal(size=(40, rank)) @ rng.normal(size=(rank, 5))
    units = unit ** np.arange(5)
    assert numerical_rank(matrix * units) == rank
    target = rng.normal(size=40)
    solution = pseudo_inverse(matrix * units) @ target
    explained = matrix @ np.linalg.lstsq(matrix, target)[0]
    np.testing.assert_allclose((matrix * units) @ solution, explained, atol=1e-9)
    null = null_vectors(matrix * units)
    assert null.shape == (5 - rank, 5)
    np.testing.assert_allclose((matrix * units) @ null.T, 0.0, atol=1e-9)
    # Of all such solutions it is the shortest, with columns of unit length.
    lengths = np.linalg.norm(matrix * units, axis=0)
    null = np.linalg.svd(matrix * units / lengths)[2][rank:]
    np.testing.assert_allclose(null @ (lengths * solution), 0.0, atol=1e-9)


def test_spectrum_of_an_information_matrix(rng: np.random.Generator) -> None:
    """Unknowns 0 and 1 appear only as their sum, unknown 2 not at all."""
    rows = rng.normal(size=(30, 5)) * [1.0, 1.0, 0.0, 1e6, 1e-6]
    rows[:, 1] = rows[:, 0]
    spectrum = Spectrum.of(rows.T @ rows)
    assert spectrum.fixed.tolist() == [False, False, True, False, False]
    (null,) = spectrum.undetermined
    np.testing.assert_allclose(np.abs(null), [0.5**0.5, 0.5**0.5, 0, 0, 0], atol=1e-7)
    assert null[0] * null[1] < 0.0
    others = np.ix_([3, 4], [3, 4])
    kept = rows[:, [0, 3, 4]]
    expected = np.linalg.inv(kept.T @ kept)
    np.testing.assert_allclose(spectrum.covariance[others], expected[1:, 1:], rtol=1e-6)
