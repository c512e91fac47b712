"""The study of classes: its problems, methods and bookkeeping, each against something simple."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.testing import assert_allclose, assert_array_equal

from jaxcslc.training import Backpropagation, fully_connected
from scripts.studies.peral_classes import (
    alternatives,
    classes,
    classic_rules,
    results,
    study,
    switches,
    tables,
)
from scripts.studies.peral_classes.pictures import pictures
from scripts.studies.peral_classes.spectra import eigenvalues


INF = float("inf")


@pytest.fixture(scope="module")
def linear() -> classes.Problem:
    """Two seeds of a small linear combiner."""
    kind = classes.NetworkClass(
        "linear",
        lambda: fully_connected([3, 2], "linear combiner"),
        classes.correlated(3, 0.5),
        patterns=30,
        reach=0.5,
    )
    return classes.problem(kind, 0.1, range(2))


def regressor(problem: classes.Problem, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Inputs with the bias's, and targets."""
    patterns = problem.of_seed(seed)
    inputs = np.asarray(patterns.signals.inputs[0]).T
    return np.hstack([inputs, np.ones((len(inputs), 1))]), np.asarray(patterns.targets).T


def test_noise_is_in_parts_of_the_targets(linear: classes.Problem) -> None:
    assert linear.optima is not None
    for seed, deviation in enumerate(linear.deviation):
        x, targets = regressor(linear, seed)
        clean = x @ np.asarray(linear.optima[seed]).reshape(2, 4).T
        assert_allclose(deviation, np.sqrt(np.mean(clean.var(axis=0))))
        noise = (targets - clean).std(axis=0) / clean.std(axis=0)
        assert np.all((noise > 0.06) & (noise < 0.15))


def test_hard_limiters_get_what_a_hyperplane_separates() -> None:
    kind = classes.CLASSES["hard limiter"]
    of_class = classes.problem(kind, 0.2, range(1))
    _, targets = regressor(of_class, 0)
    assert set(np.unique(targets)) == {0.0, 1.0}
    # Least squares on ±1 need not separate; the perceptron rule does.
    row = results.hard_limiter_row(of_class, 300)
    assert np.isfinite(row["perceptron rule"]).all()
    assert "PERAL needs continuous activations" in row["refused"]


def test_arms_have_their_joints() -> None:
    for robot, joints in ((classes.planar(2), 2), (classes.elbow(), 3)):
        assert robot.joint_count == joints
    rng = np.random.default_rng(0)
    network = classes.arm(classes.planar(2))
    motion, torque, k = classes.random_motion(rng, network, 5)
    cslc: Any = network.preprocess
    assert k is not None
    expected = cslc.network.torque(jnp.asarray(k), *map(jnp.asarray, motion))
    assert_allclose(torque, expected, atol=1e-10)


def test_alternatives_go_where_the_direct_solve_is(linear: classes.Problem) -> None:
    best = [alternatives.direct_solution(linear.network, linear.of_seed(i)) for i in range(2)]
    for seed, weights in enumerate(best):
        x, targets = regressor(linear, seed)
        expected = np.linalg.lstsq(x, targets, rcond=None)[0].T.ravel()
        assert_allclose(weights, expected, atol=1e-9)
    least = results.least_costs(linear)
    for kind, steps in (
        (alternatives.LEVENBERG_MARQUARDT, 25),
        (alternatives.LIMITED_MEMORY, 40),
        (alternatives.ONE_STEP_SECANT, 60),
        (alternatives.CONJUGATE, 200),
        (alternatives.SCALED_CONJUGATE, 40),
        (alternatives.BFGS, 100),
    ):
        cost, weights = alternatives.costs_by_step(
            kind, jnp.zeros(()), linear.network, linear.examples, linear.starts, steps
        )
        assert np.all(np.diff(np.asarray(cost), axis=1) <= 1e-12), kind
        assert_allclose(np.asarray(cost)[:, -1], least, rtol=1e-6, err_msg=kind)
        assert_allclose(weights, best, atol=1e-3, err_msg=kind)


