"""What a wrong time of torques and missing terms do to coefficients: fits that have them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from tests import arms


STEP, SAMPLES = 0.01, 600
COEFFICIENTS = np.array([0.5, 0.3, -0.1, 0.2])


@pytest.fixture(scope="module")
def network() -> jc.CSLC:
    return arms.pendulum("viscous")


def recording(
    network: jc.CSLC, rng: np.random.Generator, lag: float, offset: float
) -> jc.Recording:
    """A motion in closed form, its torque so much later and larger."""
    time = STEP * np.arange(SAMPLES)[:, None]

    def motion(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return (
            np.sin(2 * t) + 0.3 * np.sin(5 * t + 1),
            2 * np.cos(2 * t) + 1.5 * np.cos(5 * t + 1),
            -4 * np.sin(2 * t) - 7.5 * np.sin(5 * t + 1),
        )

    torque = np.asarray(network.torque(COEFFICIENTS, *motion(time - lag))) + offset
    position = motion(time)[0] + 1e-5 * rng.normal(size=time.shape)
    return jc.Recording(time[:, 0], position, torque + 0.01 * rng.normal(size=time.shape))


def estimator(**options: object) -> jc.MaximumLikelihood:
    return jc.MaximumLikelihood("sampled", every=1, **options)  # pyright: ignore


def test_a_wrong_time(network: jc.CSLC, rng: np.random.Generator) -> None:
    seed = int(rng.integers(1000))
    late, on_time = (
        recording(network, np.random.default_rng(seed), lag, 0.0) for lag in (0.004, 0.0)
    )
    result, right = (estimator().fit(network, of_time) for of_time in (late, on_time))
    assert result.systematic is not None
    change = np.abs(np.asarray(result.k - right.k))
    part = result.systematic.parts["torque timing"]
    assert_allclose(part, change, atol=0.1 * change.max())
    assert change.max() > 3 * np.asarray(result.fit.standard_error).max()


def test_a_missing_offset(network: jc.CSLC, rng: np.random.Generator) -> None:
    shifted = recording(network, rng, 0.0, 0.1)
    result = estimator().fit(network, shifted)
    right = estimator().fit(arms.pendulum("viscous", "offset"), shifted)
    assert result.systematic is not None and right.systematic is not None
    change = np.abs(np.asarray(result.k - right.k[:4]))
    part = result.systematic.parts["torque offset"]
    assert_allclose(part, change, atol=0.1 * change.max())
    assert "torque offset" not in right.systematic.parts


def test_what_a_recording_does_not_show_makes_no_part(
    network: jc.CSLC, rng: np.random.Generator
) -> None:
    result = estimator().fit(network, recording(network, rng, 0.0, 0.0))
    assert result.systematic is not None
    error = np.asarray(result.fit.standard_error)
    for part in result.systematic.parts.values():
        assert np.all(part < 2.0 * error)
    assert (
        estimator(errors="independent").fit(network, recording(network, rng, 0, 0)).systematic
        is None
    )
