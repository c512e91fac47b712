"""Possible bodies within the search: near to the truth on poor data, no change on rich data."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.bodies import Known, Prior
from tests import arms


POOR, RICH = (0.3, 400), (1.5, 1000)  # amplitude [rad] and samples
NOISE, STEP = 0.2, 0.01
COUNT = 5e-5  # of the encoders [rad]


@pytest.fixture(scope="module")
def network() -> jc.CSLC:
    """Two joints with full tensors and motors."""
    return arms.elbow("viscous")


def motion(
    size: float, samples: int, speeds: tuple[float, float] = (1.3, 2.1)
) -> tuple[np.ndarray, ...]:
    t, w = STEP * np.arange(samples), np.array(speeds)
    angle = t[:, None] * w + [0.3, 1.1]
    return t, size * np.sin(angle), size * w * np.cos(angle), -size * w**2 * np.sin(angle)


@pytest.fixture(scope="module")
def k(network: jc.CSLC) -> np.ndarray:
    links = [
        jc.LinkParameters(mass, np.array([0.05, 0.02, 0.1]), 0.01 * np.eye(3), 0.05)
        for mass in (2.0, 1.5)
    ]
    return np.asarray(network.coefficients_from(links, viscous=[0.3, 0.2]))


def recording(network: jc.CSLC, k: np.ndarray, size: float, samples: int) -> jc.Recording:
    rng = np.random.default_rng(11)
    t, q, qd, qdd = motion(size, samples)
    torque = np.asarray(network.torque(k, q, qd, qdd)) + NOISE * rng.normal(size=q.shape)
    return jc.Recording(t, COUNT * np.round(q / COUNT), torque)


ESTIMATOR = jc.MaximumLikelihood(torque_sampling="sampled", possible=True)


@pytest.fixture(scope="module")
def poor(network: jc.CSLC, k: np.ndarray) -> jc.LikelihoodFit:
    return ESTIMATOR.fit(network, recording(network, k, *POOR))


def test_poor_data_give_possible_bodies_nearer_to_the_truth(
    network: jc.CSLC, k: np.ndarray, poor: jc.LikelihoodFit
) -> None:
    assert poor.bodies is not None
    assert poor.free is not None
    for link in poor.bodies.links:
        moments = np.linalg.eigvalsh(np.asarray(link.inertia))  # about the centre
        assert float(link.mass) > 0.0
        assert moments[0] > 0.0
        assert moments[2] < moments[0] + moments[1]
    viscous = poor.bodies.friction["viscous"]
    implied = network.coefficients_from(poor.bodies.links, viscous=viscous)
    assert_allclose(implied, poor.k, atol=1e-9)
    # Torque of other motion, several times as fast.
    _, *other = motion(1.2, 1000, (2.3, 3.1))
    free, possible = (
        np.sqrt(np.mean(np.asarray(network.torque(fit - k, *other)) ** 2))
        for fit in (np.asarray(poor.free.k), np.asarray(poor.k))
    )
    assert possible < 0.5 * free


def test_rich_data_leave_little_to_bodies(network: jc.CSLC, k: np.ndarray) -> None:
    result = ESTIMATOR.fit(network, recording(network, k, *RICH))
    assert result.converged
    assert result.free is not None
    change = np.abs(np.asarray(result.k) - np.asarray(result.free.k))
    assert np.all(change < 0.5 * np.asarray(result.free.standard_error))


def test_bodies_follow_what_is_known_of_links(network: jc.CSLC, k: np.ndarray) -> None:
    estimator = dataclasses.replace(ESTIMATOR, prior=Prior(links={"2": {"mass": Known(1.5)}}))
    result = estimator.fit(network, recording(network, k, *POOR))
    assert result.bodies is not None
    assert_allclose(float(result.bodies.links[1].mass), 1.5, rtol=1e-6)


def test_identify_has_the_bodies_of_the_search(network: jc.CSLC, k: np.ndarray) -> None:
    train = recording(network, k, *POOR)
    report = jc.identify(
        network,
        train,
        recording(network, k, 0.35, 300),
        estimator="maximum-likelihood",
        possible="always",
        settings=jc.Settings().with_options(torque_alignment="sample"),
        systematic=False,
    )
    assert report.possible is not None
    assert report.possible.used
    assert report.estimators is not None
    assert report.estimators.likelihood.bodies is not None
    assert_allclose(report.fit.k, report.estimators.likelihood.k)
    free = report.estimators.likelihood.free
    assert free is not None
    assert_allclose(report.possible.free.k, free.k)
    assert np.all(np.isfinite(report.possible.parameters.torque_distance))


def test_what_it_cannot_follow(network: jc.CSLC) -> None:
    links = Prior(links={"1": {"mass": Known(1.0)}})
    with pytest.raises(ValueError, match="needs physically consistent parameters"):
        jc.MaximumLikelihood(prior=links)
    t = np.arange(20) * 0.1
    with pytest.raises(ValueError, match="use possible='always' of identify"):
        jc.identify(
            network,
            jc.Recording(t, np.zeros((20, 2)), np.zeros((20, 2))),
            estimator="maximum-likelihood",
            likelihood=jc.MaximumLikelihood(possible=True),
        )
