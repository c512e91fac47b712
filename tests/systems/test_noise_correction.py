"""What measurement noise does to coefficients, against closed forms and another method."""

import dataclasses
import json
from pathlib import Path

import jax
import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.least_squares import WeightedEquations
from jaxcslc.recordings import AbstractSmoothing
from jaxcslc.systems import (
    Constant,
    NoiseCorrection,
    System,
    SystemRecording,
    Variable,
    correct_for_noise,
    identify_system,
    measurement_noise,
    system_patterns,
)
from jaxcslc.systems._recording import level_error
from tests.systems.conftest import INTERVAL, SAMPLES, TRUE_CART, cart_motion


jax.config.update("jax_enable_x64", True)

SETTINGS = jc.Settings(jc.Preparation(jc.SavitzkyGolay(15, 5)))
POSITION = 6e-5  # noise of the cart's position [m]
FORCE = 0.02  # [N]


def noisy(
    recording: SystemRecording, deviation: dict[str, float], rng: np.random.Generator
) -> SystemRecording:
    columns = {
        name: values + deviation.get(name, 0.0) * rng.normal(size=len(values))
        for name, values in recording.columns.items()
    }
    return SystemRecording(recording.time, columns)


def corrected(
    system: System, recording: SystemRecording, settings: jc.Settings = SETTINGS, **options: object
) -> tuple[jc.Identification, NoiseCorrection]:
    patterns = system_patterns(system, recording, settings.preparation)
    fit = settings.fit(system.network, patterns)
    correction = correct_for_noise(system, recording, patterns, settings, fit, **options)  # pyright: ignore
    return fit, correction


@pytest.fixture(scope="module")
def line() -> System:
    """A resistance, its current and voltage as measured."""
    import sympy

    current, voltage, resistance = sympy.symbols("current voltage resistance")
    return System(
        "wire",
        {"Ohm": sympy.Eq(voltage, resistance * current)},
        (Variable(current, "A"), Variable(voltage, "V")),
        (Constant(resistance, "Ohm"),),
    )


@pytest.fixture(scope="module")
def tank() -> System:
    """A tank that only fills."""
    import sympy
    from sympy.physics.mechanics import dynamicsymbols

    level, inflow = dynamicsymbols("level inflow")
    area = sympy.Symbol("area")
    return System(
        "tank",
        {"volume": sympy.Eq(inflow, area * level.diff())},
        (Variable(level, "m"), Variable(inflow, "m³/s")),
        (Constant(area, "m²"),),
    )


