"""Instrumental variables, DIDIM and the test of exogeneity."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.control import PID, Reference
from jaxcslc.instruments import ControlledMotion, CorrectedMotion
from jaxcslc.instruments._estimators import (
    exogeneity_test,
    projected_fit,
    wide_rows,
)
from jaxcslc.least_squares import Equations, Unknowns
from tests import arms


ROUNDING = 1e-9
SUPPORT = ((0, 1, 2), (1, 2, 3))
INDEPENDENT = jc.LeastSquares((2.0, 0.5), errors="independent")


def equations_of(regressors: list[np.ndarray], torques: list[np.ndarray]) -> Equations:
    rows = tuple(np.column_stack(pair) for pair in zip(regressors, torques, strict=True))
    sample = np.arange(len(rows[0]))
    return Equations(Unknowns(("a", "b", "c", "d"), SUPPORT), rows, (sample, sample))


def draw(
    rng: np.random.Generator, *, noise: float, error: float, rows: int = 300
) -> tuple[Equations, Equations]:
    """Equations of regressors with noise, and of regressors without; coefficients of one."""
    true = [rng.normal(size=(rows, 3)) for _ in SUPPORT]
    torques = [x.sum(axis=1) + error * rng.normal(size=rows) for x in true]
    noisy = [x + noise * rng.normal(size=x.shape) for x in true]
    # Instruments need not be the truth, only independent of noise.
    instruments = [x + 0.2 * rng.normal(size=x.shape) for x in true]
    return equations_of(noisy, torques), equations_of(instruments, torques)


class TestProjectedFit:
    def test_residuals_are_orthogonal_to_instruments(self, rng: np.random.Generator) -> None:
        equations, instruments = draw(rng, noise=0.5, error=0.1)
        k = np.asarray(projected_fit(equations, instruments, INDEPENDENT, 300).fit.k)
        weights = np.array([2.0, 0.5]) ** 2
        left = sum(
            w * z.T @ e
            for w, z, e in zip(weights, wide_rows(instruments), equations.errors(k), strict=True)
        )
        assert np.max(np.abs(left)) < ROUNDING * 300

    def test_standard_errors_are_the_textbook_s(self, rng: np.random.Generator) -> None:
        """(ZᵀX)⁻¹ ZᵀZ (XᵀZ)⁻¹ σ², with residuals of X."""
        equations, instruments = draw(rng, noise=0.5, error=0.1)
        fit = projected_fit(equations, instruments, INDEPENDENT, 300).fit
        weights = (2.0, 0.5)
        x, z = (
            np.concatenate([w * rows for w, rows in zip(weights, wide_rows(some), strict=True)])
            for some in (equations, instruments)
        )
        errors = zip(weights, equations.errors(np.asarray(fit.k)), strict=True)
        squares = np.sum(np.concatenate([w * e for w, e in errors]) ** 2)
        inverse = np.linalg.inv(z.T @ x)
        covariance = squares / (600 - 4) * inverse @ (z.T @ z) @ inverse.T
        assert_allclose(fit.covariance, covariance, rtol=1e-8)
        rms = [np.sqrt(np.mean(e**2)) for e in equations.errors(np.asarray(fit.k))]
        assert_allclose(fit.torque_error, rms, rtol=1e-9)

    def test_a_regressor_that_is_its_own_instrument(self, rng: np.random.Generator) -> None:
        equations, _ = draw(rng, noise=0.5, error=0.1)
        for solver in (INDEPENDENT, jc.LeastSquares(errors="independent")):
            fit = projected_fit(equations, equations, solver, 300).fit
            ordinary = solver.fit_equations(equations, 300)
            assert_allclose(fit.k, ordinary.k, rtol=1e-9)
            assert_allclose(fit.standard_error, ordinary.standard_error, rtol=1e-6)

    def test_instruments_have_no_bias(self, rng: np.random.Generator) -> None:
        equations, instruments = draw(rng, noise=0.7, error=0.1, rows=20000)
        fit = projected_fit(equations, instruments, INDEPENDENT, 20000).fit
        deviation = (np.asarray(fit.k) - 1.0) / np.asarray(fit.standard_error)
        assert np.max(np.abs(deviation)) < 4.0
        ordinary = INDEPENDENT.fit_equations(equations, 20000)
        assert np.all(np.asarray(ordinary.k) < 0.8)

    def test_what_no_instrument_moves_is_not_determined(self, rng: np.random.Generator) -> None:
        equations, instruments = draw(rng, noise=0.5, error=0.1)
        still = instruments.without([0])
        fit = projected_fit(equations, still, INDEPENDENT, 300).fit
        assert int(fit.rank) == 3
        assert not fit.determined[0]


class TestExogeneity:
    def test_unbiased_regressions_are_rejected_as_often_as_it_says(
        self, rng: np.random.Generator
    ) -> None:
        draws = [draw(rng, noise=0.0, error=0.3, rows=100) for _ in range(200)]
        # Weights are estimated: with those of other variances, F has no F distribution.
        solver = jc.LeastSquares(errors="independent")
        rejected = [
            exogeneity_test(equations, projected_fit(equations, others, solver, 100)).p_value < 0.05
            for equations, others in draws
        ]
        # Three standard deviations of 200 draws of 5 %.
        assert abs(np.mean(rejected) - 0.05) < 3 * np.sqrt(0.05 * 0.95 / 200)

    def test_biased_ones_are_seen(self, rng: np.random.Generator) -> None:
        equations, instruments = draw(rng, noise=0.3, error=0.3)
        test = exogeneity_test(equations, projected_fit(equations, instruments, INDEPENDENT, 300))
        assert test.p_value < 1e-6
        assert "least squares is biased" in str(test)

    def test_without_noise_there_is_nothing_to_add(self, rng: np.random.Generator) -> None:
        equations, _ = draw(rng, noise=0.0, error=0.3)
        test = exogeneity_test(equations, projected_fit(equations, equations, INDEPENDENT, 300))
        assert test.p_value == 1.0


@pytest.fixture(scope="module")
def arm() -> jc.CSLC:
    return arms.planar_arm("viscous", "dry")


SAMPLES, INTERVAL = 1500, 0.004


@pytest.fixture(scope="module")
def motion() -> ControlledMotion:
    t = INTERVAL * np.arange(SAMPLES)[:, None]
    rate, size = np.array([2.0, 3.1]), np.array([0.8, 0.6])
    desired = Reference(
        size * (1 - np.cos(rate * t)),
        size * rate * np.sin(rate * t),
        size * rate**2 * np.cos(rate * t),
    )
    return ControlledMotion(PID(2, position_gain=[400.0, 60.0], velocity_gain=[30.0, 5.0]), desired)


@pytest.fixture(scope="module")
def truth(arm: jc.CSLC) -> np.ndarray:
    links = (
        jc.LinkParameters(2.0, np.array([0.2, 0.01, 0.0]), np.diag([0.01, 0.1, 0.1]), 0.05),
        jc.LinkParameters(1.0, np.array([0.15, 0.02, 0.0]), np.diag([0.01, 0.05, 0.05]), 0.03),
    )
    return np.asarray(arm.coefficients_from(links, viscous=[0.8, 0.4], dry=[0.6, 0.3]))


@pytest.fixture(scope="module")
def exact(arm: jc.CSLC, motion: ControlledMotion, truth: np.ndarray) -> jc.Recording:
    """Torques that agree with the simulated motion to rounding."""
    t = INTERVAL * np.arange(SAMPLES)
    start = jc.Recording(t, motion.reference.q, motion.reference.q)
    q, qd, qdd = motion.simulate(arm, truth, start, jc.Settings())
    return jc.Recording(t, q, np.asarray(arm.torque(truth, q, qd, qdd)))


def test_direct_dynamics_need_no_positions(
    arm: jc.CSLC, motion: ControlledMotion, truth: np.ndarray, exact: jc.Recording
) -> None:
    """From coefficients that are a tenth off, with positions of which nothing can be seen."""
    settings = jc.Settings()
    regression = settings.fit(arm, settings.patterns(exact))
    start = eqx.tree_at(lambda fit: fit.k, regression, 1.1 * regression.k)
    rough = 2e-3 * np.random.default_rng(0).normal(size=exact.position.shape)
    rough[0] = 0.0  # the arm starts as the recording does
    recording = jc.Recording(exact.time, exact.position + rough, exact.torque)
    result = jc.DirectDynamics(motion, iterations=30).fit(arm, recording, start)
    assert result.converged and result.exogeneity is None
    assert_allclose(result.k, truth, atol=1e-6)
    assert np.max(np.abs(np.asarray(result.least_squares.k) - truth)) > 0.02


def test_of_unbiased_fits_of_an_arm_few_are_rejected(
    arm: jc.CSLC, motion: ControlledMotion, truth: np.ndarray, exact: jc.Recording
) -> None:
    """Motion is known exactly, torques are noisy: instruments are of what least squares makes."""
    preparation, solver = jc.Preparation(), jc.LeastSquares()
    moved = motion.simulate(arm, truth, exact, jc.Settings())
    rejected: list[bool] = []
    for seed in range(40):
        noise = 0.1 * np.random.default_rng(seed).normal(size=exact.torque.shape)
        recording = jc.Recording(exact.time, exact.position, exact.torque + noise)
        measured = preparation.patterns(recording, moved)
        k = np.asarray(solver.fit(arm, measured).k)
        again = motion.simulate(arm, k, recording, jc.Settings())
        simulated = preparation.patterns(recording, again)
        settings = jc.Settings(preparation, solver)
        _, test = jc.InstrumentalVariables().solve(arm, settings, measured, simulated)
        rejected.append(test.p_value < 0.05)
    # Three standard deviations of 40 draws of 5 %.
    assert np.mean(rejected) < 0.05 + 3 * np.sqrt(0.05 * 0.95 / 40)


@pytest.mark.parametrize("simulated", ["controlled", "corrected"])
def test_instruments_take_out_the_bias_of_noisy_accelerations(
    simulated: str, arm: jc.CSLC, motion: ControlledMotion, truth: np.ndarray, exact: jc.Recording
) -> None:
    noise = 2e-5 * np.random.default_rng(1).normal(size=exact.position.shape)
    recording = jc.Recording(exact.time, exact.position + noise, exact.torque)
    settings = jc.Settings(jc.Preparation(jc.AveragedSplines(3)))
    way = motion if simulated == "controlled" else CorrectedMotion()
    result = jc.InstrumentalVariables(way, settings).fit(arm, recording)
    error = np.asarray(result.fit.standard_error)
    deviation, ordinary = (
        np.abs(np.asarray(k) - truth) / error for k in (result.k, result.least_squares.k)
    )
    assert result.converged
    assert np.max(deviation) < 4.0 < 15.0 < np.max(ordinary)  # 18 to 75 by noise
    assert result.exogeneity is not None and result.exogeneity.p_value < 1e-6


def test_from_coefficients_of_no_body(
    arm: jc.CSLC, motion: ControlledMotion, exact: jc.Recording
) -> None:
    """The nearest bodies are simulated in their stead."""
    pytest.importorskip("clarabel")
    settings = jc.Settings()
    regression = settings.fit(arm, settings.patterns(exact))
    wrong = np.where(np.arange(arm.size) == 0, -0.5, np.asarray(regression.k))
    start = eqx.tree_at(lambda fit: fit.k, regression, jnp.asarray(wrong))
    result, ordinary = (
        jc.InstrumentalVariables(motion).fit(arm, exact, first) for first in (start, None)
    )
    error = np.asarray(result.fit.standard_error)
    assert np.max(np.abs(np.asarray(result.k) - np.asarray(ordinary.k)) / error) < 0.1


class TestFailures:
    def test_another_number_of_joints(self, arm: jc.CSLC) -> None:
        t = INTERVAL * np.arange(100)
        recording = jc.Recording(t, np.zeros((100, 3)), np.zeros((100, 3)))
        with pytest.raises(ValueError, match="3 joints; expected 2"):
            jc.InstrumentalVariables().fit(arm, recording)

    def test_a_robust_loss(self, arm: jc.CSLC, exact: jc.Recording) -> None:
        settings = jc.Settings(solver=jc.LeastSquares(loss="huber"))
        with pytest.raises(ValueError, match="loss is 'huber'; expected 'squared'"):
            jc.InstrumentalVariables(settings=settings).fit(arm, exact)

    def test_no_iterations(self, motion: ControlledMotion) -> None:
        with pytest.raises(ValueError, match="iterations is 0; expected 1 or more"):
            jc.InstrumentalVariables(iterations=0)
        with pytest.raises(ValueError, match="iterations is 0; expected 1 or more"):
            jc.DirectDynamics(motion, iterations=0)