def test_rprop_s_steps(linear: classes.Problem) -> None:
    """Riedmiller & Braun 1993 by hand: each weight's step by signs of its own slope alone."""
    x, targets = regressor(linear, 0)
    weights, step, before, costs = np.asarray(linear.starts[0]), np.full(8, 0.1), np.zeros(8), []
    for _ in range(12):
        errors = targets - x @ weights.reshape(2, 4).T
        costs.append(0.5 * np.sum(errors**2) / len(x))
        slope = -(errors.T @ x).ravel() / len(x)
        step = step * np.where(slope * before > 0, 1.2, np.where(slope * before < 0, 0.5, 1.0))
        slope = np.where(slope * before < 0, 0.0, slope)
        weights, before = weights - np.sign(slope) * step, slope
    cost, _ = alternatives.costs_by_step(
        alternatives.RPROP, jnp.asarray(0.1), linear.network, linear.examples, linear.starts, 12
    )
    assert_allclose(np.asarray(cost)[0], costs, rtol=1e-9)


def test_quickprop_finds_a_parabola_s_vertex() -> None:
    """From its third step on, a weight within the limit of growth is at the minimum."""
    minimum, curvature = np.array([1.0, -2.0]), np.array([0.5, 2.0])
    rule, weights = classic_rules.quickprop(0.5, growth=1e6), jnp.zeros(2)
    state = rule.init(weights)
    for _ in range(2):
        step, state = rule.update(jnp.asarray(curvature * (np.asarray(weights) - minimum)), state)
        weights = weights + step
    # The second is the parabola's, with the gradient's own step while it points the same way.
    ahead = 0.5 * curvature * (minimum - 0.5 * curvature * minimum)
    assert_allclose(weights, minimum + np.where(0.5 * curvature < 1.0, ahead, 0.0), atol=1e-5)


def test_one_step_secant_goes_battiti_s_way(linear: classes.Problem) -> None:
    """Battiti 1992: -g + A p + B y, from the last step p and the change y of the gradient."""
    x, targets = regressor(linear, 0)

    def gradient(weights: np.ndarray) -> np.ndarray:
        return -((targets - x @ weights.reshape(2, 4).T).T @ x).ravel() / len(x)

    at = [np.asarray(linear.starts[0])]
    for steps in (1, 2):
        _, weights = alternatives.costs_by_step(
            alternatives.ONE_STEP_SECANT, jnp.zeros(()), linear.network, linear.examples,
            linear.starts, steps,
        )  # fmt: skip
        at.append(np.asarray(weights)[0])
    p, g = at[1] - at[0], gradient(at[1])
    y = g - gradient(at[0])
    by_step = -(1 + y @ y / (p @ y)) * (p @ g) / (p @ y) + (y @ g) / (p @ y)
    way = -g + by_step * p + (p @ g) / (p @ y) * y
    went = at[2] - at[1]
    assert_allclose(went / np.linalg.norm(went), way / np.linalg.norm(way), atol=1e-9)


def rosenbrock(w: Any) -> Any:
    """A valley that bends; its Hessian is indefinite at the start of the test."""
    return (1.0 - w[0]) ** 2 + 10.0 * (w[1] - w[0] ** 2) ** 2


def moller(weights: np.ndarray, steps: int) -> list[float]:
    """Costs by Møller's printed steps, with the curvature by a difference of two gradients."""

    def gradient(w: np.ndarray) -> np.ndarray:
        inner = w[1] - w[0] ** 2
        return np.array([-2.0 * (1.0 - w[0]) - 40.0 * w[0] * inner, 20.0 * inner])

    scale, lifted, success, taken, costs = 1e-6, 0.0, True, 0, [rosenbrock(weights)]
    r = p = -gradient(weights)
    curvature = 0.0
    for _ in range(steps):
        square = p @ p
        if success:
            far = 1e-7 / np.sqrt(square)
            curvature = p @ (gradient(weights + far * p) - gradient(weights)) / far
        curvature += (scale - lifted) * square
        if curvature <= 0.0:
            lifted = 2.0 * (scale - curvature / square)
            curvature = -curvature + scale * square
            scale = lifted
        down = p @ r
        trial = weights + down / curvature * p
        comparison = 2.0 * curvature * (rosenbrock(weights) - rosenbrock(trial)) / down**2
        success = bool(comparison >= 0.0)
        if success:
            weights, lifted, taken, old = trial, 0.0, taken + 1, r
            r = -gradient(weights)
            p = r if taken % 2 == 0 else r + (r @ r - r @ old) / down * p
            scale = scale / 4.0 if comparison >= 0.75 else scale
        else:
            lifted = scale
        if comparison < 0.25:
            scale += curvature * (1.0 - comparison) / square
        costs.append(rosenbrock(weights))
    return costs