class TestStrength:
    def test_polynomials_of_fifth_order_are_no_noise(
        self, line: System, rng: np.random.Generator
    ) -> None:
        """Nor at irregular instants."""
        time = np.cumsum(rng.uniform(0.5, 1.5, 200))
        powers = (time / time[-1])[:, None] ** np.arange(6)
        columns = {"current": powers @ rng.normal(size=6), "voltage": 0 * time}
        strength = measurement_noise(line, SystemRecording(time, columns))
        assert strength["current"] < 1e-12 and strength["voltage"] == 0.0

    @pytest.mark.parametrize("regular", [True, False])
    def test_white_noise_keeps_its_deviation(
        self, line: System, rng: np.random.Generator, regular: bool
    ) -> None:
        time = np.cumsum(np.ones(8000) if regular else rng.uniform(0.8, 1.2, 8000))
        clean = {"current": np.sin(time / 10), "voltage": (time // 400) % 2}  # steps
        recording = noisy(SystemRecording(time, clean), {"current": 0.02, "voltage": 0.3}, rng)
        strength = measurement_noise(line, recording)
        assert strength == pytest.approx({"current": 0.02, "voltage": 0.3}, rel=0.06)

    @pytest.mark.parametrize("samples", [300, 3000])
    def test_it_is_as_certain_as_samples_are_many(
        self, line: System, rng: np.random.Generator, samples: int
    ) -> None:
        time = np.arange(float(samples))
        columns = {"current": rng.normal(size=samples), "voltage": rng.normal(size=samples)}
        levels = [
            measurement_noise(
                line, SystemRecording(time, {n: rng.permutation(x) for n, x in columns.items()})
            ).values()
            for _ in range(100)
        ]
        spread = np.std([list(some) for some in levels])
        # Of 200 values, the deviation is good to 5 %.
        assert spread == pytest.approx(level_error(samples), rel=0.2)

    def test_an_encoder_that_mostly_rests_has_noise(self, line: System) -> None:
        time = np.arange(1000.0)
        columns = {"current": (time > 900) * (time % 2), "voltage": time}
        assert measurement_noise(line, SystemRecording(time, columns))["current"] > 0.1


class TestClosedForms:
    def test_noise_of_the_regressor_shrinks_a_coefficient_by_its_share(
        self, line: System, rng: np.random.Generator
    ) -> None:
        """Its part of the regressor's square is what is off, and what is put back, once.

        With once more that noise the coefficient is R p / (p + 2 s²) where it was R p / (p + s²).
        """
        time, power, variance = np.arange(20000) * 0.1, 0.5, 0.01
        exact = {"current": np.sin(time), "voltage": 3.0 * np.sin(time)}
        recording = noisy(SystemRecording(time, exact), {"current": np.sqrt(variance)}, rng)
        settings = jc.Settings(solver=jc.LeastSquares(errors="independent"))
        strength = {"current": float(np.sqrt(variance))}
        fit, correction = corrected(line, recording, settings, noise=strength, draws=12, pairs=12)
        off = lambda times: 3.0 * power / (power + times * variance)
        # Three of its deviations, 0.003 each.
        assert float(fit.k[0]) == pytest.approx(off(1), abs=0.01)
        expected = (off(2) - off(1)) * float(fit.k[0]) / off(1)
        assert correction.bias[0] == pytest.approx(expected, rel=0.03)
        assert abs(off(1) - expected - 3.0) < 0.06 * abs(off(1) - 3.0)

    def test_noise_of_the_known_side_has_no_bias_and_the_covariance_of_the_textbook(
        self, line: System, rng: np.random.Generator
    ) -> None:
        time = np.arange(300) * 0.1
        exact = {"current": np.sin(time), "voltage": 3.0 * np.sin(time)}
        recording = noisy(SystemRecording(time, exact), {"voltage": 0.1}, rng)
        settings = jc.Settings()
        fit, correction = corrected(line, recording, settings, noise={"voltage": 0.1}, draws=600)
        patterns = system_patterns(line, recording)
        expected = 0.1 / np.linalg.norm(np.asarray(patterns.q)[:, 0])
        assert correction.standard_error[0] == pytest.approx(expected, rel=0.12)
        np.testing.assert_allclose(correction.bias, 0.0, atol=1e-12)
        assert correction.explained and correction.fit.errors == "simulated"
        assert float(correction.fit.degrees_of_freedom) > 600
        np.testing.assert_allclose(correction.fit.k, fit.k)

    def test_stretches_apart_make_standard_errors_as_certain_as_more_draws(
        self, line: System, rng: np.random.Generator
    ) -> None:
        """Seeds scatter about the textbook's standard error as the degrees of freedom say."""
        time = np.arange(2000) * 0.1
        exact = {"current": np.sin(time), "voltage": 3.0 * np.sin(time)}
        recording = noisy(SystemRecording(time, exact), {"voltage": 0.1}, rng)
        patterns = system_patterns(line, recording)
        expected = 0.1 / np.linalg.norm(np.asarray(patterns.q)[:, 0])
        ratios, degrees = [], []
        for seed in range(20):
            _, correction = corrected(
                line, recording, jc.Settings(), noise={"voltage": 0.1}, draws=20, seed=seed
            )
            ratios.append(correction.standard_error[0] / expected)
            degrees.append(float(correction.fit.degrees_of_freedom))
        typical = np.median(degrees)
        assert typical > 10 * 20
        # A deviation of 20 values is good to 16 %, their mean to a quarter of it.
        assert np.std(ratios) == pytest.approx((2.0 * typical) ** -0.5, rel=0.5)
        assert np.mean(ratios) == pytest.approx(1.0, abs=(2.0 * typical) ** -0.5)

    def test_the_linear_part_is_the_fit_s_derivative(
        self, cart: System, rng: np.random.Generator
    ) -> None:
        """The spread of the coefficients of recordings that differ in small noise alone."""
        settings = settings_with(8.0)
        strength = {"x": 1e-6, "force": FORCE}
        exact = cart_motion(0.3)
        coefficients = []
        for _ in range(30):
            patterns = system_patterns(cart, noisy(exact, strength, rng), settings.preparation)
            patterns = dataclasses.replace(
                patterns, friction_mask=np.abs(np.asarray(patterns.qd[:, :1])) > 0.1
            )
            coefficients.append(np.asarray(settings.fit(cart.network, patterns).k))
        _, correction = corrected(cart, noisy(exact, strength, rng), settings, noise=strength)
        spread = np.std(coefficients, axis=0, ddof=1)
        # Ratio of deviations of 30 and 100 draws: a deviation of 15 %.
        np.testing.assert_allclose(correction.standard_error / spread, 1.0, atol=0.5)


def settings_with(cutoff: float | None) -> jc.Settings:
    preparation = dataclasses.replace(SETTINGS.preparation, thresholds=0.1)
    return jc.Settings(preparation, jc.LeastSquares(cutoff=cutoff, errors="independent"))


def test_coefficients_of_a_cart_are_right_on_average(
    cart: System, rng: np.random.Generator
) -> None:
    """Instrumental variables are the oracle: the regressor of another recording of that motion has
    noise of its own."""
    strength = {"x": POSITION, "force": FORCE}
    exact, settings = cart_motion(0.3), settings_with(None)
    mass = cart.network.names.index("mass")
    plain, after, instrumental = [], [], []
    for _ in range(10):
        first, second = (noisy(exact, strength, rng) for _ in range(2))
        fit, correction = corrected(cart, first, settings, draws=8, pairs=4)
        plain.append(np.asarray(fit.k))
        after.append(np.asarray(correction.fit.k))
        both = [system_patterns(cart, some, settings.preparation) for some in (first, second)]
        rows = np.asarray(both[0].mask)[:, 0] & np.asarray(both[1].mask)[:, 0]
        x, z = (np.asarray(cart.network.regressor(p.q, p.qd, p.qdd))[rows, 0] for p in both)
        target = np.asarray(both[0].torque)[rows, 0]
        instrumental.append(np.linalg.solve(z.T @ x, z.T @ target))
    off = {
        name: (np.mean(k, axis=0)[mass] - TRUE_CART["mass"]) / (np.std(k, axis=0)[mass] / 10**0.5)
        for name, k in (("plain", plain), ("after", after), ("instrumental", instrumental))
    }
    assert off["plain"] < -3.5, off  # the mass shrinks
    assert abs(off["after"]) < 3.5 and abs(off["instrumental"]) < 3.5, off


def test_changes_by_stretches_add_up(cart: System, rng: np.random.Generator) -> None:
    """Where masks leave samples out, and a filter keeps every so many of the others."""
    settings = settings_with(8.0)
    patterns = system_patterns(cart, cart_motion(0.3), settings.preparation)
    equations = settings.solver.equations(cart.network, patterns)
    k = np.array([TRUE_CART[name] for name in cart.network.names])
    problem = WeightedEquations.of(equations, k, settings.solver)
    changes = [rng.normal(size=(len(rows), 3)) for rows in equations.rows]
    parts = problem.shifts_of_stretches(changes, np.linspace(0, patterns.samples, 6).astype(int))
    assert parts.shape == (5, cart.network.order, 3) and np.all(np.any(parts != 0.0, axis=(1, 2)))
    np.testing.assert_allclose(np.sum(parts, axis=0), problem.shifts(changes), rtol=1e-9)


def test_errors_that_are_no_white_noise_keep_the_residuals_standard_errors(
    line: System, rng: np.random.Generator
) -> None:
    time = np.arange(2000) * 0.1
    exact = {"current": np.sin(time), "voltage": 3.0 * np.sin(time) + 0.1 * np.sin(0.13 * time)}
    recording = noisy(SystemRecording(time, exact), {"voltage": 0.01}, rng)
    fit, correction = corrected(line, recording, jc.Settings())
    assert not correction.explained
    (warning,) = correction.warnings
    assert (
        warning.startswith("equation Ohm: its errors are 7") and "a term may be missing" in warning
    )
    np.testing.assert_array_equal(correction.fit.standard_error, fit.standard_error)
    assert correction.fit.errors == "correlated"


def test_slow_errors_below_the_noise_are_seen_by_what_they_do_to_a_coefficient(
    line: System, rng: np.random.Generator
) -> None:
    time = np.arange(2000) * 0.1
    resistance = 3.0 + 0.008 * np.sin(0.13 * time)
    exact = {"current": np.sin(time), "voltage": resistance * np.sin(time)}
    recording = noisy(SystemRecording(time, exact), {"voltage": 0.01}, rng)
    fit, correction = corrected(line, recording, jc.Settings())
    assert float(correction.ratio[0]) < 1.15
    (warning,) = correction.warnings
    assert warning.startswith("resistance: errors of the equations that last longer")
    np.testing.assert_array_equal(correction.fit.standard_error, fit.standard_error)
    assert correction.standard_error[0] < 0.6 * float(fit.standard_error[0])


def test_noise_that_is_next_to_nothing_is_not_looked_into(
    line: System, rng: np.random.Generator
) -> None:
    time = np.arange(2000) * 0.1
    exact = {"current": np.sin(time), "voltage": 3.0 * np.sin(time) + 0.1 * np.sin(0.13 * time)}
    recording = noisy(SystemRecording(time, exact), {"voltage": 1e-4}, rng)
    fit, correction = corrected(line, recording, jc.Settings(), draws=50, pairs=2)
    assert correction.draws == 2 and not correction.explained
    np.testing.assert_array_equal(correction.fit.standard_error, fit.standard_error)


def test_noise_that_is_said_too_strong_takes_nothing_off(
    line: System, rng: np.random.Generator
) -> None:
    time = np.arange(2000) * 0.1
    exact = {"current": np.sin(time), "voltage": 3.0 * np.sin(time)}
    recording = noisy(SystemRecording(time, exact), {"current": 0.01}, rng)
    fit, correction = corrected(line, recording, jc.Settings(), noise={"current": 0.1})
    assert "no bias is taken off" in correction.warnings[0]
    np.testing.assert_array_equal(correction.fit.k, fit.k)


def test_reports_are_corrected_unless_told_otherwise(
    cart: System, rng: np.random.Generator, tmp_path: Path
) -> None:
    recording = noisy(cart_motion(0.3), {"x": POSITION, "force": FORCE}, rng)
    plain = identify_system(cart, recording, settings=SETTINGS, noise=None)
    assert plain.correction is None
    fit, expected = corrected(cart, recording)
    np.testing.assert_array_equal(plain.k, fit.k)
    report = identify_system(cart, recording, settings=SETTINGS)
    np.testing.assert_array_equal(report.k, expected.fit.k)
    assert report.correction is not None
    assert "noise of the columns: x " in str(report) and "its bias is taken off" in str(report)
    report.save(tmp_path, pictures=False)
    path = tmp_path / "identification.json"
    np.testing.assert_array_equal(jc.Identification.load(path).k, report.k)
    document = json.loads(path.read_text("utf-8"))
    assert document["noise"]["deviation"]["force"] == pytest.approx(FORCE, rel=0.2)
    assert document["noise"]["explained"] == report.correction.explained


def test_levels_that_noise_would_make_negative(rng: np.random.Generator) -> None:
    """A root of a level near zero: said in a warning, and the fit is as it was."""
    import sympy

    level, outflow, c = sympy.symbols("level outflow c")
    outlet = System(
        "outlet",
        {"flow": sympy.Eq(outflow, c * sympy.sqrt(level))},
        (Variable(level, "m"), Variable(outflow)),
        (Constant(c),),
    )
    height = np.linspace(0.001, 1.0, 400)
    columns = {"level": height, "outflow": 2 * np.sqrt(height)}
    recording = SystemRecording(np.arange(400.0), columns)
    report = identify_system(outlet, recording, noise={"level": 0.01}, settings=jc.Settings())
    assert any("takes it out of what the equations allow" in line for line in report.warnings)
    assert report.correction is None and float(report.k[0]) == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"noise": {"volts": 0.1}}, "noise: no column 'volts'; expected some of current, voltage"),
        ({"noise": {"current": -1.0}}, "noise: current is -1.0; expected 0 or more"),
        ({"draws": 1}, "draws is 1, pairs is 6; expected two draws or more"),
        ({"draws": 4, "pairs": 5}, "one pair or more but no more than draws"),
    ],
)
def test_wrong_options_are_named(line: System, options: dict[str, object], message: str) -> None:
    time = np.arange(100) * 0.1
    recording = SystemRecording(time, {"current": np.sin(time), "voltage": np.sin(time)})
    with pytest.raises(ValueError, match=message):
        corrected(line, recording, jc.Settings(), **options)


