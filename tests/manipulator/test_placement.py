"""Modified Denavit-Hartenberg rows of any axes: the product of the rows is where the axes are."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from numpy.testing import assert_allclose

from jaxcslc.manipulator import Axis, Joint, modified_dh


X, Y, Z, O = (*np.eye(3), np.zeros(3))


def pose_of(row: Joint) -> np.ndarray:
    """Rot(z, gamma) Trans(z, b) Rot(x, alpha) Trans(x, a) Trans(z, d) Rot(z, theta)."""

    def screw(axis: int, angle: float, length: float) -> np.ndarray:
        c, s = math.cos(angle), math.sin(angle)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        pose = np.eye(4)
        pose[i, i], pose[i, j], pose[j, i], pose[j, j] = c, -s, s, c
        pose[axis, 3] = length
        return pose

    def number(length: float | None) -> float:
        assert length is not None
        return length

    first = screw(2, row.gamma, number(row.b.value))
    second = screw(0, row.alpha, number(row.a.value))
    return first @ second @ screw(2, row.theta, number(row.d.value))


def random_axes(rng: np.random.Generator, parents: Sequence[int]) -> list[Axis]:
    return [
        Axis("P" if rng.random() < 0.3 else "R", p, rng.normal(size=3), rng.normal(size=3))
        for p in parents
    ]


@pytest.mark.parametrize("parents", [(-1, 0, 1, 2, 3, 4), (-1, 0, 0, 1, 1, -1, 5), (-1, -1, -1)])
def test_rows_lead_to_the_axes(rng: np.random.Generator, parents: tuple[int, ...]) -> None:
    axes = random_axes(rng, parents)
    rows, frames = modified_dh(axes)
    for axis, row, frame in zip(axes, rows, frames, strict=True):
        before = frames[axis.parent] if axis.parent >= 0 else np.eye(4)
        assert_allclose(before @ pose_of(row), frame, atol=1e-10)
        direction = axis.direction / np.linalg.norm(axis.direction)
        assert_allclose(frame[:3, 2], direction, atol=1e-12)
        assert_allclose(np.cross(frame[:3, 3] - axis.origin, direction), 0.0, atol=1e-10)
        assert_allclose(np.linalg.det(frame), 1.0)
        assert row.parent == axis.parent + 1


def test_chains_need_no_branch_rows(rng: np.random.Generator) -> None:
    rows, _ = modified_dh(random_axes(rng, (-1, 0, 1, 2)))
    assert all(row.gamma == 0.0 and row.b.is_zero for row in rows[1:])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_parallel_axes(sign: float) -> None:
    """No common normal is the only one: that through the frame's origin is taken."""
    rows, _ = modified_dh([Axis("R", -1, O, Z), Axis("R", 0, 0.5 * X + 0.2 * Z, sign * Z)])
    assert rows[1].alpha == (0.0 if sign > 0 else math.pi)
    assert rows[1].a.value == 0.5
    assert rows[1].d.value == 0.0  # where along its axis the last frame lies is free


def test_one_axis_twice() -> None:
    rows, _ = modified_dh([Axis("R", -1, O, Z), Axis("R", 0, 0.3 * Z, Z), Axis("R", 1, X, Y)])
    assert (rows[1].alpha, rows[1].a.value, rows[1].d.value) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("miss", [0.0, 3.7e-6, -3.7e-6])
def test_rounded_right_angles_are_right(miss: float) -> None:
    """1.5708 misses pi/2 by 3.7e-6."""
    turned = np.array([math.sin(miss), 0.0, math.cos(miss)])
    rows, _ = modified_dh([Axis("R", -1, O, Z), Axis("R", 0, X, turned), Axis("R", 1, Y, X)])
    assert rows[1].alpha == 0.0
    assert rows[1].a.value == 1.0
    assert abs(rows[2].alpha) == math.pi / 2


def test_what_a_joint_reads_at_zero() -> None:
    rows, _ = modified_dh([Axis("R", -1, O, Z, -0.4), Axis("P", 0, O, Z, 0.1)])
    assert rows[0].theta == pytest.approx(-0.4)
    assert rows[1].d.value == pytest.approx(0.1)
