"""The study of PERAL: its counts, its goals, its problems, and a tiny run."""

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.testing import assert_allclose, assert_array_equal

import jaxcslc as jc
import sim
from jaxcslc.training import (
    HYPERBOLIC_TANGENT as TANH,
    PERAL,
    AdaptiveNetwork,
    Backpropagation,
    ContextLayer,
    Layer,
    Links,
    Signals,
    Subnetwork,
    examples,
    fully_connected,
    half_square,
    inverse_dynamics,
)
from scripts.studies.training import (
    peral,
    peral_comparison as comparison,
    peral_operations as operations,
    peral_tables as tables,
    ultrasound,
)
from scripts.studies.training.learning_pictures import Learning, learning_picture


def linear_problem(seeds: int) -> Any:
    """Noisy answers of a linear combiner, another noise for every seed."""
    network = fully_connected([4, 2], "linear combiner")
    rng = np.random.default_rng(3)
    inputs, truth = rng.standard_normal((40, 4)), rng.uniform(1.0, 2.0, network.size)
    clean = network.outputs(jnp.asarray(truth), jnp.asarray(inputs))
    by_seed = [
        examples(
            network, jnp.asarray(inputs), clean + 0.3 * jnp.asarray(rng.standard_normal((40, 2)))
        )
        for _ in range(seeds)
    ]
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *by_seed)
    return comparison.Problem("PUMA 560", "noise 10%", network, stacked, by_seed[0])


def test_counts_of_the_thesis_s_networks(puma: jc.CSLC) -> None:
    ears = fully_connected([25, 10], "hyperbolic tangent")
    assert operations.counted(ears) == {"backpropagation": 1080, "PERAL": 1840}
    for name, printed in operations.THESIS_IDENTIFICATION.items():
        assert abs(operations.counted(ears)[name] / printed - 1) < 0.01
    arm = inverse_dynamics(puma)
    assert operations.dense_links(arm)[0] == 114 + 408 + 13 + 6 + 6
    for name, printed in operations.THESIS_CSLC.items():
        assert abs(operations.counted(arm)[name] / printed - 1) < 0.15


def test_counts_follow_their_formulas() -> None:
    """A general two-layer network with sigmoids, its second layer context-sensitive."""
    i, h, o = 5, 4, 3
    source, node = (tuple(x.ravel().tolist()) for x in np.meshgrid(range(h), range(o)))
    context = ContextLayer(h, o, h * o, source, node, tuple(range(h * o)))
    network = AdaptiveNetwork(
        (Subnetwork("two", (Layer(Links.full(i, h), TANH),), (context,)),),
        lambda x: Signals((x,), ((x,),)),
        TANH,
        tuple(f"w{n}" for n in range(i * h)),
    )
    assert operations.COUNTED_FORMULAS == {
        "backpropagation": "4ih + 3h + 4ho + 4o",
        "PERAL": "7ih + 3h + 6ho + 2o",
    }
    assert operations.counted(network) == {
        "backpropagation": 4 * i * h + 3 * h + 4 * h * o + 4 * o,
        "PERAL": 7 * i * h + 3 * h + 6 * h * o + 2 * o,
    }


def test_the_compiler_performs_what_a_dense_layer_needs() -> None:
    problem = linear_problem(1)
    weights = jnp.ones(problem.network.size)
    for rule, least in ((Backpropagation(), 4), (PERAL(), 6)):
        counts = operations.compiled(problem.network, rule, problem.first, weights)
        links = operations.dense_links(problem.network)[1]
        assert least * links <= counts["operations"] <= 12 * links


def test_epochs_to_a_goal() -> None:
    curves = np.array([[3.0, 2.0, 1.0, 2.0], [3.0, 3.0, 3.0, 3.0], [1.0, 0.0, np.nan, np.nan]])
    epochs = comparison.first_at_most(curves, np.array([1.5, 2.5, 1.0]))
    assert_array_equal(epochs, [2.0, np.inf, 0.0])


def test_wrong_is_known_from_errors(rng: np.random.Generator) -> None:
    kind = rng.integers(0, 4, 200)
    targets = np.where(np.arange(4)[:, None] == kind, 1.0, -1.0)
    outputs = np.tanh(targets * 0.3 + rng.standard_normal(targets.shape))
    share = comparison.wrong(jnp.asarray(targets - outputs), jnp.ones(targets.shape))
    assert float(share) == pytest.approx(np.mean(outputs.argmax(axis=0) != kind))


def test_direct_solutions_are_least_squares() -> None:
    problem = linear_problem(2)
    direct = comparison.direct_solutions(problem)
    inputs = np.asarray(problem.first.signals.inputs[0]).T
    design = np.hstack([inputs, np.ones((len(inputs), 1))])
    for weights, targets in zip(direct, problem.examples.targets, strict=True):
        expected = np.linalg.lstsq(design, np.asarray(targets).T, rcond=None)[0]
        assert_allclose(np.asarray(weights).reshape(2, 5).T, expected, atol=1e-10)
    least = comparison.costs_of(problem, direct, half_square)
    assert np.all(comparison.costs_of(problem, direct + 0.01, half_square) > least)


def test_ultrasound_patterns_are_in_equal_shares() -> None:
    problem = comparison.ultrasound(120, centred=True)
    assert_array_equal(np.sum(np.asarray(problem.examples.targets) == 1.0, axis=1), np.full(10, 12))
    assert_allclose(np.asarray(problem.examples.signals.inputs[0]).mean(axis=1), 0.0, atol=1e-12)


