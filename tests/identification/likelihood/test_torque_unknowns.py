"""Lag and gains of recorded torques: averages against sums, estimates against a closed form."""

import json
from pathlib import Path

import numpy as np
import pytest
import scipy
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.identification import Known, Prior
from jaxcslc.identification.likelihood import TorqueSampling
from jaxcslc.identification.likelihood.torque import TorqueRecord


INERTIA, VISCOUS, STEP = 0.4, 0.3, 0.005


class TestTorqueRecord:
    TIME = np.array([0.0, 0.3, 0.8, 1.0, 1.2, 1.7, 1.8, 2.3])

    @pytest.mark.parametrize("lag", [0.0, 0.07, -0.4, 0.6])
    def test_held_torque_is_averaged_with_a_triangle(self, lag: float) -> None:
        """Against a sum over the triangle, at uneven intervals."""
        torque = np.random.default_rng(0).normal(size=(len(self.TIME), 1))
        record = TorqueRecord((self.TIME,), (torque,), "held")
        outside, obtained = record.outside(lag), record.averaged(lag)[:, 0]
        assert np.sum(~outside) >= 3
        for row in np.flatnonzero(~outside):
            start, middle, end = self.TIME[row : row + 3]
            t = np.linspace(start, end, 200_001)
            triangle = np.minimum((t - start) / (middle - start), (end - t) / (end - middle))
            held = torque[np.searchsorted(self.TIME, t + lag, side="right") - 1, 0]
            assert_allclose(obtained[row], np.sum(triangle * held) / np.sum(triangle), atol=2e-5)

    def test_sampled_torque_is_averaged_as_a_parabola(self) -> None:
        time = self.TIME[:4]
        record = TorqueRecord((time,), ((1.0 - 2.0 * time + 3.0 * time**2)[:, None],), "sampled")
        for lag in (0.0, 0.05):
            obtained = record.averaged(lag)[:, 0]
            for row in np.flatnonzero(~record.outside(lag)):
                start, middle, end = time[row : row + 3]
                t = np.linspace(start, end, 200_001)
                triangle = np.minimum((t - start) / (middle - start), (end - t) / (end - middle))
                late = 1.0 - 2.0 * (t + lag) + 3.0 * (t + lag) ** 2
                expected = np.sum(triangle * late) / np.sum(triangle)
                assert_allclose(obtained[row], expected, rtol=1e-8)

    @pytest.mark.parametrize("sampling", ["held", "sampled"])
    def test_equations_over_several_samples(self, sampling: TorqueSampling) -> None:
        time = np.append(self.TIME, 2.6)
        torque = np.random.default_rng(0).normal(size=(len(time), 1))
        spline = scipy.interpolate.CubicSpline(time, torque[:, 0])
        for lag in (0.0, 0.07):
            record = TorqueRecord((time,), (torque,), sampling, every=2)
            obtained, outside = record.averaged(lag)[:, 0], record.outside(lag)
            assert len(obtained) == 3 and np.sum(~outside) >= 2
            for row in np.flatnonzero(~outside):
                start, middle, end = time[::2][row : row + 3]
                t = np.linspace(start, end, 200_001)
                triangle = np.minimum((t - start) / (middle - start), (end - t) / (end - middle))
                held = torque[np.searchsorted(time, t + lag, side="right") - 1, 0]
                values = held if sampling == "held" else spline(t + lag)
                expected = np.sum(triangle * values) / np.sum(triangle)
                assert_allclose(obtained[row], expected, atol=2e-5)

    @pytest.mark.parametrize("every", [1, 2])
    @pytest.mark.parametrize("sampling", ["held", "sampled"])
    def test_its_rate_is_the_derivative(self, sampling: TorqueSampling, every: int) -> None:
        torque = np.random.default_rng(0).normal(size=(len(self.TIME), 2))
        record = TorqueRecord((self.TIME,) * 2, (torque, 2.0 * torque), sampling, every)
        lag, step = 0.08, 1e-5
        rows = ~(record.outside(lag - step) | record.outside(lag + step))
        difference = (record.averaged(lag + step) - record.averaged(lag - step)) / (2 * step)
        assert_allclose(record.rate(lag)[rows], difference[rows], atol=1e-4)
        # The two equations between recordings are none.
        count = (len(self.TIME) + every - 1) // every - 2
        assert_allclose(record.averaged(lag)[count : count + 2], 0.0)


