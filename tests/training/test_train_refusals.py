"""What `train` and `Plan` refuse, in one line each."""

from typing import Any

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

from jaxcslc.training import PERAL, Backpropagation, Examples, FixedRates, Plan, Schedule, train
from tests.training.conftest import Problem


B = Backpropagation()
WRONG: list[tuple[dict[str, Any], str]] = [
    ({"weights": np.zeros(5)}, r"^weights: expected shape \(4,\) or \(trainings, 4\), got \(5,\)"),
    ({"weights": np.zeros((2, 3))}, r"^weights: expected shape .*, got \(2, 3\)"),
    ({"weights": np.zeros(4, np.float32)}, r"needs float64"),
    ({"plan": Plan(B, frozen=["x"])}, r"^frozen: expected some of network, got 'x'"),
    ({"plan": Plan(B, frozen=["network"])}, r"^frozen: every layer is; nothing is left to learn"),
    (
        {"plan": Plan(B, FixedRates(np.ones(2)))},
        r"^rates: expected one number, or one for each of network, got shape \(2,\)",
    ),
    ({"plan": PERAL(), "weights": np.zeros(4)}, r"PERAL cannot start from weights .* all zero"),
    ({"plan": Plan(B, target=jnp.ones(3))}, r"^target: expected one, got shape \(3,\)"),
    (
        {"plan": Plan(Schedule((B,), jnp.ones(3))), "weights": np.ones((2, 4))},
        r"^hand_over: expected one, or for each of 2 trainings, got shape \(3,\)",
    ),
    ({"key": jax.random.split(jax.random.key(0), 2)}, r"^key: expected one, got shape \(2,\)"),
    ({"chunk": 0}, r"^epochs, chunk, block: expected no less than 0, 1 and 1"),
    ({"block": 0}, r"^epochs, chunk, block"),
    ({"epochs": -1}, r"^epochs, chunk, block"),
]


@pytest.mark.parametrize(("change", "message"), WRONG)
def test_refused(line: Problem, change: dict[str, Any], message: str) -> None:
    arguments: dict[str, Any] = {"weights": line.start, "plan": Backpropagation(), **change}
    weights, plan = arguments.pop("weights"), arguments.pop("plan")
    with pytest.raises(ValueError, match=message) as raised:
        train(line.network, line.training_set, weights, plan, **arguments)
    assert "\n" not in str(raised.value)


def test_patterns_in_single_precision_are_refused(line: Problem) -> None:
    training_set: Examples = jax.tree.map(lambda x: x.astype(jnp.float32), line.training_set)
    for patterns, stop_set in ((training_set, None), (line.training_set, training_set)):
        with pytest.raises(ValueError, match="needs float64"):
            train(line.network, patterns, line.start, Backpropagation(), stop_set=stop_set)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"patience": 0}, "^patience, stop_patience: expected at least one epoch"),
        ({"stop_patience": 0}, "^patience, stop_patience: expected at least one epoch"),
        ({"rates": [FixedRates(0.1)] * 2}, "^rates: expected one for each of 1 rules, got 2"),
    ],
)
def test_plans_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Plan(Backpropagation(), **options)


def test_an_unknown_order_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """As users see it, to whom annotations are not checked."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    unknown: Any = "random"
    with pytest.raises(ValueError, match=r"^order: expected 'batch' or 'sequential', got 'random'"):
        Plan(Backpropagation(), order=unknown)