def test_comparison_patterns_are_classified_too() -> None:
    """All 1,850 of 6.3.1, less the means of the training patterns; counted by hand."""
    problem = comparison.ultrasound(120, centred=True)
    assert problem.comparison is not None
    assert problem.comparison.targets.shape == (10, 1850)
    scene = sim.ultrasound(seed=0)
    shift = scene.comparison.inputs - np.asarray(problem.comparison.signals.inputs[0]).T
    rows = [np.flatnonzero(scene.training.kind == kind)[:12] for kind in range(10)]
    mean = scene.training.inputs[np.concatenate(rows)].mean(axis=0)
    assert_allclose(shift, np.broadcast_to(mean, shift.shape), atol=1e-12)

    weights = comparison.starts(problem, 2)
    outcome = comparison.Outcome(
        problem, np.array([3.0, np.nan]), {}, {}, {}, {}, {}, 1.0, weights, {"PERAL": weights + 0.1}
    )
    first, last = comparison.correct(outcome)
    assert (first["at"], last["at"]) == ("hand-over", "PERAL")
    inputs = np.column_stack([scene.comparison.inputs - mean, np.ones(1850)])
    winners = (inputs @ np.asarray(weights[0] + 0.1).reshape(10, 26).T).argmax(axis=1)
    expected = np.mean(winners == scene.comparison.kind)
    assert_allclose(last["comparison"], [expected, np.nan])
    assert len(first["training"]) == 2 and np.isnan(first["training"][1])
    assert comparison.correct(replace(outcome, problem=linear_problem(1))) == []


def test_shares_of_correct_classifications() -> None:
    """Medians over starts that were handed over."""
    stage = {"at": "PERAL", "training": [0.5, 0.4, np.nan], "comparison": [0.3, 0.2, np.nan]}
    row = {"patterns": 200, "centred": True, "hand-over": 0.3, "cost": "half square"}
    (line,) = ultrasound.correct_rows([row | {"correct": [stage]}])
    assert line["at"] == "end of PERAL"
    assert line["training patterns correct"] == 0.4 and line["comparison patterns correct"] == 0.2
    assert "40.0%" in ultrasound.correct_table([line])[1]


def test_never_is_longer_than_anything() -> None:
    spread = tables.spread(np.array([4.0, np.inf, 2.0, np.nan, np.inf]))
    assert (spread["lowest"], spread["highest"]) == (2.0, np.inf)
    assert tables.spread(np.array([4.0, np.inf, 2.0]))["median"] == 4.0
    assert np.isnan(tables.spread(np.array([np.nan]))["median"])
    assert [tables.quotient(8.0, 2.0), tables.quotient(np.inf, 2.0)] == [4.0, np.inf]
    assert tables.quotient(3.0, np.inf) == 0.0 and np.isnan(tables.quotient(np.inf, np.inf))
    assert (tables.number(np.inf), tables.number(np.nan)) == ("never", "-")


def test_a_picture_of_one_comparison() -> None:
    curve = np.linspace(5.0, 1.0, 30)
    one = Learning(("a", curve), {"b": curve[10:] - 0.5}, 10, {"best": 0.5})
    figure = learning_picture({"panel": one, "other": one}, "cost [N m]")
    assert isinstance(figure, Figure)
    axes = figure.axes[0]
    assert_array_equal(axes.lines[1].get_xdata(), np.arange(10, 30))
    assert axes.get_xlabel() == "epochs" and len(figure.axes) == 2


def test_a_tiny_run_and_its_resumption(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """With a linear combiner in the CSLC's place, whose compilation would take most of a minute."""
    monkeypatch.setattr(peral, "puma", lambda patterns, noise, seeds: linear_problem(seeds))
    arguments = ["--quick", "--seeds", "2", "--noise", "0.1", "-o", str(tmp_path / "study")]
    assert peral.main(arguments) == 0
    printed = capsys.readouterr().out
    assert "of 2 starts, backpropagation brings 2 to 1.001 times" in printed
    assert "general two-layer" in printed
    document = json.loads((tmp_path / "study" / "peral_study.json").read_text(encoding="utf-8"))
    assert document["one minimum"]["backpropagation"]["highest"] <= 1.001
    with (tmp_path / "study" / "epochs.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3 * 3 * 2
    for row in rows:
        assert int(row["reached"]) <= int(row["handed over"]) <= int(row["seeds"]) == 2
    for name in ("ultrasound.png", "puma.png"):
        assert (tmp_path / "study" / name).stat().st_size > 10_000

    # The same command takes everything from its checkpoints.
    assert peral.main(arguments) == 0
    again = json.loads((tmp_path / "study" / "peral_study.json").read_text(encoding="utf-8"))
    for first, second in zip(document["trainings"], again["trainings"], strict=True):
        assert first["epochs"] == second["epochs"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--seeds", "0"], "--seeds is 0; expected 1 or more"),
        (["--puma-patterns", "5"], "--puma-patterns is 5; expected 30 to 3300"),
        (["--noise", "0.1", "0.1"], "expected different levels"),
        (["--noise", "-1"], "expected finite numbers, 0 or more"),
        (["--minimum-gain", "0.2"], "--minimum-gain at least 0 and below 0.1"),
    ],
)
def test_bad_options(
    arguments: list[str],
    message: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit):
        peral.main(arguments)
    assert message in capsys.readouterr().err
