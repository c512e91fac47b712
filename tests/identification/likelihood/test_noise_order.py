"""Torque noise with a spectrum of its own: its autoregression, and what weighting by it gains."""

import numpy as np
import pytest
import scipy
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.identification.likelihood.selection._noise_order import averages_of
from jaxcslc.identification.likelihood.torque import TorqueRecord, Whitening, autocovariance


STEP, SAMPLES = 0.005, 1000
INERTIA, VISCOUS = 0.4, 0.3


def test_levinson_solves_the_equations_of_yule_and_walker() -> None:
    covariance = np.array([[2.0, 1.0], [1.2, -0.5], [0.3, 0.4]])
    obtained = Whitening.fitted(covariance).coefficients
    for joint in range(2):
        c0, c1, c2 = covariance[:, joint]
        expected = np.linalg.solve([[c0, c1], [c1, c0]], [-c1, -c2])
        assert_allclose(obtained[:, joint], expected, rtol=1e-12)


def test_a_filter_and_its_inverse(rng: np.random.Generator) -> None:
    whitening = Whitening(np.array([[-1.2, 0.3], [0.7, 0.1]]))
    values = rng.normal(size=(50, 2))
    assert_allclose(whitening.removed(whitening.applied(values)), values, atol=1e-12)
    expected = scipy.signal.lfilter([1.0, -1.2, 0.7], [1.0], values[:, 0])
    assert_allclose(whitening.applied(values)[:, 0], expected, atol=1e-12)


def test_autocovariance_of_counted_pairs() -> None:
    values = np.array([[1.0], [2.0], [1.5], [-1.0]])
    counted = np.array([[True], [True], [False], [True]])
    obtained = autocovariance(values, counted, 1)[:, 0]
    assert_allclose(obtained, [(1.0 + 4.0 + 1.0) / 3, 2.0])


VIBRATION = (1.0, -1.6, 0.9)


def disc_with_noise(
    seed: int, filter_of_noise: tuple[float, ...], count: float = 2e-7
) -> jc.Recording:
    """A disc with viscous friction, in closed form, and held torques with autoregressive noise."""
    rng = np.random.default_rng(seed)
    time = STEP * np.arange(SAMPLES)
    torque = 2.0 * np.sin(3.1 * time) + 0.5 * rng.normal(size=SAMPLES)  # of all frequencies
    rate, q, qd = VISCOUS / INERTIA, 0.0, 0.0
    fade = np.exp(-rate * STEP)
    positions: list[float] = []
    for value in torque:
        positions.append(q)
        limit = value / VISCOUS
        q += limit * STEP + (qd - limit) * (1.0 - fade) / rate
        qd = limit + (qd - limit) * fade
    noise = scipy.signal.lfilter([1.0], filter_of_noise, 0.1 * rng.normal(size=SAMPLES))
    position = count * np.round(np.array(positions) / count + rng.uniform(-0.5, 0.5))
    return jc.Recording(time, position[:, None], (torque + noise)[:, None])


@pytest.fixture(scope="module")
def disc() -> jc.CSLC:
    robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    return jc.derive(robot.with_friction("viscous"), lengths="numeric")


def test_vibration_is_weighted_by_its_spectrum(disc: jc.CSLC) -> None:
    errors: dict[int, list[np.ndarray]] = {0: [], 2: []}
    deviations: list[np.ndarray] = []
    for seed in range(6):
        recording = disc_with_noise(seed, VIBRATION)
        for order, values in errors.items():
            estimator = jc.MaximumLikelihood(noise_order=order, errors="independent")
            result = estimator.fit(disc, recording)
            assert result.converged
            values.append(np.asarray(result.k) - [INERTIA, VISCOUS])
            if order == 2:
                deviations.append(values[-1] / np.asarray(result.fit.standard_error))
                # Equations have the mean of two torques that follow each other.
                assert_allclose(result.noise_coefficients[:, 0], [-1.6, 0.9], atol=0.1)
                assert_allclose(result.torque_noise, 0.08, rtol=0.3)
                assert_allclose(result.fit.torque_error, 0.4, rtol=0.3)
    white, coloured = (np.sqrt(np.mean(np.square(values), axis=0)) for values in errors.values())
    assert coloured[0] < 0.7 * white[0]
    assert 0.4 < np.sqrt(np.mean(np.square(deviations))) < 1.7


@pytest.mark.parametrize("count", [2e-7, 2e-5])  # torque noise beyond that of counts, and below
@pytest.mark.parametrize(("of_noise", "order"), [((1.0,), 0), ((1.0, -0.6), 1), (VIBRATION, 2)])
def test_order_of_noise_is_selected(
    disc: jc.CSLC, of_noise: tuple[float, ...], order: int, count: float
) -> None:
    recording = disc_with_noise(10, of_noise, count)
    result = jc.MaximumLikelihood(every=1).fit(disc, recording)
    assert result.selection is not None
    assert result.selection.noise_order == len(result.noise_coefficients) == order
    assert result.selection.lines[order - 1].startswith(f"noise order {order}, used") or not order
    by_hand = jc.MaximumLikelihood(every=1, noise_order=order).fit(disc, recording)
    assert by_hand.selection is None
    # Noise levels are estimated to five percent.
    assert_allclose(result.k, by_hand.k, atol=0.3 * float(by_hand.fit.standard_error.max()))


def test_white_noise_of_equations_and_of_torques_that_they_average() -> None:
    line = np.arange(40.0)[:, None]
    recording = jc.Recording(line[:, 0], line, line)
    # Two held torques a time, and a triangle over six.
    for every, expected in ((1, [1.0, 0.5, 0.0]), (3, [1.0, 0.26, 0.0])):
        covariance = averages_of(TorqueRecord.of([recording], "held", every))
        noise = np.random.default_rng(0).normal(size=(60_000, 1))
        white = jc.Recording(np.arange(60_000.0), noise, noise)
        averaged = TorqueRecord.of([white], "held", every).averaged()[:, 0]
        products = [np.mean(averaged[lag:] * averaged[: len(averaged) - lag]) for lag in range(3)]
        assert_allclose(covariance, np.array(products) / products[0], atol=0.02)
        assert_allclose(covariance, expected, atol=0.05)


def test_order() -> None:
    with pytest.raises(ValueError, match="noise_order: expected 0 to 2 or 'auto', got 3"):
        jc.MaximumLikelihood(noise_order=3)
