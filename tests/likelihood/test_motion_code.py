"""C code of equations of motion, against the same equations in JAX and their derivatives."""

import shutil

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.likelihood import MotionCode, TracedEquations, _motion_code, motion_code


pytestmark = pytest.mark.skipif(
    shutil.which("cc") is None, reason="no C compiler (cc) on this machine"
)
# More than one block of equations, and no whole number of them.
SAMPLES = 143


@pytest.fixture(scope="module")
def arm() -> jc.CSLC:
    """A turning and a sliding joint that lack some of the laws each, coupled."""
    robot = jc.Manipulator.from_modified_dh(
        [(0, 0, 0, 0), (np.pi / 2, 0.3, 0, 0)], kinds="RP", gravity=(0, 0, -9.81)
    )
    robot = robot.with_friction("viscous", "dry", "static", "root", "spring", joint=1)
    robot = robot.with_friction("asymmetric_viscous", "asymmetric_dry", "quadratic", joint=2)
    return jc.derive(robot, lengths="numeric")


@pytest.fixture(scope="module")
def code(arm: jc.CSLC) -> MotionCode:
    result = motion_code(arm)
    assert result is not None
    return result


@pytest.mark.parametrize("chunk", [4096, 128], ids=["alone", "in chunks"])
def test_it_is_the_equations_in_jax(
    arm: jc.CSLC, code: MotionCode, chunk: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_motion_code, "_CHUNK", chunk)
    rng = np.random.default_rng(0)
    n, shape = arm.joint_count, (SAMPLES - 2, arm.joint_count)
    intervals = rng.uniform(0.009, 0.011, SAMPLES - 1)
    time = np.concatenate([[0.0], np.cumsum(intervals)])
    q = np.sin(time[:, None] * [3.0, 5.0] + 0.3)
    turn = np.where(rng.uniform(size=shape) < 0.5, -1.0, rng.uniform(-1.0, 1.0, shape))
    direction = rng.choice([-1.0, 1.0], shape)
    k, slopes = rng.uniform(-1.0, 1.0, arm.size), np.log(rng.uniform(1.0, 20.0, n))
    shift = rng.uniform(-0.1, 0.1, shape)
    equations = TracedEquations(arm)

    expected = equations.linearised(intervals, k, slopes, q, turn, direction)
    obtained = code.linearised(intervals, k, slopes, q, turn, direction)
    assert_allclose(obtained.torque, expected.torque, rtol=1e-9, atol=1e-12)
    # Forward differences are off by their step, and by rounding over it.
    assert_allclose(obtained.by_position, expected.by_position, rtol=1e-6, atol=1e-3)
    columns = expected.by_coefficient.dense
    assert_allclose(obtained.by_coefficient.dense, columns, rtol=1e-9, atol=1e-11)
    inside = turn > -1.0  # without a turn, there is no such derivative
    assert_allclose(obtained.by_turn[inside], np.asarray(expected.by_turn)[inside], atol=1e-12)

    torque = code.torque(intervals, k, slopes, q, turn, direction)
    assert_allclose(torque, expected.torque, atol=1e-12)
    friction = equations.friction(intervals, k, slopes, q, turn, direction, shift)
    obtained = code.friction(intervals, k, slopes, q, turn, direction, shift)
    assert_allclose(obtained, friction, atol=1e-12)
    motion = rng.uniform(-1.0, 1.0, (3, *shape))
    assert_allclose(code.smooth(k, *motion), equations.smooth(k, *motion), atol=1e-12)


@pytest.fixture
def pendulum() -> jc.CSLC:
    robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0), name="swing")
    return jc.derive(robot.with_friction("viscous"), lengths="numeric")


@pytest.mark.parametrize("limit", ["_MOST_OPERATIONS", "_MOST_WITHOUT_COMPILER"])
def test_too_many_operations_are_refused(
    pendulum: jc.CSLC, limit: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether there is a compiler or not; what XLA would need for them is not to be had."""
    monkeypatch.setattr(_motion_code, "_MOST_WITHOUT_COMPILER", 3)
    monkeypatch.setattr(_motion_code, limit, 3)
    if limit == "_MOST_WITHOUT_COMPILER":
        monkeypatch.setenv("CC", "")
    with pytest.raises(ValueError, match=r"'swing': equations of motion of .* numeric lengths"):
        motion_code(pendulum)


def test_a_few_operations_need_no_compiler(
    pendulum: jc.CSLC, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", "")
    assert motion_code(pendulum) is None
