"""Predicted standard errors: against fits of simulated recordings, and closed forms."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy

import jaxcslc as jc
from jaxcslc.excitation import BSplines, Knowledge, MotionInformation, Noise, Prediction
from jaxcslc.excitation._design import predicted
from jaxcslc.excitation._information import error_covariance, time_grid
from tests import arms


RATE = 200.0
Motion = tuple[np.ndarray, np.ndarray, np.ndarray]


@pytest.fixture
def pendulum() -> jc.CSLC:
    return arms.pendulum("viscous")


@pytest.fixture(scope="module")
def motion() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    family = BSplines(4.0, 10)
    parameters = np.random.default_rng(3).normal(size=(family.size, 1))
    time, _ = time_grid(4.0, 1.0 / RATE)
    return family.motion(parameters, time)


K = np.array([0.5, 2.0, 0.3, 0.4])


def prediction_of(network: jc.CSLC, noise: Noise, motion: Motion, stride: int = 1) -> Prediction:
    information = MotionInformation(network, K, np.abs(K), noise, stride / RATE)
    part = tuple(x[::stride] for x in motion)
    moments = information.moments(tuple(map(jnp.asarray, part)), information.spectra(part[0]))
    knowledge = Knowledge(K, None, np.full(network.size, np.inf))
    return predicted(information, knowledge, jax.tree.map(np.asarray, moments))


def test_white_torque_noise_alone_gives_least_squares(pendulum: jc.CSLC, motion: Motion) -> None:
    noise = Noise(0.1, rate=RATE, slow=0.0)
    rows = np.asarray(pendulum.regressor(*motion))[:, 0]
    expected = 0.1 * np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))
    np.testing.assert_allclose(
        prediction_of(pendulum, noise, motion).standard_error, expected, rtol=1e-4
    )


def test_a_coarser_grid_predicts_the_same(pendulum: jc.CSLC, motion: Motion) -> None:
    noise = Noise(0.1, 1e-3, rate=RATE)
    fine, coarse = (
        prediction_of(pendulum, noise, motion, stride).standard_error for stride in (1, 4)
    )
    np.testing.assert_allclose(coarse, fine, rtol=0.1)


@pytest.mark.parametrize("estimator", ["likelihood", "regression"])
def test_errors_of_repeated_fits_are_those_predicted(
    pendulum: jc.CSLC, motion: Motion, estimator: str, rng: np.random.Generator
) -> None:
    """The equations' errors are drawn, and the estimator is written out in the time domain."""
    q, qd, qdd = motion
    # A low pass lets through what large errors of positions make at both ends of a motion.
    deviation = 2e-4 if estimator == "likelihood" else 2e-6
    noise = Noise(
        0.05,
        np.sqrt(12.0) * deviation,
        rate=RATE,
        slow=0.0,
        estimator=estimator,
        cutoff=8.0,
    )
    samples = len(q)
    rows = np.asarray(pendulum.regressor(q, qd, qdd))[:, 0]
    second = np.diff(np.eye(samples), 2, axis=0) * RATE**2  # (samples - 2, samples)
    rows = rows[1:-1]
    inertia = float(pendulum.mass_matrix(jnp.asarray(K), jnp.zeros(1))[0, 0])
    covariance = 0.05**2 * np.eye(samples - 2) + (inertia * deviation) ** 2 * second @ second.T
    if estimator == "likelihood":
        inverse = np.linalg.inv(covariance)
        expected = np.linalg.inv(rows.T @ inverse @ rows)
    else:
        frequency = np.arange(samples - 2) * RATE / (2 * (samples - 2))
        cosine = np.asarray(jax.scipy.fft.dct(jnp.eye(samples - 2), axis=0, norm="ortho"))
        filtered = noise.gain(frequency)[:, None] * cosine
        x, spread = filtered @ rows, filtered @ covariance @ filtered.T
        pseudo = np.linalg.inv(x.T @ x) @ x.T
        expected = pseudo @ spread @ pseudo.T
    np.testing.assert_allclose(
        prediction_of(pendulum, noise, motion).standard_error,
        np.sqrt(np.diag(expected)),
        rtol=0.12,  # noise of positions grows less than ω⁴ near half the sampling rate
    )


@pytest.mark.parametrize("estimator", ["likelihood", "regression"])
def test_an_offset_costs_what_a_constant_torque_shifts_a_fit(
    pendulum: jc.CSLC, motion: Motion, estimator: str
) -> None:
    """Beside white noise, whose weights an estimator keeps."""
    offset, rows = 0.7, np.asarray(pendulum.regressor(*motion))[:, 0]
    noise = Noise(0.1, rate=RATE, slow=0.0, estimator=estimator, cutoff=60.0)
    with_offset = dataclasses.replace(noise, offset=offset)
    shift = np.linalg.lstsq(rows, np.full(len(rows), offset))[0]
    white = prediction_of(pendulum, noise, motion).standard_error
    both = prediction_of(pendulum, with_offset, motion).standard_error
    tolerance = 1e-3 if estimator == "likelihood" else 0.02  # the filter takes off a little
    np.testing.assert_allclose(np.sqrt(both**2 - white**2), np.abs(shift), rtol=tolerance)


def _low_passed(rng: np.random.Generator, samples: int, bandwidth: float) -> np.ndarray:
    """Unit noise behind a first-order low pass, exactly sampled."""
    memory = np.exp(-2 * np.pi * bandwidth / RATE)
    noise = np.sqrt(1 - memory**2) * rng.normal(size=samples)
    noise[0] = rng.normal()
    return scipy.signal.lfilter([1.0], [1.0, -memory], noise)


