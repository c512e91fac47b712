"""Zero-points of velocities (7.6): against curves whose zeros are known."""

import csv
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from scripts.studies.puma560 import reversals


INTERVAL = 0.002
TIME = INTERVAL * np.arange(500)


def test_crossings_of_a_sine_lie_between_samples() -> None:
    points = reversals.zero_points(TIME, np.sin(2 * np.pi * (TIME - 0.1234) / 0.6))
    assert_allclose(points, np.outer([0.1234, 0.4234, 0.7234], [1, 1]), atol=1e-6)


def test_a_rest_lasts_from_its_first_sample_to_its_last() -> None:
    velocity = np.ones(500)
    velocity[:4], velocity[100:120], velocity[200:] = 0.0, 1e-5, -1.0
    velocity[490:] = 1e-6
    points = reversals.zero_points(TIME, velocity, resting=1e-4)
    crossing = (TIME[199] + TIME[200]) / 2
    rests = [[TIME[0], TIME[3]], [TIME[100], TIME[119]]]
    assert_allclose(points, [*rests, [crossing, crossing], [TIME[490], TIME[499]]])
    # A single sample of zero is a crossing, not a rest of some length.
    velocity = TIME - TIME[250]
    assert_array_equal(reversals.zero_points(TIME, velocity), [[TIME[250], TIME[250]]])


def test_distances_and_intervals() -> None:
    """In units of an interval: true zeros at 2.5, and a rest from 10 to 14.5."""
    true = INTERVAL * np.array([[2.5, 2.5], [10.0, 14.5]])
    estimated = INTERVAL * np.array(
        [[2.9, 2.9], [3.1, 3.1], [7.25, 7.25], [12.2, 12.2], [15.2, 16]]
    )
    points = reversals.compared_zero_points(estimated, true, INTERVAL)
    assert_allclose(points.distance, [0.4, 0.6, 2.75, 0.0, 0.7], atol=1e-9)
    assert points.same_interval.tolist() == [True, False, False, True, False]
    assert points.rests.tolist() == [False, False, True, True, True]
    with pytest.raises(ValueError, match="expected a zero-point"):
        reversals.compared_zero_points(estimated, true[:0], INTERVAL)


def test_rows_count_zero_points_not_recordings() -> None:
    first = reversals.ZeroPoints(
        np.array([0.2, 3.0]), np.array([True, False]), np.array([False, True])
    )
    second = reversals.ZeroPoints(np.array([0.9]), np.array([False]), np.array([False]))
    row = reversals.row_of("both", [first, second])
    assert (row["zero-points"], row["at rests"]) == (3, 1)
    assert row["same interval [%]"] == "33.3"
    assert row["within one interval [%]"] == "66.7"
    assert row["at crossings [%]"] == "100.0" and row["at rests [%]"] == "0.0"
    assert row["recordings [%]"] == "50 to 100"
    assert row["farthest [intervals]"] == 3.0


def test_the_command(tmp_path: Path) -> None:
    assert reversals.main(["--quick", "-o", str(tmp_path / "out")]) == 0
    with (tmp_path / "out" / "zero_points.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 6
    for row in rows:
        assert 80.0 <= float(row["same interval [%]"]) <= float(row["within one interval [%]"])
        assert int(row["zero-points"]) > int(row["at rests"]) or "comparison" in row["recording"]