def rotor(delay: float, gain: float = 1.0) -> jc.Recording:
    """A disc with viscous friction whose demand acts later: the solution in closed form."""
    samples, parts = 600, 8
    time = STEP * np.arange(samples)
    demand = 2.0 * np.sin(3.1 * time) + 1.5 * np.sin(7.3 * time + 1.0)
    # A delay of whole eighths of a sample: torque is constant in each of these.
    late = round(delay * parts / STEP)
    torque = gain * demand[np.maximum(np.arange(parts * samples) - late, 0) // parts]
    h, rate = STEP / parts, VISCOUS / INERTIA
    fade = np.exp(-rate * h)
    q = qd = 0.0
    positions: list[float] = []
    for index, value in enumerate(torque):
        if index % parts == 0:
            positions.append(q)
        limit = value / VISCOUS
        q += limit * h + (qd - limit) * (1.0 - fade) / rate
        qd = limit + (qd - limit) * fade
    position = np.array(positions) + 1e-6 * np.random.default_rng(0).normal(size=samples)
    return jc.Recording(time, position[:, None], demand[:, None])


@pytest.fixture(scope="module")
def disc() -> jc.CSLC:
    robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    return jc.derive(robot.with_friction("viscous"), lengths="numeric")


@pytest.mark.parametrize("samples_late", [0.25, 2.625])
def test_a_delay_is_estimated(disc: jc.CSLC, samples_late: float) -> None:
    delay = samples_late * STEP
    result = jc.MaximumLikelihood(unknowns=("torque_lag",)).fit(disc, rotor(delay))
    assert result.converged
    assert abs(result.torque_lag + delay) < max(4.0 * result.torque_lag_error, 2e-3 * STEP)
    assert result.torque_lag_error < 0.05 * STEP
    assert_allclose(result.k, [INERTIA, VISCOUS], rtol=2e-3)


def test_a_gain_is_estimated_where_an_inertia_is_known(disc: jc.CSLC) -> None:
    prior = Prior({"kB1": Known(INERTIA, 0.01 * INERTIA)})
    estimator = jc.MaximumLikelihood(unknowns=("torque_gains",), prior=prior)
    result = estimator.fit(disc, rotor(0.0, gain=1.7))
    assert_allclose(result.torque_gain, 1.7, rtol=1e-3)
    # What is known of the inertia to a percent says as much of the gain.
    assert_allclose(result.torque_gain_error, 0.017, rtol=0.1)
    assert_allclose(result.k, [INERTIA, VISCOUS], rtol=1e-2)


@pytest.mark.parametrize("every", [2, 5])
def test_equations_over_several_samples(disc: jc.CSLC, every: int) -> None:
    result = jc.MaximumLikelihood(every=every).fit(disc, rotor(0.0))
    assert result.position.shape == (600 // every, 1)
    assert_allclose(result.k, [INERTIA, VISCOUS], rtol=2e-3)


def test_a_coefficient_that_is_fixed_stays(disc: jc.CSLC) -> None:
    prior = Prior({"kv1": Known(0.25)})
    result = jc.MaximumLikelihood(prior=prior).fit(disc, rotor(0.0))
    assert float(result.k[1]) == 0.25
    assert float(result.fit.standard_error[1]) == 0.0


class TestBadInput:
    def test_gains_without_a_value_that_is_known(self) -> None:
        with pytest.raises(ValueError, match="scale together; expected a prior"):
            jc.MaximumLikelihood(unknowns=("torque_gains",))

    def test_bounds(self) -> None:
        with pytest.raises(ValueError, match="kv1: maximum likelihood takes values, got bounds"):
            jc.MaximumLikelihood(prior=Prior({"kv1": Known(low=0.0)}))

    def test_links(self) -> None:
        with pytest.raises(ValueError, match="takes coefficients, got links"):
            jc.MaximumLikelihood(prior=Prior(links={"1": {"mass": Known(1.0)}}))

    def test_every(self, disc: jc.CSLC) -> None:
        with pytest.raises(ValueError, match="every: expected 1 or more or 'auto', got 0"):
            jc.MaximumLikelihood(every=0)
        with pytest.raises(ValueError, match="has 600 samples; expected at least 1000"):
            jc.MaximumLikelihood(every=100).fit(disc, rotor(0.0))

    def test_unknowns(self) -> None:
        # A type checker at run time speaks first.
        with pytest.raises((ValueError, TypeError), match="delay"):
            jc.MaximumLikelihood(unknowns=("delay",))  # type: ignore[arg-type]


LAG, GAIN = -2.625 * STEP, 1.7


@pytest.fixture(scope="module")
def report(disc: jc.CSLC) -> jc.Report:
    prior = Prior({"kB1": Known(INERTIA, 0.01 * INERTIA)})
    return jc.identify(
        disc,
        rotor(-LAG, GAIN),
        settings=jc.Settings(jc.Preparation(torque_alignment="mean")),
        estimator="maximum-likelihood",
        likelihood=jc.MaximumLikelihood(unknowns=("torque_lag", "torque_gains"), prior=prior),
        prior=prior,
        checks=False,
        possible="never",
    )


class TestIdentify:
    def test_coefficients_are_of_torques_as_they_were(self, report: jc.Report) -> None:
        assert report.estimators is not None
        likelihood = report.estimators.likelihood
        assert_allclose(likelihood.torque_lag, LAG, atol=2e-3 * STEP)
        assert_allclose(likelihood.torque_gain, GAIN, rtol=2e-3)
        assert_allclose(report.k, [INERTIA, VISCOUS], rtol=1e-2)
        # What the prior says of the inertia is not counted twice.
        assert_allclose(report.fit.standard_error[0], 0.01 * INERTIA, rtol=0.1)
        # Least squares, whose torques have been corrected, is right too.
        assert report.estimators.rms["least-squares"][0] < 0.1
        assert_allclose(report.settings.preparation.torque_lag, likelihood.torque_lag)
        late = report.patterns["training"].torque
        assert_allclose(np.abs(late).max(), GAIN * 3.5, rtol=0.1)

    def test_they_are_reported(self, report: jc.Report, tmp_path: Path) -> None:
        assert "torque lag: -13.1" in str(report)
        assert "torque over what was recorded, joint by joint: 1.7 ±" in str(report)
        report.save(tmp_path, pictures=False)
        assert "torque lag: -13.1" in (tmp_path / "index.html").read_text("utf-8")
        estimators = json.loads((tmp_path / "identification.json").read_text("utf-8"))["estimators"]
        assert_allclose(estimators["torque_lag"]["value"], LAG, atol=2e-3 * STEP)
        assert_allclose(estimators["torque_gains"]["value"], [GAIN], rtol=2e-3)
