"""Equations of motion against the same equations in JAX, with a compiler and without."""

import shutil

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.likelihood import EquationPoint, MotionEquations, _equations
from tests.likelihood.traced_equations import TracedEquations


# More than one block of equations, and no whole number of them.
SAMPLES = 143


@pytest.fixture(params=["compiled", "by NumPy"])
def arm(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> jc.CSLC:
    """A turning and a sliding joint that lack some of the laws each, coupled."""
    if request.param == "by NumPy":
        monkeypatch.setenv("CC", "")
    elif shutil.which("cc") is None:
        pytest.skip("no C compiler (cc) on this machine")
    robot = jc.Manipulator.from_modified_dh(
        [(0, 0, 0, 0), (np.pi / 2, 0.3, 0, 0)],
        kinds="RP",
        gravity=(0, 0, -9.81),
        name=f"arm {request.param}",  # code is kept for each network
    )
    robot = robot.with_friction("viscous", "dry", "static", "root", "spring", joint=1)
    robot = robot.with_friction("asymmetric_viscous", "asymmetric_dry", "quadratic", joint=2)
    return jc.derive(robot, lengths="numeric")


@pytest.mark.parametrize("chunk", [4096, 128], ids=["alone", "in chunks"])
def test_they_are_those_in_jax(arm: jc.CSLC, chunk: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_equations, "_CHUNK", chunk)
    rng = np.random.default_rng(0)
    n, shape = arm.joint_count, (SAMPLES - 2, arm.joint_count)
    intervals = rng.uniform(0.009, 0.011, SAMPLES - 1)
    time = np.concatenate([[0.0], np.cumsum(intervals)])
    q = np.sin(time[:, None] * [3.0, 5.0] + 0.3)
    turn = np.where(rng.uniform(size=shape) < 0.5, -1.0, rng.uniform(-1.0, 1.0, shape))
    direction = rng.choice([-1.0, 1.0], shape)
    k, slopes = rng.uniform(-1.0, 1.0, arm.size), np.log(rng.uniform(1.0, 20.0, n))
    equations, at = MotionEquations(arm, intervals), EquationPoint(k, slopes, q, turn, direction)

    expected = TracedEquations(arm).linearised(intervals, k, slopes, q, turn, direction)
    obtained = equations.linearised(at)
    assert_allclose(obtained.torque, expected.torque, rtol=1e-9, atol=1e-12)
    # Forward differences are off by their step, and by rounding over it.
    assert_allclose(obtained.by_position, expected.by_position, rtol=1e-6, atol=1e-3)
    columns = expected.by_coefficient.dense
    assert_allclose(obtained.by_coefficient.dense, columns, rtol=1e-9, atol=1e-11)
    inside = turn > -1.0  # without a turn, there is no such derivative
    assert_allclose(obtained.by_turn[inside], np.asarray(expected.by_turn)[inside], atol=1e-12)
    torque = equations.torque(at)
    assert_allclose(torque, expected.torque, atol=1e-12)


def test_more_operations_than_a_compiler_takes_are_those_of_numpy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("jaxcslc.likelihood._equations._MOST_COMPILED", 3)
    robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0), name="swing")
    network = jc.derive(robot.with_friction("viscous"), lengths="numeric")
    q, ones = np.sin(0.03 * np.arange(12.0))[:, None], np.ones((10, 1))
    k, slope, intervals = np.array([0.5, 0.3, -0.1, 0.2]), np.zeros(1), np.full(11, 0.01)
    torque = MotionEquations(network, intervals).torque(EquationPoint(k, slope, q, -ones, ones))
    expected = TracedEquations(network).torque(intervals, k, slope, q, -ones, ones)
    assert_allclose(torque, expected, atol=1e-12)
