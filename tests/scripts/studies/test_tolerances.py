"""The study of tolerances: estimates and standard errors against hand formulas, and a tiny run."""

import csv
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Float
from numpy.testing import assert_allclose

from jaxcslc.training import Backpropagation, IdealPERAL
from scripts.studies.training import tolerances


EPOCHS = 8000


@pytest.fixture(scope="module")
def noisy() -> tolerances.Noisy:
    """Six draws of noise on 160 patterns of correlated inputs."""
    return tolerances.problem_of(tolerances.CORRELATED, 160, 6, 0.05)


def regressor(problem: tolerances.Noisy) -> Float[np.ndarray, "patterns weights"]:
    """Inputs with the bias's."""
    inputs = np.asarray(problem.clean.signals.inputs[0]).T
    return np.hstack([inputs, np.ones((len(inputs), 1))])


def instruments(problem: tolerances.Noisy) -> Float[np.ndarray, "patterns weights"]:
    """Of ideal PERAL: signs of inputs over the moduli that a pattern's error is shared among."""
    x = regressor(problem)
    return np.sign(x) / (np.abs(x) @ np.abs(problem.truth))[:, None]


def test_inputs_are_the_regressor(noisy: tolerances.Noisy) -> None:
    assert_allclose(noisy.inputs[:, 0, :].T, regressor(noisy), atol=1e-12)


def test_noise_has_its_size() -> None:
    many = tolerances.problem_of(tolerances.INDEPENDENT, 200, 50, 0.1)
    targets = np.asarray(many.clean.targets)
    assert_allclose(many.noise.std(), 0.1 * targets.std(), rtol=0.03)


def test_ideal_peral_comes_to_rest_at_its_instruments(noisy: tolerances.Noisy) -> None:
    """Where Z'(y - X w) = 0, whatever the start: an estimator by instrumental variables."""
    rule = IdealPERAL(jnp.asarray(noisy.truth))
    jacobian = tolerances.change_jacobian(noisy, rule)
    rate = 0.5 * tolerances.shrinking_rate(jacobian)
    x, z = regressor(noisy), instruments(noisy)
    targets = x @ noisy.truth + noisy.noise[:, 0]
    expected = np.linalg.solve(z.T @ x, z.T @ targets.T).T
    for start in (noisy.truth, 1.4 * noisy.truth):
        weights = tolerances.trained(noisy, rule, rate, EPOCHS, start)
        assert_allclose(weights, expected, rtol=1e-6)


def test_standard_errors_by_hand(noisy: tolerances.Noisy) -> None:
    x, z = regressor(noisy), instruments(noisy)
    variance = noisy.deviation[0] ** 2
    least = np.sqrt(variance * np.diag(np.linalg.inv(x.T @ x)))
    inverse = np.linalg.inv(z.T @ x)
    ideal = np.sqrt(variance * np.diag(inverse @ z.T @ z @ inverse.T))
    for rule, expected in (
        (Backpropagation(), least),
        (IdealPERAL(jnp.asarray(noisy.truth)), ideal),
    ):
        errors = tolerances.standard_errors(noisy, rule, tolerances.change_jacobian(noisy, rule))
        assert_allclose(errors, expected, rtol=1e-9)
    assert np.all(ideal >= least)  # Gauss and Markov


def test_least_squares(noisy: tolerances.Noisy) -> None:
    x = regressor(noisy)
    for weights, noise in zip(tolerances.least_squares(noisy), noisy.noise, strict=True):
        expected = np.linalg.lstsq(x, x @ noisy.truth + noise[0], rcond=None)[0]
        assert_allclose(weights, expected, rtol=1e-8)


def test_a_tiny_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--quick", "--patterns", "40", "--seeds", "6", "--epochs", "200"]
    assert tolerances.main([*arguments, "-o", str(tmp_path)]) == 0
    assert "over weights: the rule" in capsys.readouterr().out
    with (tmp_path / "tolerances.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3 * 9
    of_least = [row for row in rows if row["method"] == tolerances.LEAST_SQUARES]
    assert all(row["the rule"] == row["least squares"] for row in of_least)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--problems", "pendulum"], "no problem is called 'pendulum'"),
        (["--seeds", "2"], "--seeds is 2; expected 3 or more"),
        (["--noise", "0"], "--noise is 0.0; expected more than 0"),
    ],
)
def test_bad_options(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        tolerances.main(arguments)
    assert message in capsys.readouterr().err