@pytest.mark.parametrize("cutoff", [None, 20.0])
@pytest.mark.parametrize("bandwidth", [1.0, 4.0, np.inf])
def test_noise_of_a_fit_has_the_density_of_its_residuals(
    pendulum: jc.CSLC, bandwidth: float, cutoff: float | None, rng: np.random.Generator
) -> None:
    samples = 12_000
    time = np.arange(samples) / RATE
    q, qd, qdd = (x[:, None] for x in (np.sin(time), np.cos(time), -np.sin(time)))
    slow = rng.normal(size=samples) if np.isinf(bandwidth) else _low_passed(rng, samples, bandwidth)
    torque = np.asarray(pendulum.torque(K, q, qd, qdd)) + 0.3 * slow[:, None]
    everything = np.ones(torque.shape, bool)
    patterns = jc.Patterns(time, q, qd, qdd, torque, everything, everything)
    fit = jc.LeastSquares(cutoff=cutoff).fit(pendulum, patterns)
    noise = Noise.of_fit(fit, None, rate=RATE, cutoff=cutoff)
    frequency = np.array([0.1])
    expected = 0.09 / RATE if np.isinf(bandwidth) else 0.09 / (np.pi * bandwidth)
    density = noise.density(frequency, np.zeros((1, 1)))[0, 0, 0]
    np.testing.assert_allclose(density, expected, rtol=0.4)  # one draw of 60 s; 0.2 of errors
    assert noise.cutoff == (cutoff or 15.0)


def test_prior_information_adds(pendulum: jc.CSLC, motion: Motion) -> None:
    noise = Noise(0.1, rate=RATE)
    information = MotionInformation(pendulum, K, np.ones(4), noise, 1 / RATE)
    moments = information.moments(tuple(map(jnp.asarray, motion)), information.spectra(motion[0]))
    prior = np.diag([1e6, 0.0, 0.0, 0.0])
    with_prior = error_covariance(moments, jnp.asarray(prior))
    np.testing.assert_allclose(
        np.linalg.inv(with_prior), np.asarray(moments.normal) + prior, rtol=1e-6
    )


def test_a_fit_is_known_to_its_standard_errors(
    pendulum: jc.CSLC, motion: Motion, rng: np.random.Generator
) -> None:
    """Its information has the standard errors that it reports, correlated noise included."""
    torque = np.asarray(pendulum.torque(K, *motion))
    slow = np.convolve(rng.normal(size=len(torque)), np.ones(40) / 40, "same")[:, None]
    everything = np.ones(torque.shape, bool)
    time = np.arange(len(torque)) / RATE
    patterns = jc.Patterns(time, *motion, torque + slow, everything, everything)
    fit = jc.LeastSquares().fit(pendulum, patterns)
    knowledge = Knowledge.of_fit(pendulum, fit)
    assert knowledge.information is not None
    known = np.sqrt(np.diag(np.linalg.inv(knowledge.information)))
    np.testing.assert_allclose(known, np.asarray(fit.standard_error), rtol=1e-6)
    assert not np.allclose(fit.standard_error, np.sqrt(np.diag(fit.independent_covariance)))


def test_correlated_torque_noise_costs_more(pendulum: jc.CSLC, motion: Motion) -> None:
    white, slow = (
        prediction_of(pendulum, Noise(0.1, rate=RATE, torque_bandwidth=b), motion).standard_error
        for b in (np.inf, 2.0)
    )
    assert np.all(slow > 2 * white)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"torque": 0.0}, "torque noise is .0.0.; expected numbers above 0"),
        ({"torque": 1.0, "resolution": -1.0}, "resolution noise is .-1.0.; expected numbers from"),
        ({"torque": 1.0, "rate": 0.0}, "rate is 0.0; expected more than 0 Hz"),
        ({"torque": 1.0, "estimator": "other"}, "estimator: expected likelihood or regression"),
        ({"torque": 1.0, "torque_bandwidth": 0.0}, "torque_bandwidth is 0.0; expected more than 0"),
        ({"torque": 1.0, "offset": -1.0}, "offset noise is .-1.0.; expected numbers from 0"),
        ({"torque": 1.0, "slow": 1.0}, "slow is 1.0; expected from 0 to below 1"),
    ],
)
def test_wrong_noise_is_named(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Noise(**arguments)


def test_numbers_of_another_robot_are_named() -> None:
    with pytest.raises(ValueError, match="torque noise: expected one number or 2, got 3"):
        Noise((1.0, 1.0, 1.0)).torque_deviation(2)


def test_a_payload_adds_unknowns_to_what_is_known(pendulum: jc.CSLC) -> None:
    """Torques of the prior model are those of an arm that carries the mass."""
    loaded = pendulum.with_payload()
    known = Knowledge(K, np.diag(1 / K**2), np.abs(K)).with_payload(loaded, 2.0)
    size = pendulum.size
    assert known.information is not None
    np.testing.assert_array_equal(known.information[:size, :size], np.diag(1 / K**2))
    assert not known.information[size:].any()
    assert np.isinf(known.standard_error[size:]).all()
    np.testing.assert_array_equal(known.k[:size], K)
    assert dict(zip(loaded.names, known.k, strict=True))["pm"] == 2.0
    with pytest.raises(ValueError, match="expected a network with 4 coefficients and a payload's"):
        Knowledge(K, None, np.abs(K)).with_payload(pendulum, 2.0)