def test_scaled_conjugate_gradients_are_moller_s() -> None:
    start = np.array([0.0, 2.0])
    method = classic_rules.ScaledConjugateGradient(rosenbrock)
    state, costs = method.first(jnp.asarray(start)), []
    for _ in range(30):
        costs.append(float(state.cost))
        state = method.step(state)
    # The difference of gradients, of steps of 1e-7, is what limits the agreement.
    assert_allclose(costs[:15], moller(start, 14), rtol=1e-3)
    assert costs[-1] < 1e-8
    still = method.first(jnp.ones(2))
    assert_array_equal(method.step(still).weights, still.weights)


def test_momentum_s_steps(linear: classes.Problem) -> None:
    """Two steps by hand: the second goes on with 0.9 of the first."""
    x, targets = regressor(linear, 0)
    weights, velocity, costs = np.asarray(linear.starts[0]), np.zeros(8), []
    for _ in range(3):
        errors = targets - x @ weights.reshape(2, 4).T
        costs.append(0.5 * np.sum(errors**2) / len(x))
        velocity = 0.9 * velocity + (errors.T @ x).ravel() / len(x)
        weights = weights + 0.1 * velocity
    cost, _ = alternatives.costs_by_step(
        alternatives.MOMENTUM, jnp.asarray(0.1), linear.network, linear.examples, linear.starts, 3
    )
    assert_allclose(np.asarray(cost)[0], costs, rtol=1e-10)


def test_backpropagation_s_spectrum_is_that_of_the_inputs(linear: classes.Problem) -> None:
    x, _ = regressor(linear, 0)
    expected = np.linalg.eigvalsh(x.T @ x / len(x))
    values = eigenvalues(linear, Backpropagation(), linear.of_seed(0), linear.starts[0])
    assert_allclose(values, np.repeat(expected, 2), rtol=1e-8)


def test_switches_begin_at_once_and_become_rare() -> None:
    epochs = switches.switch_epochs(600)
    assert epochs[0] == 0 and epochs[-1] <= 300
    assert np.all(np.diff(epochs) > 0) and np.all(np.diff(epochs, 2)[1:] >= -1)


def test_looks_become_rare_while_nothing_changes() -> None:
    # At 0, 5, 15 and 35; a change at 35 brings the next at 40.
    rule = [0] * 35 + [1] * 25
    counts = [switches.look_count(epochs, 5, rule) for epochs in (0, 1, 5, 6, 15, 16, 36, 41, 51)]
    assert counts == [0, 1, 1, 2, 2, 3, 4, 5, 6]


def test_epochs_and_looks_to_a_goal() -> None:
    rule = np.array([[0, 0, 1, 1], [0, 0, 0, 0]])
    counts = results.guided_counts(rule, np.array([3.0, INF]), 2)
    assert counts == [[2.0, 1.0, 2.0], [INF, INF, INF]]


def rows_of(name: str, noise: float) -> list[dict[str, Any]]:
    """A class with three goals, two seeds and switches after 0 and 10 epochs."""
    case = {"class": name, "noise": noise}
    seconds = {"backpropagation": 1e-3, "PERAL": 2e-3, "look": 5e-4}
    reached = [[20.0, 30.0], [40.0, INF], [INF, INF]]
    after = [[[4.0, 2.0], [INF, 25.0]], [[INF, 5.0], [INF, 30.0]], [[INF, INF], [INF, INF]]]
    led = [[[10.0, 2.0, 2.0], [30.0, 0.0, 4.0]], [[10.0, 10.0, 4.0], [INF] * 3], [[INF] * 3] * 2]
    return [
        case | {"part": "rules", "refused": "", "seconds": seconds, "backpropagation": reached,
                "switches": [0, 10], "after": after},
        case | {"part": "indicator", "every": 5, "margin": 1.5, "guided": led},
        case | {"part": "alternatives", "steps": {"Adam": reached}, "seconds": {"Adam": 1e-4},
                "rates": {"Adam": [0.1] * 3}},
        case | {"part": "spectrum", "refused": "",
                "condition": {"backpropagation": [10.0, 20.0], "PERAL": [INF, 5.0]},
                "away": {"backpropagation": [0, 0], "PERAL": [1, 0]}},
    ]  # fmt: skip