def test_searched_constants_are_refused() -> None:
    import sympy

    x, y, a, n = sympy.symbols("x y a n")
    variables, constants = (Variable(x), Variable(y)), (Constant(a), Constant(n, bounds=(0.2, 1.0)))
    power = System("power law", {"y": sympy.Eq(y, a * x**n)}, variables, constants)
    time = np.arange(1, SAMPLES) * INTERVAL
    recording = SystemRecording(time, {"x": time, "y": np.sqrt(time)})
    with pytest.raises(ValueError, match="power law: constants are searched"):
        corrected(power, recording, jc.Settings())


class TestSmoothing:
    """What smoothing takes out of motion without noise, from the motion smoothed once more."""

    @pytest.mark.parametrize("smoothing", [jc.SavitzkyGolay(41, 3), jc.Butterworth(0.5)])
    def test_one_frequency_is_damped_by_the_same_part_each_time(
        self, tank: System, smoothing: AbstractSmoothing
    ) -> None:
        """With a gain of G for the rate, fits of motion smoothed once and twice are A/G, A/G²."""
        time = np.arange(2000) * 0.05
        recording = SystemRecording(time, {"level": np.sin(time), "inflow": 2.0 * np.cos(time)})
        settings = jc.Settings(jc.Preparation(smoothing, trim=150))  # away from the ends
        fit, correction = corrected(tank, recording, settings, noise={})
        once = float(fit.k[0])
        assert abs(once - 2.0) > 1e-6
        assert correction.smoothing_bias[0] == pytest.approx(once**2 / 2.0 - once, rel=0.01)
        assert abs(float(correction.fit.k[0]) - 2.0) < 0.1 * abs(once - 2.0)

    def test_what_remains_is_of_second_order(self, tank: System) -> None:
        time = np.arange(2000) * 0.05
        recording = SystemRecording(time, {"level": np.sin(time), "inflow": 2.0 * np.cos(time)})
        settings = jc.Settings(jc.Preparation(jc.SavitzkyGolay(81, 3), trim=120))
        fit, correction = corrected(tank, recording, settings, noise={})
        part = float(fit.k[0]) / 2.0
        expected = 2.0 * part * (part - 1.0) * (2.0 - part - 1.0)
        assert correction.smoothing_remainder[0] == pytest.approx(expected, rel=0.05)

    def test_polynomials_and_inputs_lose_nothing(self, tank: System) -> None:
        time = np.arange(400) * 0.05
        recording = SystemRecording(time, {"level": time**2, "inflow": 4.0 * time})
        _, correction = corrected(tank, recording, SETTINGS, noise={})
        np.testing.assert_allclose(correction.smoothing_bias, 0.0, atol=1e-9)

    def test_a_cart_with_dry_friction_keeps_its_reversals_out(self, cart: System) -> None:
        """Nor does the jump of acceleration spread further when smoothed once more."""
        recording = cart_motion(0.3)
        preparation = jc.Preparation(jc.SavitzkyGolay(15, 5), thresholds=0.1, reversal_margin=8)
        fit, correction = corrected(cart, recording, jc.Settings(preparation), noise={})
        truth = np.array([TRUE_CART[name] for name in cart.network.names])
        off = np.asarray(fit.k) - truth
        assert np.max(np.abs(off / truth)) > 1e-5
        np.testing.assert_allclose(correction.fit.k, truth, atol=0.35 * np.max(np.abs(off)))

    def test_measured_rates_are_smoothed_as_they_were(self) -> None:
        import sympy
        from sympy.physics.mechanics import dynamicsymbols

        angle, torque = dynamicsymbols("angle torque")
        inertia, damping = sympy.symbols("inertia damping")
        equation = sympy.Eq(torque, inertia * angle.diff().diff() + damping * angle.diff())
        wheel = System(
            "wheel",
            {"axis": equation},
            (Variable(angle, "rad", rate="speed"), Variable(torque, "N m")),
            (Constant(inertia), Constant(damping)),
        )
        time = np.arange(2000) * 0.05
        columns = {
            "angle": np.sin(time),
            "speed": np.cos(time),
            "torque": -3.0 * np.sin(time) + 0.5 * np.cos(time),
        }
        settings = jc.Settings(jc.Preparation(jc.SavitzkyGolay(31, 3)))
        fit, correction = corrected(wheel, SystemRecording(time, columns), settings, noise={})
        truth = np.array([{"inertia": 3.0, "damping": 0.5}[n] for n in wheel.network.names])
        before, after = (np.abs(np.asarray(x.k) - truth) for x in (fit, correction.fit))
        assert np.all(before > 1e-5) and np.all(after < 0.25 * before), (before, after)
