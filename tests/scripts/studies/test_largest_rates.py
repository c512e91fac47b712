"""The study of largest rates: each measure against a hand formula, and a tiny run."""

import csv
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from jaxcslc.training import PERAL, Backpropagation, examples, fully_connected, half_square
from scripts.studies.training import largest_rates
from scripts.studies.training.peral_comparison import Problem


# Eight halvings of an interval of a factor of four, on a logarithmic scale.
BISECTED = 4 ** (1 / 2**8) - 1


def linear_problem(noise: float = 0.3) -> tuple[Problem, np.ndarray, np.ndarray, np.ndarray]:
    """A linear combiner, with its inputs, its targets and the weights that these come from."""
    network = fully_connected([3, 1], "linear combiner")
    rng = np.random.default_rng(1)
    x = np.hstack([rng.standard_normal((40, 3)) * [1.0, 2.0, 0.5], np.ones((40, 1))])
    truth = rng.uniform(1.0, 2.0, network.size)
    targets = x @ truth + noise * rng.standard_normal(40)
    of_training = examples(network, jnp.asarray(x[:, :3]), jnp.asarray(targets[:, None]))
    return Problem("PUMA 560", "", network, of_training, of_training), x, targets, truth


def largest(problem: Problem, rule: Any, weights: np.ndarray, epochs: int) -> float:
    return float(
        largest_rates.largest_rate(
            problem.network, rule, half_square, problem.first, jnp.asarray(weights),
            jnp.asarray(epochs),
        )
    )  # fmt: skip


def test_one_epoch_of_backpropagation_on_a_parabola() -> None:
    """Along the gradient g, the cost is back where it was after a rate of 2 g'g / g'Hg."""
    problem, x, targets, truth = linear_problem()
    hessian = x.T @ x / len(x)
    for weights in (np.zeros(4), truth + 0.1, truth * [1.0, 1.0, 1.3, 1.0]):
        gradient = -x.T @ (targets - x @ weights) / len(x)
        expected = 2.0 * gradient @ gradient / (gradient @ hessian @ gradient)
        assert_allclose(largest(problem, Backpropagation(), weights, 1), expected, rtol=BISECTED)


def test_epochs_on_end_come_to_the_largest_curvature() -> None:
    problem, x, _, truth = linear_problem()
    stable = 2.0 / np.linalg.eigvalsh(x.T @ x / len(x))[-1]
    rates = [largest(problem, Backpropagation(), truth + 0.5, n) for n in (1, 5, 60)]
    assert rates[0] >= rates[1] >= rates[2] >= stable * (1.0 - BISECTED)
    assert_allclose(rates[2], stable, rtol=0.1)


def test_at_the_minimum_no_rate_lowers_the_cost() -> None:
    problem, x, targets, _ = linear_problem()
    best = np.linalg.lstsq(x, targets, rcond=None)[0]
    # Beside it, by rounding's own size, there is nothing left to gain.
    assert largest(problem, PERAL(), best, 1) == 0.0


@pytest.mark.parametrize(
    ("jacobian", "expected"),
    [
        (np.diag([-2.0, -0.5]), 1.0),
        (np.array([[-1.0, 2.0], [-2.0, -1.0]]), 0.4),  # -1 ± 2i
        (np.diag([-2.0, 0.0]), 1.0),  # a direction that the rule does not see
    ],
)
def test_below_the_shrinking_rate_errors_shrink(jacobian: np.ndarray, expected: float) -> None:
    rate = largest_rates.shrinking_rate(jacobian)
    assert rate == pytest.approx(expected)
    radius = [
        np.max(np.abs(np.linalg.eigvals(np.eye(2) + factor * rate * jacobian)))
        for factor in (0.99, 1.01)
    ]
    assert radius[0] <= 1.0 < radius[1]


def test_directions_that_lead_away_are_counted() -> None:
    assert largest_rates.leading_away(np.diag([-2.0, 0.5, 0.0, 0.1])) == 2


def test_peral_of_one_node_is_stable_below_a_rate_of_two() -> None:
    """In parts of the weights its pull is a mean of matrices whose rows' moduli sum to one."""
    problem, _, _, truth = linear_problem(noise=0.0)

    def change(weights: jax.Array) -> jax.Array:
        return largest_rates.direction(problem.network, PERAL(), problem.first, weights)

    jacobian = np.asarray(jax.jacfwd(change)(jnp.asarray(truth)))
    scaled = jacobian / truth[:, None] * truth[None, :]
    assert np.max(np.sum(np.abs(scaled), axis=1)) <= 1.0 + 1e-12
    assert largest_rates.shrinking_rate(jacobian) >= 2.0


def test_a_tiny_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(largest_rates, "problem_of", lambda *_: linear_problem()[0])
    arguments = ["--problems", "PUMA, exact", "--costs", "half square", "--starts", "2"]
    arguments += ["--checkpoints", "0", "5", "--on-end", "5", "--hand-over", "8"]
    assert largest_rates.main([*arguments, "-o", str(tmp_path)]) == 0
    assert "epochs on end" in capsys.readouterr().out
    with (tmp_path / "rates.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * 2 * 2
    stable = {row["stable rate"] for row in rows if row["rule"] == "backpropagation"}
    assert len({round(float(x), 9) for x in stable}) == 1
    assert all(float(row["one epoch"]) >= float(row["epochs on end"]) for row in rows)
    assert (tmp_path / "rates.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--problems", "pendulum"], "no problem is called 'pendulum'"),
        (["--costs", "cubic"], "no cost is called 'cubic'"),
        (["--starts", "0"], "--starts is 0; expected 1 or more"),
        (["--checkpoints", "-1"], "--checkpoints begin at -1; expected 0 or more"),
    ],
)
def test_bad_options(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        largest_rates.main(arguments)
    assert message in capsys.readouterr().err
