"""Products of columns times cosines of time, from moments of blocks."""

import numpy as np

from jaxcslc.least_squares._errors import cosine_grams


def test_moments_of_blocks_give_the_products_with_all_cosines(rng: np.random.Generator):
    instants, components = 5000, 32
    phase = np.sort(rng.uniform(size=instants))  # with gaps, as masks leave them
    rows, weight = rng.normal(size=(instants, 6)), rng.uniform(size=instants)
    number = np.arange(1, components + 1)[:, None]
    cosines = np.sqrt(2.0) * np.cos(np.pi * number * phase)
    expected = np.einsum("ct,t,ti,tj->cij", cosines, weight, rows, rows, optimize=True)
    grams = cosine_grams(rows.T, weight, phase, components)
    # Interpolated to 2e-10; sums of 5,000 terms.
    np.testing.assert_allclose(grams, expected, atol=2e-10 * instants)
