"""Pictures of a payload that is identified: axes with units, the data drawn are those passed."""

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.testing import assert_allclose

from scripts.studies.payload.pictures import (
    PayloadCurve,
    Spread,
    hand_error_picture,
    payload_picture,
)


TIME = np.linspace(0.0, 4.0, 41)


def curve(mass: float) -> PayloadCurve:
    carrying = (TIME > 1.5) & (TIME < 3.5) & (mass > 0)
    centre = np.tile([0.02, -0.03, 0.1], (41, 1))
    error = np.full((41, 3), np.inf)
    error[carrying] = 0.001
    return PayloadCurve(
        TIME,
        1.01 * mass * carrying,
        np.full(41, 0.005),
        centre,
        error,
        carrying,
        mass,
        centre[0],
        1.0,
        3.0,
        (1.5, 3.5) if mass else (),
    )


def line(axes: Axes, label: str) -> np.ndarray:
    (artist,) = (candidate for candidate in axes.lines if candidate.get_label() == label)
    return np.array(artist.get_data(), float)


def words(figure: Figure) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def test_payload() -> None:
    figure = payload_picture({"nothing": curve(0.0), "2 kg": curve(2.0)}, title="learnt")
    grid = np.array(figure.axes).reshape(3, 2)
    assert [axes.get_title() for axes in grid[0]] == ["nothing", "2 kg"]
    assert [axes.get_ylabel() for axes in grid[:, 0]] == [
        "mass [kg]",
        "error of the mass [%]",
        "centre of gravity [mm]",
    ]
    assert {axes.get_xlabel() for axes in grid[-1]} == {"time [s]"}
    assert_allclose(line(grid[0, 1], "mass")[1], curve(2.0).mass)
    shown = np.isfinite(line(grid[1, 1], "mass")[1])
    # While it is carried and detected.
    assert_allclose(TIME[shown], TIME[(TIME > 1.5) & (TIME < 3.0)])
    assert_allclose(line(grid[1, 1], "mass")[1][shown], 1.0)
    height = line(grid[2, 1], "z of the centre")[1]
    assert_allclose(height[curve(2.0).carrying], 100.0)
    assert np.all(np.isnan(height[~curve(2.0).carrying]))
    assert not np.isfinite(line(grid[2, 0], "z of the centre")[1]).any()
    assert {"carried", "detected", "truth", "mass"} <= set(words(figure))
    assert len(words(figure)) == len(set(words(figure)))


def test_hand() -> None:
    spread = Spread(np.full(41, 0.5), np.full(41, 1.0), np.full(41, 2.0))
    errors = {"2 kg": {"learnt": spread, "known": spread}}
    figure = hand_error_picture(TIME, errors, picked=1.0, placed=3.0)
    (axes,) = figure.axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("time [s]", "error of the hand [mm]")
    assert axes.get_yscale() == "log"
    assert_allclose(line(axes, "learnt"), [TIME, spread.middle])
    assert words(figure) == ["carried", "learnt", "known"]


def test_nothing_to_draw() -> None:
    with pytest.raises(ValueError, match="no curves"):
        payload_picture({})
    with pytest.raises(ValueError, match="no errors"):
        hand_error_picture(TIME, {}, picked=1.0, placed=3.0)
