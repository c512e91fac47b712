"""Pictures of studies: axes say what they show with units, and data are drawn as passed."""

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.text import Annotation
from numpy.testing import assert_allclose

from scripts.studies.disturbances.pictures import budget_picture
from scripts.studies.motor.pictures import motor_curve_picture, motor_response_picture
from scripts.studies.puma560.machine_pictures import friction_picture, hysteresis_picture
from scripts.studies.puma560.motion_pictures import (
    averaged_spline_picture,
    motion_picture,
    reversal_picture,
    spline_subsets_picture,
)


def line(axes: Axes, label: str) -> np.ndarray:
    """What the one line of that label shows, (2, points)."""
    (artist,) = (candidate for candidate in axes.lines if candidate.get_label() == label)
    return np.array(artist.get_data(), float)


def words(figure: Figure) -> str:
    """Everything that is written into the axes and the legends of a figure."""
    texts = [text.get_text() for axes in figure.axes for text in axes.texts]
    texts += [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    return "\n".join(texts)


def labels(figure: Figure) -> list[tuple[str, str]]:
    return [(axes.get_xlabel(), axes.get_ylabel()) for axes in figure.axes]


def three_parts(velocity: np.ndarray) -> np.ndarray:
    """Eqn. 2.5-4 with k^v = 4, k^d = 5, k^s = 7, γ = 0.05."""
    dry = 5 + 2 * np.exp(-np.abs(velocity) / 0.05)
    return 4 * velocity + np.sign(velocity) * dry


def test_friction_profile() -> None:
    velocity = np.linspace(-1.0, 1.0, 101)  # zero among them
    figure = friction_picture(velocity, three_parts(velocity), viscous=4.0, dry=5.0, static=7.0)
    assert labels(figure) == [("velocity [rad/s]", "friction [N m]")]
    (axes,) = figure.axes
    drawn = line(axes, "friction").T
    drawn = drawn[~np.isnan(drawn[:, 1])]
    assert_allclose(drawn[:, 1], three_parts(drawn[:, 0]))
    assert len(drawn) == 100  # the curve is broken at rest, where friction has no one value
    straight = line(axes, "viscous and dry friction")
    assert_allclose(straight[1], 5 + 4 * straight[0])
    for mark in ("$k^s$ = 7 N m", "$k^d$ = 5 N m", "slope $k^v$ = 4 N m s/rad"):
        assert mark in words(figure)


def test_friction_of_a_slide() -> None:
    velocity = np.linspace(-1.0, 1.0, 20)
    figure = friction_picture(
        velocity, three_parts(velocity), viscous=4.0, dry=5.0, static=7.0, units=("m/s", "N")
    )
    assert labels(figure) == [("velocity [m/s]", "friction [N]")]
    assert "4 N s/m" in words(figure)


def test_hysteresis_arrows_follow_time() -> None:
    angle = np.linspace(0, 2 * np.pi, 400)
    rotor, link = np.cos(angle), np.sin(angle)  # anticlockwise
    figure = hysteresis_picture(rotor, link, backlash=0.5, arrows=6, unit="mrad")
    (axes,) = figure.axes
    assert labels(figure) == [("rotor position, at the joint [mrad]", "link position [mrad]")]
    assert_allclose(np.array(axes.lines[0].get_data()), [rotor, link])
    arrows = [t for t in axes.texts if isinstance(t, Annotation) and t.arrowprops]
    directed = [a for a in arrows if "-|>" in repr(a.arrowprops)]
    assert len(directed) == 6
    for arrow in directed:
        head, tail = np.array(arrow.xy), np.array(arrow.xyann)
        assert tail[0] * head[1] - tail[1] * head[0] > 0
    (width,) = (a for a in arrows if "<->" in repr(a.arrowprops))
    assert_allclose(np.ptp([width.xy[0], width.xyann[0]]), 0.5)
    assert "$b$ = 0.5 mrad" in words(figure)


def test_motor_curve() -> None:
    demanded = np.linspace(0, 100, 50)
    delivered = np.minimum(demanded, 60)
    figure = motor_curve_picture(demanded, delivered, limit=60.0)
    (axes,) = figure.axes
    assert labels(figure) == [("demanded torque [N m]", "torque delivered [N m]")]
    assert_allclose(line(axes, "motor"), [demanded, delivered])
    assert_allclose(line(axes, "linear motor"), [demanded, demanded])
    assert "limit of linearity\n60 N m" in words(figure)


def test_motor_response_leaves_the_heaviest_out_of_the_line() -> None:
    """7.2.3: beyond its limit of linearity a motor seems to need more torque per mass."""
    mass = np.array([0.0, 0.0, 1.0, 2.0, 3.0, 5.0])
    torque = 10 + 8 * mass
    torque[-1] += 4
    figure = motor_response_picture(mass, torque)
    (axes,) = figure.axes
    assert labels(figure) == [("suspended mass [kg]", "mean torque [N m]")]
    assert_allclose(line(axes, "measurement"), [mass, torque])
    fitted = line(axes, "line through all but the heaviest")
    assert_allclose(fitted[1], 10 + 8 * fitted[0])
    assert "+4 N m from the line" in words(figure)
    with pytest.raises(ValueError, match="2 different masses; expected three or more"):
        motor_response_picture(np.array([0.0, 0.0, 1.0]), np.ones(3))


def test_spline_subsets() -> None:
    time, fine = np.arange(10.0), np.linspace(0, 9, 50)
    curves = [np.sin(fine + shift) for shift in range(3)]
    quantised = np.round(np.sin(time))
    figure = spline_subsets_picture(time, quantised, fine, curves)
    (axes,) = figure.axes
    assert labels(figure) == [("time [ms]", "position [counts]")]
    drawn = [np.array(artist.get_data(), float) for artist in axes.lines]
    for i, curve in enumerate(curves):
        assert any(d.shape == (2, 50) and np.array_equal(d[1], curve) for d in drawn)
        assert any(np.array_equal(d, [time[i::3], quantised[i::3]]) for d in drawn)
    assert words(figure).splitlines()[1] == "samples 2, 5, 8, …"


def test_averaged_spline() -> None:
    time, fine = np.arange(10.0), np.linspace(0, 9, 50)
    figure = averaged_spline_picture(
        time, np.round(time), fine, fine + 0.1, fine, units=("s", "mrad")
    )
    (axes,) = figure.axes
    assert labels(figure) == [("time [s]", "position [mrad]")]
    assert_allclose(line(axes, "averaged splines"), [fine, fine + 0.1])
    assert_allclose(line(axes, "true position"), [fine, fine])
    assert_allclose(line(axes, "quantised samples"), [time, np.round(time)])
    unknown = averaged_spline_picture(time, np.round(time), fine, fine)
    assert len(unknown.axes[0].lines) == 2


def test_motion_of_a_joint() -> None:
    time = np.linspace(0, 4, 100)
    profiles = (1 + np.sin(time), np.cos(time), -np.sin(time))
    figure = motion_picture(time, *profiles)
    assert [label for _, label in labels(figure)] == [
        "position\n[rad]",
        "velocity\n[rad/s]",
        "acceleration\n[rad/s²]",
    ]
    assert figure.axes[-1].get_xlabel() == "time [s]"
    for axes, values in zip(figure.axes, profiles, strict=True):
        assert_allclose(np.array(axes.lines[-1].get_data()), [time, values])
    centres = [np.asarray(axes.lines[0].get_ydata(), float)[0] for axes in figure.axes]
    assert_allclose(centres, [float(np.mean(profiles[0])), 0.0, 0.0])


def test_velocity_reversal() -> None:
    time = np.linspace(1.0, 1.1, 51)
    measured, predicted = 10 * time, 10 * time - np.sign(time - 1.05)
    figure = reversal_picture(time, measured, predicted, reversal=1.05, true_reversal=1.049)
    upper, lower = figure.axes
    assert labels(figure) == [("", "torque [N m]"), ("time [s]", "error [N m]")]
    assert_allclose(line(upper, "measured"), [time, measured])
    dots = next(artist for artist in upper.lines if artist.get_label() == "predicted")
    assert (dots.get_linestyle(), dots.get_marker()) == ("None", ".")
    assert_allclose(line(upper, "predicted"), [time, predicted])
    assert_allclose(np.array(lower.lines[1].get_data()), [time, measured - predicted])
    for axes in (upper, lower):
        assert_allclose(line(axes, "estimated zero of velocity")[0], 1.05)
        assert_allclose(line(axes, "true zero of velocity")[0], 1.049)
    assert "true" not in words(reversal_picture(time, measured, predicted, reversal=1.05))


def test_disturbance_budget(rng: np.random.Generator) -> None:
    off = rng.lognormal(size=(3, 100))
    on = 0.5 * off
    on[1] = np.nan  # nothing is done against the second
    off[0, 7] = np.nan  # a run that failed
    figure = budget_picture(["quantisation", "compliance", "all"], off, on, floor=0.01)
    (axes,) = figure.axes
    assert axes.get_xscale() == "log"
    assert axes.get_xlabel().startswith("mean error cost ε [N m]")
    assert [tick.get_text() for tick in axes.get_yticklabels()] == [
        "quantisation",
        "compliance",
        "all",
    ]
    without, counter = line(axes, "counter-measure off"), line(axes, "counter-measure on")
    assert_allclose(without[0], np.nanmean(off, axis=1))
    assert_allclose(counter[0], np.mean(on[[0, 2]], axis=1))
    assert_allclose(np.round(counter[1]), [0, 2])
    assert_allclose(line(axes, "floor: true coefficients")[0], 0.01)
    bars = axes.collections[0]
    assert isinstance(bars, LineCollection)
    ends = np.array(bars.get_segments())[:, :, 0]
    assert_allclose(ends.T, np.nanquantile(off, [0.05, 0.95], axis=1))
    low, high = axes.get_ylim()
    assert low > high  # from the top down


def test_a_budget_of_no_counter_measures(rng: np.random.Generator) -> None:
    off = rng.lognormal(size=(2, 10))
    figure = budget_picture(["a", "b"], off, np.full((2, 10), np.nan))
    assert "counter-measure on" not in words(figure)


def test_wrong_data(rng: np.random.Generator) -> None:
    values = rng.lognormal(size=(2, 10))
    with pytest.raises(ValueError, match="counter-measure off: expected 3 rows, one a dist"):
        budget_picture(["a", "b", "c"], values, values)
    with pytest.raises(ValueError, match="counter-measure off: expected values above 0, got -"):
        budget_picture(["a", "b"], -values, values)


def test_nothing_drawn_lies_under_a_legend() -> None:
    """Legends stand below the axes."""
    time = np.linspace(1.0, 1.1, 51)
    for figure in (
        reversal_picture(time, time, time, reversal=1.05),
        motor_curve_picture(time, time, limit=1.05),
        budget_picture(["a"], time[None], time[None]),
    ):
        figure.draw_without_rendering()
        (legend,) = figure.legends
        boxes = [axes.get_tightbbox() for axes in figure.axes]
        assert all(box and legend.get_window_extent().y1 <= box.y0 + 1 for box in boxes)
