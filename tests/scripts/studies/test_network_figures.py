"""The figures of Chapters 3 and 4: what they claim, from small runs."""

import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from scripts.studies.training import network_figures
from scripts.studies.training.network_pictures import (
    decision_picture,
    fitted_curves_picture,
    overtraining_picture,
)


@pytest.mark.parametrize("seed", [0, 5])
def test_exclusive_or_needs_its_inputs_preprocessed(seed: int) -> None:
    figure, document = network_figures.exclusive_or(20, 300, seed)
    assert isinstance(figure, Figure)
    assert document["with preprocessing"]["ended without an error"] == 20
    assert sum(document["with preprocessing"]["curves of zero sum"].values()) == 20
    drawn = document["with preprocessing"]["drawn"]
    assert np.array_equal(drawn["answers"], network_figures.EXCLUSIVE_OR)
    # The weights are those of the polynomial that the curve is of.
    x1, x2 = network_figures.CORNERS.T
    terms = np.stack([x1, x2, x1**2, x1 * x2, x2**2, np.ones(4)], axis=1)
    assert np.array_equal(
        terms @ np.asarray(drawn["weights"]) >= 0, network_figures.EXCLUSIVE_OR == 1
    )
    # No line parts the corners: one is always wrong.
    plain = document["without preprocessing"]
    assert (plain["ended without an error"], plain["least wrong answers of 4"]) == (0, 1)
    assert np.sum(np.asarray(plain["drawn"]["answers"]) != network_figures.EXCLUSIVE_OR) == 1


def test_conics_by_their_discriminant() -> None:
    def of(a: float, b: float, c: float) -> str:
        return network_figures.conic(np.array([0.3, -0.2, a, b, c, 1.0]))

    assert (of(1.0, 0.0, 2.0), of(1.0, 1.0, -1.0), of(1.0, 2.0, 1.0)) == (
        "ellipse",
        "hyperbola",
        "parabola",
    )


def test_the_stop_set_rises_after_its_least_error() -> None:
    _, document = network_figures.overtraining(4, 4000, 0)
    drawn = document["drawn"]
    assert 1 < drawn["epoch to stop at"] < 4000
    assert drawn["stop-set error at the end"] > 1.05 * drawn["stop-set error there"]
    assert drawn["training error at the end"] < drawn["training error there"]
    assert all(
        rise >= 1.0 for rise in document["all draws"]["stop-set error at the end over the least"]
    )


def test_quintics_are_direct_solutions_that_agree_inside_only() -> None:
    _, document = network_figures.quintics(20, 3)
    drawn = document["drawn"]
    for x, y, weights in zip(drawn["x"], drawn["y"], drawn["weights of x, ..., x⁵"], strict=True):
        powers = np.stack([x**n for n in range(1, 6)], axis=1)
        residual = y - powers @ weights
        assert np.allclose(
            powers.T @ residual, 0.0, atol=1e-9
        )  # Eqn. 4.1-2, by its normal equations
    assert document["all draws"]["RMS departure inside, median"] < 3 * document["noise"]
    assert document["all draws"]["outside over inside, median"] > 10.0


def test_pictures_show_their_data() -> None:
    grid = np.linspace(-1.0, 1.0, 11)
    sums = grid[None, :] + 0.0 * grid[:, None]
    patterns, targets = np.array([[-0.5, 0.0], [0.5, 0.0]]), np.array([1.0, 1.0])
    figure = decision_picture(
        grid, grid, {"a line": (sums, np.array([0.0, 1.0]))}, patterns, targets
    )
    (axes,) = figure.axes
    assert axes.get_title() == "a line\n1 of 2 right"
    (ring,) = [line for line in axes.lines if line.get_label() == "answered wrongly"]
    assert np.array_equal(ring.get_xydata(), patterns[:1])

    stop = np.array([3.0, 1.0, 2.0])
    (axes,) = overtraining_picture(np.array([3.0, 2.0, 1.0]), stop).axes
    assert [line.get_label() for line in axes.lines][2] == "stop training: epoch 2"

    points = np.array([[0.0, -1.0], [1.0, 3.0]])
    (axes,) = fitted_curves_picture(grid, grid, {"fit": (points, 9 * grid)}, height=2.0).axes
    assert axes.get_ylim() == (-3.0, 5.0)


def test_a_small_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        network_figures.main(
            ["--draws", "2", "--epochs", "100", "--seed", "4", "-o", str(tmp_path / "figures")]
        )
        == 0
    )
    assert f"into {tmp_path / 'figures'}" in capsys.readouterr().out
    document = json.loads((tmp_path / "figures" / "network_figures.json").read_text("utf-8"))
    assert document["seed"] == 4
    for name in ("exclusive_or", "overtraining", "quintics"):
        assert (tmp_path / "figures" / f"{name}.png").stat().st_size > 10_000
        assert name in document


def test_equal_seeds_give_equal_numbers() -> None:
    _, one = network_figures.quintics(2, 7)
    _, same = network_figures.quintics(2, 7)
    _, other = network_figures.quintics(2, 8)
    assert np.array_equal(one["drawn"]["y"], same["drawn"]["y"])
    assert not np.array_equal(one["drawn"]["y"], other["drawn"]["y"])


def test_no_draws(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        network_figures.main(["--draws", "0"])
    assert "--draws is 0; expected 1 or more" in capsys.readouterr().err
