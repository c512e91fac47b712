"""Two machines of one design: differences, their errors, and what they mean for the torque."""

from typing import Any

import equinox as eqx
import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from scripts.studies.puma560.agreement import agreement


@pytest.fixture(scope="session")
def exciting(puma: jc.CSLC) -> tuple[np.ndarray, np.ndarray]:
    """Positions, velocities and accelerations (3, 600, 6), and noise of 20 recordings."""
    rng = np.random.default_rng(3)
    return rng.uniform(-2, 2, (3, 600, 6)), rng.normal(size=(20, 600, 6))


def fit_of(puma: jc.CSLC, k: jax.Array, motion: np.ndarray, noise: np.ndarray) -> jc.Identification:
    everything = np.ones(noise.shape, bool)
    q, qd, qdd = motion
    torque = np.asarray(puma.torque(k, q, qd, qdd)) + noise
    patterns = jc.Patterns(np.arange(600.0), q, qd, qdd, torque, everything, everything)
    return jc.LeastSquares(joint_weights="equal", errors="independent").fit(puma, patterns)


@pytest.fixture(scope="session")
def fits(
    puma: jc.CSLC, puma_k: jax.Array, exciting: tuple[np.ndarray, np.ndarray]
) -> tuple[jc.Identification, jc.Identification]:
    motion, noise = exciting
    return (
        fit_of(puma, puma_k, motion, noise[0]),
        fit_of(puma, 1.1 * puma_k, motion, noise[1]),
    )


def test_identities(
    puma: jc.CSLC,
    puma_k: jax.Array,
    fits: tuple[jc.Identification, jc.Identification],
    rng: np.random.Generator,
) -> None:
    first, second = fits
    sensitivity = rng.uniform(0.1, 10, puma.size)
    result = agreement(puma, *fits, sensitivity=sensitivity, truth=(puma_k, 1.1 * puma_k))
    difference = np.asarray(second.k - first.k)
    error = np.sqrt(np.asarray(first.standard_error) ** 2 + np.asarray(second.standard_error) ** 2)
    assert_allclose(result.difference, difference)
    assert_allclose(result.standard_error, error)
    assert_allclose(result.z, (difference - 0.1 * np.asarray(puma_k)) / error, atol=1e-9)
    assert_allclose(result.product, np.abs(difference) * sensitivity)
    gravity = puma.layout.indices("gravity")
    assert_allclose(result.largest_product["gravity"], np.max(result.product[gravity]))
    row = result.rows()[4]
    assert row["name"] == "kM5"
    assert row["product"] == result.product[4]
    assert "true_difference" in row
    assert result.share_within(2.0, "gravity") == np.mean(np.abs(result.z[gravity]) <= 2)


def test_without_truth_no_difference_is_expected(
    puma: jc.CSLC, fits: tuple[jc.Identification, jc.Identification]
) -> None:
    result = agreement(puma, *fits, sensitivity=np.ones(puma.size))
    assert_allclose(result.z, result.difference / result.standard_error)
    assert "true_difference" not in result.rows()[0]
    # Friction, gravity and inertias that are a tenth larger show.
    assert result.share_within(2.0, "gravity") < 1.0


def test_normal_errors_are_covered_as_often_as_they_should(
    puma: jc.CSLC, puma_k: jax.Array, exciting: tuple[np.ndarray, np.ndarray]
) -> None:
    """Ten independent pairs of one machine: 430 values of z, 68 % within 1 and 95 % within 2."""
    motion, noise = exciting
    fits = [fit_of(puma, puma_k, motion, draw) for draw in noise]
    ones = np.ones(puma.size)
    z = np.array(
        [
            agreement(puma, first, second, sensitivity=ones).z
            for first, second in zip(fits[::2], fits[1::2], strict=True)
        ]
    )
    # Four standard deviations of a share of 430, were the coefficients independent.
    assert_allclose(np.mean(np.abs(z) < 1), 0.683, atol=0.09)
    assert_allclose(np.mean(np.abs(z) < 2), 0.954, atol=0.04)


def test_undetermined_coefficients_are_left_out(
    puma: jc.CSLC, fits: tuple[jc.Identification, jc.Identification]
) -> None:
    first, second = fits
    blind = eqx.tree_at(
        lambda fit: fit.standard_error, first, first.standard_error.at[:42].set(np.inf)
    )
    result = agreement(puma, blind, second, sensitivity=np.ones(puma.size))
    assert np.flatnonzero(np.isfinite(result.z)).tolist() == [42]
    assert result.share_within(np.inf) == 1.0
    assert np.isnan(result.share_within(1.0, "mass"))


def test_thesis_s_products(
    puma: jc.CSLC, fits: tuple[jc.Identification, jc.Identification], appendix_b: Any
) -> None:
    """Appendix B's values bear out 7.6's 0.3 N m for gravity, and not its 0.001 for mass."""
    values = appendix_b["values"]
    a, b = (
        np.array([*values[machine]["kM"], *values[machine]["kG"], *[0.0] * 12])
        for machine in ("puma_a", "puma_b")
    )
    sensitivity = np.array(
        [*values["puma_a"]["kM_sensitivity"], *values["puma_a"]["kG_sensitivity"], *[0.0] * 12]
    )
    identified = [
        eqx.tree_at(lambda fit: fit.k, fit, jax.numpy.asarray(k))
        for fit, k in zip(fits, (a, b), strict=True)
    ]
    result = agreement(puma, *identified, sensitivity=sensitivity)
    assert result.largest_product["gravity"] < 0.3
    assert 0.1 < result.largest_product["mass"] < 0.2


def test_says_what_matters(
    puma: jc.CSLC, fits: tuple[jc.Identification, jc.Identification]
) -> None:
    text = str(agreement(puma, *fits, sensitivity=np.ones(puma.size)))
    assert text.startswith("largest variation times sensitivity [N m]: mass ")
    assert "within one standard error" in text


def test_wrong_input(
    puma: jc.CSLC, puma_k: jax.Array, fits: tuple[jc.Identification, jc.Identification]
) -> None:
    with pytest.raises(ValueError, match=r"sensitivity: expected shape \(43,\), got \(3,\)"):
        agreement(puma, *fits, sensitivity=np.ones(3))
    with pytest.raises(ValueError, match=r"truth of the second: expected shape \(43,\)"):
        agreement(puma, *fits, sensitivity=np.ones(43), truth=(puma_k, puma_k[:5]))
    other = eqx.tree_at(lambda fit: fit.k, fits[1], fits[1].k[:42])
    with pytest.raises(ValueError, match=r"second.k: expected shape \(43,\), got \(42,\)"):
        agreement(puma, fits[0], other, sensitivity=np.ones(43))