def test_time_with_each_switch() -> None:
    row, led, *_ = rows_of("linear", 0.0)
    alone, switched = results.seconds_by_switch(row, 0)
    assert_allclose(alone, [0.020, 0.030])
    assert_allclose(switched, [[0.008, 0.014], [INF, 0.060]])
    assert_allclose(results.best_seconds(row, 0), [0.008, 0.030])
    assert_allclose(results.guided_seconds(row, led, 0), [0.015, 0.032])
    assert_allclose(results.over_best(row, led, 0), [0.015 / 0.008, 0.032 / 0.030])
    # Some switch arrives where the indicator does not; nothing does.
    assert_allclose(results.best_seconds(row, 1), [0.020, 0.070])
    assert_allclose(results.over_best(row, led, 1), [0.032 / 0.020, INF])
    assert np.isnan(results.over_best(row, led, 2)).all()
    # A switch behind the goal is none.
    late = row | {"switches": [0, 25]}
    assert_allclose(results.seconds_by_switch(late, 0)[1][0], [0.008, 0.020])


def test_tables_and_pictures() -> None:
    rows = rows_of("linear", 0.0) + rows_of("radial basis", 0.0)
    refused = {"class": "hard limiter", "noise": 0.0, "part": "rules", "refused": "no slope",
               "perceptron rule": [10.0, INF, 12.0]}  # fmt: skip
    of_study = tables.Results([*rows, refused])
    text = tables.report(of_study, 2)
    assert "linear *" in text and "\nradial basis " in text
    assert "hard limiter: no slope" in text and "2 of 3 trainings, after 12 epochs" in text
    first = of_study.indicator()[0]
    assert first["best switch, median epoch"] == 0.0
    assert first["indicator over best, median"] == pytest.approx(0.032 / 0.030)
    methods = {row["method"] for row in of_study.methods()}
    assert methods == {"backpropagation", "PERAL", "best switch", "indicator", "Adam"}
    assert "1.88" in tables.tuning_table(rows) or "1.07" in tables.tuning_table(rows)
    page = tables.page_tables(tables.Results(rows_of("linear", 0.05)))
    assert page["epochs"][0][:3] == ["", "backpropagation", "PERAL"]
    assert page["epochs"][1][0] == "linear *" and page["hindsight"][1][0] == "linear *"
    assert page["milliseconds"][1][1] == "40 (1)"  # one of two seeds arrives
    drawn = pictures(of_study)
    assert set(drawn) == {"switch.png", "time.png"}
    for figure in drawn.values():
        assert isinstance(figure, Figure)
        assert all(axes.get_title() for axes in figure.axes if axes.get_visible())


def test_pictures_are_of_what_there_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A hard limiter alone, which PERAL does not train; and a class of which only times are."""
    arguments = ["--classes", "hard limiter", "--seeds", "1", "--epochs", "20", "-o", str(tmp_path)]
    assert study.main([*arguments, "--noise", "0"]) == 0
    assert "Not trained by PERAL" in capsys.readouterr().out
    assert {path.name for path in tmp_path.iterdir()} == {"rows.jsonl"}
    rows = rows_of("sigmoid, two layers", 0.0)
    without_peral = [
        {**rows[0], "refused": "no inverse"},
        *rows[2:],
    ]
    assert set(pictures(tables.Results(without_peral))) == {"time.png"}


def test_never_comes_last_and_nothing_is_left_out() -> None:
    assert results.median_of([1.0, INF, 3.0]) == 3.0
    assert results.median_of([1.0, INF, INF, np.nan]) == INF
    assert np.isnan(results.median_of([np.nan]))
    assert_array_equal(
        switches.first_at_most(np.array([[3.0, 1.0], [3.0, 2.0]]), np.array([1.0, 1.0])), [1.0, INF]
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--classes", "cubic"], "no class is called 'cubic'"),
        (["--noise", "-1"], "--noise is [-1.0]; expected 0 to 1"),
        (["--margin", "0"], "--margin is 0.0; expected more than 0"),
        (["--epochs", "5"], "--epochs is 5; expected 20 or more"),
    ],
)
def test_wrong_options(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        study.main(arguments)
    assert message in capsys.readouterr().err


def test_looks_are_counted_as_a_training_takes_them(linear: classes.Problem) -> None:
    """A turn can only change at a look; the counting follows the changes of a real training."""
    from jaxcslc.training import SwitchWhen

    led = switches.guided(linear, SwitchWhen(every=3, margin=1.0), 40)
    assert led.cost.shape == led.rule.shape == (2, 40)
    for rule in led.rule.tolist():
        wait = interval = present = 0
        for epoch, used in enumerate(rule):
            looked = wait == 0
            assert looked or used == present, epoch
            if looked:
                interval = 3 if used != present or interval == 0 else 2 * interval
                wait, present = interval, used
            wait -= 1
    assert jax.numpy.isfinite(led.cost).all()
