"""Recorded torques as equations have them: averages against sums, a fit against a closed form."""

import numpy as np
import pytest
import scipy
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.bodies import Known, Prior
from jaxcslc.likelihood import TorqueRecord, TorqueSampling
from tests import arms


INERTIA, VISCOUS, STEP = 0.4, 0.3, 0.005


class TestTorqueRecord:
    TIME = np.array([0.0, 0.3, 0.8, 1.0, 1.2, 1.7, 1.8, 2.3])

    def test_held_torque_is_averaged_with_a_triangle(self) -> None:
        """Against a sum over the triangle, at uneven intervals."""
        torque = np.random.default_rng(0).normal(size=(len(self.TIME), 1))
        obtained = TorqueRecord((self.TIME,), (torque,), "held").averaged[:, 0]
        for row, value in enumerate(obtained):
            t, weights = triangle(*self.TIME[row : row + 3])
            held = torque[np.searchsorted(self.TIME, t, side="right") - 1, 0]
            assert_allclose(value, weights @ held, atol=2e-5)

    def test_sampled_torque_is_averaged_as_a_parabola(self) -> None:
        time, parabola = self.TIME[:4], np.polynomial.Polynomial([1.0, -2.0, 3.0])
        obtained = TorqueRecord((time,), (parabola(time)[:, None],), "sampled").averaged[:, 0]
        for row, value in enumerate(obtained):
            t, weights = triangle(*time[row : row + 3])
            assert_allclose(value, weights @ parabola(t), rtol=1e-8)

    @pytest.mark.parametrize("sampling", ["held", "sampled"])
    def test_equations_over_several_samples(self, sampling: TorqueSampling) -> None:
        time = np.append(self.TIME, 2.6)
        torque = np.random.default_rng(0).normal(size=(len(time), 1))
        spline = scipy.interpolate.CubicSpline(time, torque[:, 0])
        obtained = TorqueRecord((time,), (torque,), sampling, every=2).averaged[:, 0]
        assert len(obtained) == 3
        for row, value in enumerate(obtained):
            t, weights = triangle(*time[::2][row : row + 3])
            held = torque[np.searchsorted(time, t, side="right") - 1, 0]
            values = held if sampling == "held" else spline(t)
            assert_allclose(value, weights @ values, atol=2e-5)

    @pytest.mark.parametrize("every", [1, 2])
    @pytest.mark.parametrize("sampling", ["held", "sampled"])
    def test_its_rate_is_the_mean_of_the_derivative(
        self, sampling: TorqueSampling, every: int
    ) -> None:
        """Of steps: their sizes times the triangle's height where they are."""
        torque = np.random.default_rng(0).normal(size=(len(self.TIME), 1))
        record = TorqueRecord((self.TIME,) * 2, (torque, 2.0 * torque), sampling, every)
        derivative = scipy.interpolate.CubicSpline(self.TIME, torque[:, 0]).derivative()
        count = (len(self.TIME) + every - 1) // every - 2
        for row in range(count):
            knots = self.TIME[::every][row : row + 3]
            if sampling == "held":
                inside = (knots[0] < self.TIME) & (knots[2] > self.TIME)
                heights = np.interp(
                    self.TIME[inside], knots, [0.0, 2.0 / (knots[2] - knots[0]), 0.0]
                )
                expected = heights @ np.diff(torque[:, 0], prepend=0.0)[inside]
            else:
                t, weights = triangle(*knots)
                of_three = np.polynomial.Polynomial.fit(knots, derivative(knots), 2)
                expected = weights @ (of_three(t) if every == 1 else derivative(t))
            assert_allclose(record.rate[row], expected, atol=1e-4)
            assert_allclose(record.rate[count + 2 + row], 2.0 * expected, atol=2e-4)
        # The two equations between recordings are none.
        assert_allclose(record.averaged[count : count + 2], 0.0)


def triangle(start: float, middle: float, end: float) -> tuple[np.ndarray, np.ndarray]:
    """Instants of two intervals, and the weights of a triangle over them."""
    t = np.linspace(start, end, 200_001)
    weights = np.minimum((t - start) / (middle - start), (end - t) / (end - middle))
    return t, weights / np.sum(weights)


def rotor() -> jc.Recording:
    """A disc with viscous friction and a held torque: the solution in closed form."""
    samples = 600
    time = STEP * np.arange(samples)
    torque = 2.0 * np.sin(3.1 * time) + 1.5 * np.sin(7.3 * time + 1.0)
    rate = VISCOUS / INERTIA
    fade = np.exp(-rate * STEP)
    q = qd = 0.0
    positions: list[float] = []
    for value in torque:
        positions.append(q)
        limit = value / VISCOUS
        q += limit * STEP + (qd - limit) * (1.0 - fade) / rate
        qd = limit + (qd - limit) * fade
    position = np.array(positions) + 1e-6 * np.random.default_rng(0).normal(size=samples)
    return jc.Recording(time, position[:, None], torque[:, None])


@pytest.fixture(scope="module")
def disc() -> jc.CSLC:
    return arms.turntable("viscous")


@pytest.mark.parametrize("every", [2, 5])
def test_equations_over_several_samples(disc: jc.CSLC, every: int) -> None:
    result = jc.MaximumLikelihood(every=every).fit(disc, rotor())
    assert result.position.shape == (600 // every, 1)
    assert_allclose(result.k, [INERTIA, VISCOUS], rtol=2e-3)


def test_a_coefficient_that_is_fixed_stays(disc: jc.CSLC) -> None:
    prior = Prior({"kv1": Known(0.25)})
    result = jc.MaximumLikelihood(prior=prior).fit(disc, rotor())
    assert float(result.k[1]) == 0.25
    assert float(result.fit.standard_error[1]) == 0.0


class TestBadInput:
    def test_bounds(self) -> None:
        with pytest.raises(ValueError, match="kv1: maximum likelihood takes values, got bounds"):
            jc.MaximumLikelihood(prior=Prior({"kv1": Known(low=0.0)}))

    def test_links(self) -> None:
        with pytest.raises(ValueError, match=r"takes coefficients; \[links\] needs"):
            jc.MaximumLikelihood(prior=Prior(links={"1": {"mass": Known(1.0)}}))

    def test_every(self, disc: jc.CSLC) -> None:
        with pytest.raises(ValueError, match="every: expected 1 or more or 'auto', got 0"):
            jc.MaximumLikelihood(every=0)
        with pytest.raises(ValueError, match="has 600 samples; expected at least 1000"):
            jc.MaximumLikelihood(every=100).fit(disc, rotor())
