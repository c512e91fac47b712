"""Averaged splines: what they reproduce exactly, what they are independent of, and how well."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from scipy import interpolate

from jaxcslc.recordings import (
    AveragedSplines,
    CentralDifferences,
    find_reversals,
    spline_derivatives,
)


COUNT = 1e-4
INTERVAL = 0.002


def quantised(position: np.ndarray) -> np.ndarray:
    return COUNT * np.round(position / COUNT)


def uneven(rng: np.random.Generator, samples: int) -> np.ndarray:
    return np.cumsum(INTERVAL * rng.uniform(0.5, 1.5, samples))


@pytest.mark.parametrize("samples", [4, 5, 300])
def test_derivatives_are_those_of_scipys_splines(rng: np.random.Generator, samples: int) -> None:
    time, values = uneven(rng, samples), rng.normal(size=(samples, 2))
    oracle = interpolate.CubicSpline(time, values)
    for order, obtained in enumerate(spline_derivatives(time, values), start=1):
        expected = oracle(time, order)
        np.testing.assert_allclose(obtained, expected, atol=1e-10 * np.max(np.abs(expected)))


@pytest.mark.parametrize("spacing", [1, 2, 9, 30])
@pytest.mark.parametrize("samples", [200, 31, 8, 5])
def test_cubics_are_reproduced(rng: np.random.Generator, spacing: int, samples: int) -> None:
    time = uneven(rng, samples)
    at = (time - time[0]) / (time[-1] - time[0])
    scale = time[-1] - time[0]
    cubics = [np.polynomial.Polynomial(c) for c in rng.standard_normal((3, 4))]
    position = np.stack([cubic(at) for cubic in cubics], axis=1)
    smoothed = AveragedSplines(spacing, sections=False).smooth(time, position)
    for order, values in enumerate(smoothed):
        truth = np.stack([cubic.deriv(order)(at) for cubic in cubics], axis=1) / scale**order
        np.testing.assert_allclose(values, truth, atol=1e-8 * np.max(np.abs(truth)))


def test_spacing_one_interpolates(rng: np.random.Generator) -> None:
    time = uneven(rng, 50)
    position = rng.standard_normal((50, 2))
    q, qd, _ = AveragedSplines(1, sections=False).smooth(time, position)
    np.testing.assert_allclose(q[1:-1], position[1:-1], atol=1e-12)
    # Between knots it is the cubic spline; only the end conditions may differ from scipy's own.
    spline = interpolate.CubicSpline(time, position)
    np.testing.assert_allclose(qd[20:30], spline(time, 1)[20:30], rtol=1e-3, atol=1e-2)


def test_inside_it_is_the_mean_of_scipy_splines() -> None:
    time = np.arange(400) * INTERVAL
    position = quantised(np.sin(5 * time))[:, None]
    smoothed = AveragedSplines(7, sections=False).smooth(time, position)
    splines = [interpolate.CubicSpline(time[n::7], position[n::7, 0]) for n in range(7)]
    # The influence of an end fades by a factor of 3.7 a knot.
    inside = slice(150, 250)
    for order, values in enumerate(smoothed):
        mean = np.mean([spline(time[inside], order) for spline in splines], axis=0)
        np.testing.assert_allclose(values[inside, 0], mean, rtol=1e-6, atol=1e-6)


def test_smoothing_is_linear_and_shift_invariant(rng: np.random.Generator) -> None:
    time = uneven(rng, 120)
    one, other = rng.standard_normal((2, 120, 2))
    smoothing = AveragedSplines(6, sections=False)
    together = smoothing.smooth(time + 5.0, 2.0 * one - 3.0 * other)
    for both, a, b in zip(
        together, smoothing.smooth(time, one), smoothing.smooth(time, other), strict=True
    ):
        np.testing.assert_allclose(both, 2.0 * a - 3.0 * b, atol=1e-7 * np.max(np.abs(both)))


@pytest.mark.parametrize("sections", [True, False])
def test_time_reversal(rng: np.random.Generator, sections: bool) -> None:
    time = uneven(rng, 600)
    position = quantised(np.sin(12 * time))[:, None]
    smoothing = AveragedSplines(8, sections=sections)
    q, qd, qdd = smoothing.smooth(time, position)
    q_back, qd_back, qdd_back = smoothing.smooth(-time[::-1], position[::-1])
    # The instants of reversals come from a search, which ends within a thousandth of a sample.
    np.testing.assert_allclose(q_back[::-1], q, atol=1e-6)
    np.testing.assert_allclose(-qd_back[::-1], qd, atol=2e-2)
    np.testing.assert_allclose(qdd_back[::-1], qdd, atol=0.5)


@pytest.mark.parametrize("sections", [True, False])
def test_joints_are_smoothed_each_by_itself(rng: np.random.Generator, sections: bool) -> None:
    time = uneven(rng, 300)
    position = quantised(np.stack([np.sin(9 * time), np.cos(7 * time), time**2], axis=1))
    together = AveragedSplines((4, 9, 15), sections=sections).smooth(time, position)
    for joint, spacing in enumerate((4, 9, 15)):
        alone = AveragedSplines(spacing, sections=sections).smooth(time, position[:, [joint]])
        for a, b in zip(together, alone, strict=True):
            assert np.array_equal(a[:, [joint]], b)


@pytest.mark.parametrize("sections", [True, False])
@pytest.mark.parametrize("period", [0.5, 1.1, 4.1])
def test_errors_on_a_sine(period: float, sections: bool) -> None:
    # Interior errors of a clamped cubic spline are below 5/384 h⁴ in position and 3/8 h² in the
    # second derivative, times the fourth derivative (Hall and Meyer, J. Approx. Theory 16, 1976).
    time = np.arange(2500) * INTERVAL
    omega = 2 * np.pi / period
    position = np.sin(omega * time)[:, None]
    spacing = 9
    step = 1.5 * spacing * INTERVAL
    q, _, qdd = AveragedSplines(spacing, sections=sections, tolerance=1e-4).smooth(time, position)
    assert np.max(np.abs(q - position)) < 2.0 * 5 / 384 * (omega * step) ** 4
    assert np.max(np.abs(qdd + omega**2 * position)) < 2.0 * 3 / 8 * omega**4 * step**2


@pytest.mark.parametrize("period", [0.5, 1.1, 4.1])
def test_quantised_sines_beat_plain_differences(period: float) -> None:
    time = np.arange(2500) * INTERVAL
    omega = 2 * np.pi / period
    position = quantised(np.sin(omega * time))[:, None]

    truth = -(omega**2) * np.sin(omega * time)[:, None]

    def error(qdd: np.ndarray) -> float:
        return float(np.sqrt(np.mean((qdd - truth)[20:-20] ** 2)))

    plain = CentralDifferences().smooth(time, position)[2]
    # Eqn 7.2-2: plain differences come in steps of a count over four squared intervals.
    step = COUNT / (4 * INTERVAL**2)
    np.testing.assert_allclose(plain[2:-2] / step, np.round(plain[2:-2] / step), atol=1e-6)
    assert 0.5 * step < error(plain)
    assert error(AveragedSplines(9).smooth(time, position)[2]) < error(plain) / 30


def friction_jumps(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[float]]:
    """Position, acceleration and turning points of a joint with dry friction under steps of drive.

    It leaves each turning point at 9 rad/s² and comes to rest at the next at 15 rad/s², where
    friction helps: parabolas that join with the same velocity.
    """
    q, qdd = np.zeros_like(time), np.zeros_like(time)
    away, back = 0.25, 0.25 * 9.0 / 15.0
    turn, height, sign = 0.313, 0.5, -1.0
    turns: list[float] = []
    while turn - back < time[-1]:
        for first, last, size in ((turn - back, turn, 15.0), (turn, turn + away, 9.0)):
            part = (time >= first) & (time < last)
            q[part] = height + 0.5 * sign * size * (time[part] - turn) ** 2
            qdd[part] = sign * size
        turns.append(turn)
        turn += away + back
        height += 0.5 * sign * (9.0 * away**2 + 15.0 * back**2)
        sign = -sign
    return q, qdd, turns


def test_reversals_are_found_to_a_fraction_of_a_sample() -> None:
    time = np.arange(75, 1270) * INTERVAL
    q, _, turns = friction_jumps(time)
    (reversals,) = find_reversals(time, quantised(q)[:, None], tolerance=3 * COUNT, window=22)
    assert [reversal.direction for reversal in reversals] == [-1, 1, -1, 1, -1, 1]
    errors = np.array([reversal.time for reversal in reversals]) - turns[:6]
    assert np.sqrt(np.mean(errors**2)) < 0.1 * INTERVAL


def test_the_origin_of_time_does_not_matter() -> None:
    """Stamps since 1970, of a clock whose periods a float64 holds exactly."""
    time = np.arange(600) / 512.0
    position = np.stack([quantised(np.sin(9 * time)), quantised(np.cos(5 * time))], axis=1)
    smoothed = AveragedSplines(9).smooth(time, position)
    stamped = AveragedSplines(9).smooth(time + 2.0**31, position)
    for values, expected, name in zip(stamped, smoothed, ("q", "qd", "qdd"), strict=True):
        # A stamp's rounding of 2.4e-7 s moves a reversal by as much.
        scale = np.max(np.abs(expected))
        np.testing.assert_allclose(values, expected, rtol=0, atol=1e-4 * scale, err_msg=name)


def test_accelerations_may_jump_between_sections() -> None:
    # From the middle of a section to the middle of another.
    time = np.arange(75, 1270) * INTERVAL
    q, qdd, turns = friction_jumps(time)
    away = np.min(np.abs(time[:, None] - np.array(turns)), axis=1)
    # At the sample itself the truth has two values.
    near = (away < 0.015) & (away > INTERVAL)

    def error(sections: bool) -> float:
        smoothed = AveragedSplines(15, sections).smooth(time, quantised(q)[:, None])[2][:, 0]
        return float(np.sqrt(np.mean((smoothed - qdd)[near] ** 2)))

    assert error(sections=True) < 0.4
    assert error(sections=False) > 4 * error(sections=True)


@pytest.mark.parametrize(
    "noise", [pytest.param(0.0, id="counts"), pytest.param(2e-4, id="counts and noise")]
)
def test_velocities_of_a_section_share_one_sign(rng: np.random.Generator, noise: float) -> None:
    time = np.arange(3000) * INTERVAL
    position = np.sin(3 * time) + 0.3 * np.sin(7.7 * time) + noise * rng.standard_normal(3000)
    position = quantised(position)
    spacing, tolerance = 11, 3 * COUNT + 6 * noise
    (turns,) = find_reversals(time, position[:, None], tolerance=tolerance, window=16)
    truth = 3 * np.cos(3 * time) + 0.3 * 7.7 * np.cos(7.7 * time)
    assert len(turns) == np.sum(np.diff(np.sign(truth)) != 0)
    _, qd, _ = AveragedSplines(spacing, True, tolerance).smooth(time, position[:, None])
    bounds = [time[0], *(turn.time for turn in turns), np.inf]
    directions = [-turns[0].direction, *(turn.direction for turn in turns)]
    for (start, end), direction in zip(pairwise(bounds), directions, strict=True):
        section = (time >= start) & (time < end)
        assert np.all(direction * qd[section] >= 0.0)


def test_velocity_at_a_reversal_is_zero() -> None:
    # A turn between two samples: velocities at both are those of half an interval away from it.
    time = (np.arange(-200, 200) + 0.5) * INTERVAL
    position = quantised(-5.0 * time**2)[:, None]
    _, qd, _ = AveragedSplines(13).smooth(time, position)
    np.testing.assert_allclose(qd[199:201, 0], [5.0 * INTERVAL, -5.0 * INTERVAL], atol=3e-3)


@pytest.mark.parametrize(
    "shape",
    [
        pytest.param(lambda t: 0 * t, id="at rest"),
        pytest.param(lambda t: np.where(t < 0.5, 0.0, t - 0.5), id="sets off"),
        pytest.param(lambda t: np.abs((t * 10) % 2 - 1), id="zigzag"),
        pytest.param(lambda t: COUNT * ((t / INTERVAL).round() % 2), id="flickering count"),
        pytest.param(lambda t: np.clip(np.sin(4 * t), -0.5, 0.5), id="long rests"),
        pytest.param(lambda t: np.where(t < INTERVAL * 2.5, 1.0 + 0 * t, t), id="turns at once"),
        pytest.param(lambda t: np.where(t == t[-2], 1.0, 0.0), id="one spike"),
        pytest.param(lambda t: np.sin(np.pi / (2.0 * INTERVAL) * t), id="turns every other sample"),
    ],
)
@pytest.mark.parametrize("spacing", [1, 2, 9, 25])
def test_singular_motions_stay_finite(
    shape: Callable[[np.ndarray], np.ndarray], spacing: int
) -> None:
    time = np.arange(500) * INTERVAL
    position = quantised(shape(time))[:, None]
    q, qd, qdd = AveragedSplines(spacing).smooth(time, position)
    assert np.isfinite(q).all() and np.isfinite(qd).all() and np.isfinite(qdd).all()
    assert np.max(np.abs(q - position)) <= 1.5 * np.ptp(position)


def test_a_flickering_count_is_no_reversal() -> None:
    time = np.arange(500) * INTERVAL
    position = COUNT * np.round(0.01 * time / COUNT + 0.4 * np.cos(np.arange(500)))
    assert np.any(np.diff(position) < 0)
    assert find_reversals(time, position[:, None], tolerance=3 * COUNT, window=15) == [()]


def test_low_pass_does_not_look_for_reversals() -> None:
    time = np.arange(500) * INTERVAL
    torque = np.sin(20 * time)[:, None]
    one, other = (AveragedSplines(9, sections).low_pass(time, torque) for sections in (True, False))
    assert np.array_equal(one, other)


def test_settled_splines_keep_their_tolerance(rng: np.random.Generator) -> None:
    """Of another motion, they see the reversals that the first one's counts do not hide."""
    time = np.arange(1000) * INTERVAL
    counts = quantised(np.sin(2 * np.pi * time))[:, None]
    smoothing = AveragedSplines(9)
    settled = smoothing.settled(counts)
    assert settled.spacing == smoothing.spacing
    assert settled.settled(rng.normal(size=counts.shape)) == settled
    for one, other in zip(
        smoothing.smooth(time, counts), settled.smooth(time, counts), strict=True
    ):
        np.testing.assert_array_equal(one, other)
    # A ripple of a count, without any noise: reversals by its own noise, none by the settled one.
    ripple = 1e-3 * time[:, None] + COUNT * np.sin(2 * np.pi * 5.0 * time)[:, None]
    whole = AveragedSplines(9, sections=False).smooth(time, ripple)[1]
    np.testing.assert_array_equal(settled.smooth(time, ripple)[1], whole)
    assert np.any(smoothing.smooth(time, ripple)[1] != whole)


def test_wrong_settings() -> None:
    with pytest.raises(ValueError, match="spacing is 0; expected 1 sample or more"):
        AveragedSplines(0)
    with pytest.raises(ValueError, match="2 spacings for 1 joints"):
        AveragedSplines((3, 4)).smooth(np.arange(50.0), np.zeros((50, 1)))


def test_a_turn_beside_the_ends_of_a_short_record_is_found() -> None:
    """Fewer samples around a turn than two cubics have coefficients."""
    time = np.arange(5) * 0.01
    position = np.array([0.0, 1.0, 0.2, 0.1, 0.0])[:, None]
    ((turn,),) = find_reversals(time, position, tolerance=0.5, window=1)
    assert turn.direction == -1
    assert 0.0 < turn.time < 0.02
