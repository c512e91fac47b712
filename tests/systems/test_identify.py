"""From a recording of a system to its coefficients: patterns, solver, learning rules, report."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.recordings import RecordingError
from jaxcslc.systems import (
    System,
    SystemRecording,
    SystemReport,
    identify_system,
    load_system_recording,
    load_system_report,
    system_derivatives,
    system_patterns,
)
from jaxcslc.training import PERAL, AbstractRule, Backpropagation, examples, linear_combiner, train
from tests.conftest import run
from tests.systems.conftest import CART, SAMPLES, TRUE_CART, cart_motion


if TYPE_CHECKING:
    from jaxcslc.recordings import Patterns

# What splines of a few samples take out of sines of 5 rad/s sampled every 10 ms.
SMOOTHING = 2e-3


@pytest.fixture(scope="module")
def report(cart: System) -> SystemReport:
    return identify_system(cart, cart_motion(0.0), cart_motion(1.0))


@pytest.fixture(scope="module")
def patterns(report: SystemReport) -> "Patterns":
    return report.patterns["training"]


def truth(cart: System) -> np.ndarray:
    return cart.separation.values(TRUE_CART)


def test_coefficients_are_those_of_the_simulated_cart(cart: System, report: SystemReport) -> None:
    np.testing.assert_allclose(report.k, truth(cart), rtol=SMOOTHING)
    assert sorted(report.network.names) == ["damping", "dry", "mass"]
    assert float(report.errors["validation"].rms[0, 0]) < 0.05
    assert tuple(report.patterns) == ("training", "validation")


def test_slow_samples_of_dry_friction_are_left_out(cart: System, patterns: "Patterns") -> None:
    speed = np.abs(patterns.qd[:, 0])
    expected = speed > 0.03 * speed.max()
    np.testing.assert_array_equal(patterns.mask[:, 0], expected)
    assert 0 < expected.sum() < len(expected)


def test_measured_rates_take_the_place_of_differentiation(cart: System) -> None:
    recording = cart_motion(0.0)
    rate = 7.0 + np.zeros(SAMPLES)
    with_rate = SystemRecording(recording.time, {**recording.columns, "speed": rate})
    measured = load_from(CART.replace('x = { unit = "m" }', 'x = { unit = "m", rate = "speed" }'))
    _, qd, qdd = system_derivatives(measured, with_rate, jc.Preparation())
    np.testing.assert_allclose(qd[:, 0], 7.0)
    np.testing.assert_allclose(qdd[:, 0], 0.0, atol=1e-10)


def load_from(text: str) -> System:
    import tomllib

    from jaxcslc.systems._toml import system_from

    return system_from(tomllib.loads(text))


@pytest.mark.parametrize(
    "transform",
    [
        pytest.param(lambda f: f, id="eager"),
        pytest.param(jax.jit, id="jit"),
        pytest.param(jax.vmap, id="vmap"),
    ],
)
def test_output_is_the_regressor_times_coefficients(
    cart: System, rng: np.random.Generator, transform: Callable
) -> None:
    network, k = cart.network, jnp.asarray(truth(cart))
    q, qd, qdd = rng.normal(size=(3, 4, 2))
    output = transform(lambda q, qd, qdd: network.torque(k, q, qd, qdd))(q, qd, qdd)
    regressor = transform(network.regressor)(q, qd, qdd)
    expected = 2.0 * qdd[:, :1] + 0.5 * qd[:, :1] + 0.3 * np.sign(qd[:, :1])
    np.testing.assert_allclose(output, expected, rtol=1e-14)
    np.testing.assert_allclose(regressor @ k, expected, rtol=1e-14)
    np.testing.assert_allclose(network.known(q, qd, qdd), q[:, 1:])


def test_columns_are_the_regressor_without_zeros(cart: System, rng: np.random.Generator) -> None:
    network, (q, qd, qdd) = cart.network, jnp.asarray(rng.normal(size=(3, 4, 2)))
    (columns,) = network.columns(q.T, qd.T, qdd.T)
    regressor = network.regressor(q, qd, qdd)[:, 0, list(network.support[0])]
    np.testing.assert_allclose(columns.T, regressor)


@pytest.mark.parametrize("rule", [Backpropagation(), PERAL()], ids=lambda rule: type(rule).__name__)
def test_learning_rules_end_where_the_direct_solve_does(
    cart: System, patterns: "Patterns", report: SystemReport, rule: AbstractRule
) -> None:
    network = linear_combiner(cart.network)
    training_set = examples(network, patterns, patterns.torque, patterns.mask)
    start = 0.5 * jnp.asarray(truth(cart))  # PERAL cannot start from zeros
    training = train(network, training_set, start, rule, epochs=300, throw=False)
    np.testing.assert_allclose(training.weights, report.k, rtol=0.05)


def test_report_is_printed_and_saved(report: SystemReport, tmp_path: Path) -> None:
    text = str(report)
    assert "equation error, validation recording" in text
    assert "mass" in text and "well determined" in text
    assert "\nequation rail" in text and "RMS error" in text
    files = report.save(tmp_path / "results", pictures=False)
    assert {path.name for path in files} == {
        "index.html",
        "coefficients.csv",
        "identification.json",
        *(f"{stem}_{name}.csv" for stem in ("errors", "known_sides") for name in report.patterns),
    }
    document = json.loads((tmp_path / "results" / "identification.json").read_text("utf-8"))
    assert set(document["separated"]["rail"]["regressor"]) == {"mass", "damping", "dry"}
    again = jc.Identification.load(tmp_path / "results" / "identification.json")
    np.testing.assert_array_equal(again.k, report.k)
    assert report.to_pandas().loc["mass", "unit"] == "kg"


def test_reports_are_read_back(report: SystemReport, tmp_path: Path) -> None:
    """Text, page and files of the report that was saved; also of one without a simulation."""
    without = dataclasses.replace(report, simulation="no equation has the mass")
    for number, written in enumerate((report, without)):
        folder = tmp_path / str(number)
        written.save(folder)
        saved = load_system_report(folder)
        assert str(saved) == str(written) and saved.verdict == written.verdict
        np.testing.assert_array_equal(saved.covariance, written.covariance)
        assert saved.constants == written.constants and saved.rows() == written.rows()
        with pytest.raises(AttributeError, match="do not hold"):
            saved.network  # noqa: B018
        saved.save(tmp_path / "again")
        for path in (tmp_path / "again").glob("[!.]*"):
            assert path.read_text("utf-8") == (folder / path.name).read_text("utf-8")
    assert "not simulated: no equation has the mass" in str(without)


def write_csv(recording: SystemRecording, path: Path, *, without: str = "") -> Path:
    table = {"time": recording.time, **recording.columns}
    table.pop(without, None)
    rows = np.stack(list(table.values()), axis=1)
    np.savetxt(path, rows, delimiter=",", header=",".join(table), comments="", fmt="%.17g")
    return path


def test_commands_take_a_system_file(tmp_path: Path, report: SystemReport) -> None:
    system = tmp_path / "cart.toml"
    system.write_text(CART, encoding="utf-8")
    derived = run("derive", system, "-o", tmp_path / "derived")
    assert derived.exit_code == 0, derived.output
    assert "rail: force = " in derived.output
    assert (tmp_path / "derived" / "system.json").exists()
    training = write_csv(cart_motion(0.0), tmp_path / "train.csv")
    validation = write_csv(cart_motion(1.0), tmp_path / "validation.csv")
    output = tmp_path / "results"
    result = run("identify", system, training, "--validate", validation, "-o", output)
    assert result.exit_code == 0, result.output
    fit = jc.Identification.load(output / "identification.json")
    np.testing.assert_allclose(fit.k, report.k, rtol=1e-12)


def test_wrong_commands_end_in_one_line(tmp_path: Path) -> None:
    system = tmp_path / "cart.toml"
    system.write_text(CART, encoding="utf-8")
    training = write_csv(cart_motion(0.0), tmp_path / "train.csv", without="force")
    result = run("identify", system, training, "-o", tmp_path / "results")
    assert result.exit_code == 2
    assert "missing column 'force'; the file has time, x" in result.stderr
    result = run("derive", system, "--base", "link0")
    assert result.exit_code == 2
    assert "--base is for robots; " in result.stderr
    result = run("identify", system, training, "--no-check", "-o", tmp_path / "results")
    assert result.exit_code == 2
    assert "--no-check is for robots; " in result.stderr


def test_a_recording_is_checked() -> None:
    time = np.arange(10) * 0.1
    with pytest.raises(RecordingError, match="missing column 'force'; the recording has time, x"):
        SystemRecording(time, {"x": time}).column("force")
    with pytest.raises(RecordingError, match="column 'x' has shape"):
        SystemRecording(time, {"x": time[:5]})
    with pytest.raises(RecordingError, match="sample 4, x: nan"):
        SystemRecording(time, {"x": np.where(np.arange(10) == 3, np.nan, 1.0)})


def test_a_file_may_have_other_columns(cart: System, tmp_path: Path) -> None:
    path = tmp_path / "notes.csv"
    rows = "".join(f"{0.1 * i:.1f},{i},note {i},{2 * i}\n" for i in range(6))
    path.write_text("time,x,remark,force\n" + rows)
    assert sorted(load_system_recording(path, cart).columns) == ["force", "x"]


def test_options_of_joints_are_refused(cart: System) -> None:
    with pytest.raises(ValueError, match="expected backlash=False"):
        system_patterns(cart, cart_motion(0.0), jc.Preparation(backlash=True))


def test_states_outside_of_a_function_are_named() -> None:
    tank = load_from(
        'name = "tank"\nvariables = { h = {}, u = {} }\nconstants = { a = {}, c = {} }\n'
        'equations = { volume = "u = a*dot(h) + c*sqrt(h)" }'
    )
    time = np.arange(100) * 0.1
    recording = SystemRecording(time, {"h": 1.95 - time, "u": time})
    with pytest.raises(ValueError, match="'volume', what multiplies c: nan at sample 21"):
        system_patterns(tank, recording)
