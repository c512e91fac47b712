"""Wrong lengths and axes in a robot's file: equations, sizes of small errors, and their names."""

import dataclasses
import math

import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.checks._geometry import (
    GeometryError,
    body_regressor,
    geometry_columns,
    geometry_errors,
)
from jaxcslc.manipulator import Length


# A spatial arm of four joints, whose lengths all matter to its torque.
ROWS = [
    (0.0, 0.0, 0.0, 0.0),
    (-math.pi / 2, 0.0, 0.1, 0.0),
    (0.0, 0.45, 0.05, 0.0),
    (math.pi / 2, 0.1, 0.35, 0.0),
]


def robot(rows: list[tuple[float, float, float, float]] = ROWS) -> jc.Manipulator:
    made = jc.Manipulator.from_modified_dh(rows, name="arm")
    return dataclasses.replace(made, friction=("viscous", "dry"))


def motion(joints: int, samples: int = 40) -> np.ndarray:
    return np.random.default_rng(3).normal(size=(3, samples, joints))


def recorded(arm: jc.Manipulator, samples: int = 4000) -> jc.Recording:
    """A rich motion of an arm with links of chosen masses, and noise of 0.2 %."""
    network = jc.derive(arm, lengths="numeric")
    rng = np.random.default_rng(0)
    bodies = rng.normal(size=11 * arm.joint_count).reshape(-1, 11)
    bodies[:, :6], bodies[:, 9], bodies[:, 10] = [0.4, 0.4, 0.4, 0, 0, 0], 3.0, 0.1
    bodies[:, 6:9] *= 0.3
    t = 0.004 * np.arange(samples)[:, None]
    w = 2.0 * np.pi * np.array([0.21, 0.33, 0.47, 0.58])
    parts = [(1.0, w, 0.3), (0.5, 2.3 * w, 1.1)]
    q, qd, qdd = np.sum(
        [
            (
                size * np.sin(rate * t + phase),
                size * rate * np.cos(rate * t + phase),
                -size * rate**2 * np.sin(rate * t + phase),
            )
            for size, rate, phase in parts
        ],
        axis=0,
    )
    torque = body_regressor(arm, q, qd, qdd) @ bodies.ravel() + 0.5 * qd + 0.8 * np.sign(qd)
    noise = 0.002 * torque.std(axis=0) * rng.normal(size=q.shape)
    assert network.joint_count == 4
    return jc.Recording(t[:, 0], q, torque + noise)


@pytest.mark.parametrize("rows", [ROWS, [(0, 0.2, 0, 0.3), (math.pi / 2, 0.1, 0.2, 0.1)]])
def test_bodies_explain_what_the_exact_algebra_does(
    rows: list[tuple[float, float, float, float]],
) -> None:
    """Every torque of the network, whose equations Pinocchio confirms, and none besides."""
    arm = robot(rows)
    network = jc.derive(arm, lengths="numeric")
    q, qd, qdd = motion(arm.joint_count)
    exact = np.asarray(network.regressor(q, qd, qdd))[..., network.layout.inertial]
    bodies = body_regressor(arm, q, qd, qdd).reshape(-1, 11 * arm.joint_count)
    exact = exact.reshape(len(bodies), -1)
    both = np.concatenate([bodies, exact], axis=1)
    ranks = [np.linalg.matrix_rank(matrix, 1e-8) for matrix in (bodies, exact, both)]
    assert ranks[0] == ranks[1] == ranks[2]


def test_a_prismatic_joint_moves_along_its_axis() -> None:
    """A mass m on a slide along gravity needs m (g + acceleration)."""
    slide = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], kinds="P", gravity=[0, 0, -9.81])
    still = np.zeros((1, 1))
    torque = body_regressor(slide, still, still, still + 2.0)[0, 0]
    assert torque[9] == pytest.approx(11.81)


def test_no_length_is_off_by_more_than_the_longest_of_the_arm() -> None:
    for error in geometry_errors(jc.derive(robot(), lengths="numeric")):
        assert error.is_plausible(robot(), -0.4)
        assert error.is_plausible(robot(), 0.5) == error.is_angle


@pytest.mark.parametrize("arm", [jc.puma560(), jc.panda()])
def test_named_lengths_keep_their_names(arm: jc.Manipulator) -> None:
    """A length that the file has as zero is not called by the name of another."""
    network = jc.derive(arm)
    q, qd, qdd = motion(arm.joint_count, 20)
    torque = np.random.default_rng(0).normal(size=q.shape)
    columns = geometry_columns(network, (q, qd, qdd), torque)
    assert columns.shape == (*q.shape, len(geometry_errors(network)))
    assert np.all(np.isfinite(columns))


def test_columns_are_the_torque_of_small_errors() -> None:
    """Against the exact equations of the robot with another length or angle."""
    arm = robot()
    network = jc.derive(arm, lengths="numeric")
    q, qd, qdd = motion(4, 200)
    k = np.zeros(network.size)
    k[network.layout.inertial] = np.random.default_rng(1).normal(size=network.size)[
        network.layout.inertial
    ]
    torque = np.asarray(network.torque(k, q, qd, qdd))
    columns = geometry_columns(network, (q, qd, qdd), torque)
    own = np.asarray(network.regressor(q, qd, qdd)).reshape(-1, network.size)
    for index, error in enumerate(geometry_errors(network)):
        other = jc.derive(error.robot(arm, 1e-5), lengths="numeric")
        moved = np.asarray(other.torque(k, q, qd, qdd)) if other.size == network.size else None
        if moved is None:  # an angle that is no quarter turn has more coefficients
            continue
        change = ((moved - torque) / 1e-5 - columns[..., index]).ravel()
        # Up to what the other coefficients make up for.
        left = change - own @ np.linalg.lstsq(own, change, rcond=None)[0]
        assert np.abs(left).max() < 1e-3 * np.abs(columns[..., index]).max()


def test_a_length_is_named_with_its_size() -> None:
    """The arm's elbow is 6 cm further than its file says."""
    error = GeometryError(2, "a")
    arm = error.robot(robot(), 0.06)
    assert arm.joints[2].a == Length(0.51, robot().joints[2].a.symbol)
    (finding,) = jc.check(jc.derive(robot(), lengths="numeric"), recorded(arm)).findings
    assert "the distance between the axes of" in finding.cause
    assert finding.cause.endswith("is 6 cm more than in the file")


def test_an_axis_is_named() -> None:
    """The arm's third joint turns about the y axis of its frame; the file says z."""
    true = recorded(robot())
    rows = list(ROWS)
    rows[2], rows[3] = (math.pi / 2, 0.45, 0.05, 0.0), (0.0, 0.1, 0.35, 0.0)
    found = jc.check(jc.derive(robot(rows), lengths="numeric"), true).findings
    assert found and found[0].kind == "axis"


def test_nothing_is_wrong_with_the_right_file() -> None:
    assert jc.check(jc.derive(robot(), lengths="numeric"), recorded(robot())).findings == ()
