"""Possible bodies as a part of `identify`: judged as by hand, used where they help, and said so."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc.bodies import (
    InformedFit,
    JudgedPart,
    PossibleFit,
    in_file_frames,
    other_masses,
    possible_fit,
)
from jaxcslc.payload._report import in_last_body_frame
from jaxcslc.uncertainty import cross_validated_error
from tests import arms


_ROUNDING = 1e-9
_SOLVER = 5e-3  # what the conic solver leaves of directions that the torque does not show
FOLDS = 8
SOLVER = jc.LeastSquares(errors="independent")


@pytest.fixture(scope="module")
def network() -> jc.CSLC:
    """Two joints with full tensors, motors and friction."""
    return arms.elbow()


@pytest.fixture(scope="module")
def k(network: jc.CSLC) -> Float[np.ndarray, " coefficients"]:
    """Of bodies that are balls."""
    ball = jc.LinkParameters(2.0, np.array([0.05, 0.02, 0.1]), 0.01 * np.eye(3), 0.05)
    return np.asarray(network.coefficients_from([ball, ball], viscous=[0.3, 0.2], dry=[0.1, 0.1]))


def patterns_of(
    network: jc.CSLC, k: Float[np.ndarray, " _"], size: float, noise: float, seed: int = 0
) -> jc.Patterns:
    """Motion of an amplitude, and its torque with noise."""
    t, w = np.arange(480) * 0.02, np.array([1.3, 2.1])
    angle = t[:, None] * w + [0.3, 1.1]
    q, qd, qdd = (
        size * np.sin(angle),
        size * w * np.cos(angle),
        -size * w**2 * np.sin(angle),
    )
    error = noise * np.random.default_rng(seed).normal(size=q.shape)
    torque = np.asarray(network.torque(k, q, qd, qdd)) + error
    every = np.ones(q.shape, bool)
    return jc.Patterns(t, q, qd, qdd, torque, every, every)


def fitted(network: jc.CSLC, patterns: jc.Patterns, *, always: bool = False) -> PossibleFit:
    fit = SOLVER.fit(network, patterns)
    fold = np.arange(patterns.samples) * FOLDS // patterns.samples
    fits = SOLVER.fits_without_folds(network, patterns, fold)
    parts = JudgedPart.of(network, patterns, fit).stretches(tuple(fits))
    return possible_fit(network, InformedFit(fit), patterns, parts, always=always)


def test_errors_are_those_of_fits_to_the_other_stretches(
    network: jc.CSLC, k: Float[np.ndarray, " _"]
) -> None:
    patterns = patterns_of(network, k, 0.2, 0.3)
    possible = fitted(network, patterns)
    free = cross_validated_error(network, patterns, jc.Settings(solver=SOLVER), folds=FOLDS)
    for name in ("training", "held_out", "limit"):
        np.testing.assert_allclose(
            getattr(possible.free_held_out, name), getattr(free, name), rtol=1e-6
        )
    regressor = np.asarray(network.regressor(patterns.q, patterns.qd, patterns.qdd))
    squares, every = np.zeros(2), np.ones(patterns.q.shape, bool)
    for stretch in range(FOLDS):
        rows = np.arange(patterns.samples) * FOLDS // patterns.samples == stretch
        others = dataclasses.replace(patterns, friction_mask=~rows[:, None] & every)
        bodies = jc.physical_parameters(network, SOLVER.fit(network, others))
        error = np.asarray(patterns.torque)[rows] - regressor[rows] @ bodies.k
        squares += np.sum(error**2, axis=0)
    np.testing.assert_allclose(
        possible.held_out.held_out, np.sqrt(squares / patterns.samples), rtol=1e-3
    )


def test_bodies_are_used_where_they_predict_better(
    network: jc.CSLC, k: Float[np.ndarray, " _"]
) -> None:
    """Tame motion with much noise: what is learnt of it, other motion shows."""
    tame, wide = patterns_of(network, k, 0.2, 0.3), patterns_of(network, k, 1.5, 0.0)
    possible = fitted(network, tame, always=True)
    np.testing.assert_array_equal(np.asarray(possible.fit.k), possible.parameters.k)
    errors = {
        name: np.asarray(wide.torque - network.torque(vector, wide.q, wide.qd, wide.qdd))
        for name, vector in (("free", possible.free.k), ("possible", possible.parameters.k))
    }
    assert np.sum(errors["possible"] ** 2) < 0.5 * np.sum(errors["free"] ** 2)
    assert possible.change < 0


def test_choice_follows_the_errors_and_their_spread(
    network: jc.CSLC, k: Float[np.ndarray, " _"]
) -> None:
    """Bodies that the data speak for are used; those that fit and truth share change nothing."""
    well = fitted(network, patterns_of(network, k, 1.5, 0.05))
    assert not well.used and abs(well.change) < 0.01 and not well.warnings
    np.testing.assert_array_equal(np.asarray(well.fit.k), np.asarray(well.free.k))
    patterns = patterns_of(network, k, 0.2, 0.3)
    # As if fits to the others had friction that drives the joints.
    wrong = 5.0 * (np.array(network.names) == "kd1")
    fits = SOLVER.fits_without_folds(network, patterns, np.arange(480) * FOLDS // 480)
    fit = SOLVER.fit(network, patterns)
    worse = tuple(fit._replace(k=fit.k - wrong) for fit in fits)
    parts = JudgedPart.of(network, patterns, fit).stretches(worse)
    assert possible_fit(network, InformedFit(fit), patterns, parts).used


def test_a_body_far_from_the_fit_is_named_with_what_to_do(
    network: jc.CSLC, k: Float[np.ndarray, " _"]
) -> None:
    impossible = k.copy()
    last = next(i for i, c in enumerate(network.coefficients) if "Izz2" in c.expression)
    impossible[last] = -1.0
    possible = fitted(network, patterns_of(network, impossible, 1.0, 0.01))
    (warning,) = possible.warnings
    assert f"({network.names[last]}" in warning and "link 2 by" in warning and "--prior" in warning
    assert not possible.used  # impossible as they are, they are what the torque follows


def test_masses_far_from_the_file_are_named(network: jc.CSLC, k: Float[np.ndarray, " _"]) -> None:
    patterns = patterns_of(network, k, size=1.0, noise=0.01)
    parameters = jc.physical_parameters(network, SOLVER.fit(network, patterns))
    masses = [float(link.mass) for link in parameters.links]

    def with_file(factor: float) -> jc.CSLC:
        links = [dataclasses.replace(link, mass=factor * link.mass) for link in parameters.links]
        robot = dataclasses.replace(network.robot, links=(parameters.links[0], links[1]))
        return jc.derive(robot, lengths="numeric")

    assert other_masses(network, parameters) == ()  # no masses in the file
    assert other_masses(with_file(1.9), parameters) == ()
    (sentence,) = other_masses(with_file(2.1), parameters)
    assert f"link 2 {masses[1]:.3g} kg instead of {2.1 * masses[1]:.3g}" in sentence
    assert "link 1" not in sentence and "--prior" in sentence


def test_bodies_are_in_the_frames_of_the_file(tmp_path: Path) -> None:
    """Coefficients of a URDF's bodies lead back to its inertial elements, tool left aside."""
    (tmp_path / "arm.urdf").write_text("""<robot name="arm"><link name="floor"/>
  <link name="upper"><inertial><origin xyz="0.1 0.02 0.03" rpy="0.1 0.2 0.3"/><mass value="2"/>
    <inertia ixx="0.1" iyy="0.2" izz="0.15" ixy="0.01" ixz="0" iyz="0"/></inertial></link>
  <link name="tool"><inertial><origin xyz="0 0 0.05"/><mass value="0.5"/>
    <inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="continuous"><parent link="floor"/><child link="upper"/>
    <origin xyz="0 0 0.3" rpy="0.2 0 0.1"/><axis xyz="0.6 0 0.8"/></joint>
  <joint name="bolt" type="fixed"><parent link="upper"/><child link="tool"/>
    <origin xyz="0.2 0 0"/></joint></robot>""")
    robot = jc.load_robot(tmp_path / "arm.urdf")
    network = jc.derive(robot, lengths="numeric")
    assert robot.links is not None and robot.source is not None
    k = np.asarray(network.coefficients_from(robot.links))
    fit = SOLVER.fit(network, patterns_of_one(network, k))
    bodies = jc.physical_parameters(network, fit, fixed=robot.source.carried)
    assert bodies.body_names == ("upper",)
    (body,) = bodies.bodies
    axes = rotation_of(0.1, 0.2, 0.3)
    tensor = np.array([[0.1, 0.01, 0], [0.01, 0.2, 0], [0, 0, 0.15]])
    assert float(body.mass) == pytest.approx(2.0, rel=_SOLVER)
    np.testing.assert_allclose(body.centre_of_gravity, [0.1, 0.02, 0.03], atol=_SOLVER)
    np.testing.assert_allclose(body.inertia, axes @ tensor @ axes.T, atol=_SOLVER)
    assert float(body.motor_inertia) < _SOLVER
    (again,) = in_file_frames(robot, bodies.links_without_fixed)
    np.testing.assert_allclose(again.inertia, body.inertia, atol=_ROUNDING)
    assert bodies.to_pandas().index.tolist() == ["upper"]


def patterns_of_one(network: jc.CSLC, k: Float[np.ndarray, " _"]) -> jc.Patterns:
    rng = np.random.default_rng(0)
    q, qd, qdd = rng.uniform(-2, 2, (3, 100, 1))
    every = np.ones(q.shape, bool)
    torque = np.asarray(network.torque(k, q, qd, qdd))
    return jc.Patterns(np.arange(100.0), q, qd, qdd, torque, every, every)


def rotation_of(roll: float, pitch: float, yaw: float) -> Float[np.ndarray, "3 3"]:
    """URDF's angles, as products of turns about x, y and z."""

    def turn(axis: int, angle: float) -> np.ndarray:
        a, b = (axis + 1) % 3, (axis + 2) % 3
        matrix = np.eye(3)
        matrix[a, a] = matrix[b, b] = np.cos(angle)
        matrix[a, b], matrix[b, a] = -np.sin(angle), np.sin(angle)
        return matrix

    return turn(2, yaw) @ turn(1, pitch) @ turn(0, roll)


def test_identify_reports_what_it_used(network: jc.CSLC, k: Float[np.ndarray, " _"]) -> None:
    t, w = np.arange(480) * 0.02, np.array([1.3, 2.1])
    angle = t[:, None] * w + [0.3, 1.1]
    motion = 0.2 * np.sin(angle), 0.2 * w * np.cos(angle), -0.2 * w**2 * np.sin(angle)
    noise = 0.3 * np.random.default_rng(0).normal(size=angle.shape)
    recording = jc.Recording(t, motion[0], np.asarray(network.torque(k, *motion)) + noise)
    always, never = (
        jc.identify(
            network,
            recording,
            settings=jc.Settings(),
            checks=False,
            systematic=False,
            possible=choice,
        )
        for choice in ("always", "never")
    )
    assert always.possible is not None and always.bodies is always.possible.parameters
    np.testing.assert_array_equal(np.asarray(always.k), always.possible.parameters.k)
    np.testing.assert_allclose(np.asarray(always.possible.free.k), np.asarray(never.k))
    assert always.errors["training"].names == ("fit", "unconstrained")
    assert "Used: physically consistent coefficients" in str(always)
    assert "physically consistent" not in str(never)
    assert never.possible is None and never.errors["training"].names == ("fit",)


def test_payloads_are_in_the_frame_of_the_files_body(tmp_path: Path, network: jc.CSLC) -> None:
    """The body's frame is turned about x and moved along it: a payload is seen from there."""
    (tmp_path / "arm.urdf").write_text("""<robot name="arm"><link name="floor"/>
  <link name="upper"/>
  <joint name="shoulder" type="continuous"><parent link="floor"/><child link="upper"/>
    <origin xyz="0.2 0 0.3" rpy="0.2 0 0.1"/><axis xyz="0.6 0 0.8"/></joint></robot>""")
    robot = jc.load_robot(tmp_path / "arm.urdf")
    assert robot.source is not None
    ball = jc.LinkParameters(2.0, np.array([0.05, 0.02, 0.1]), np.diag([0.01, 0.02, 0.03]))
    body = in_last_body_frame(robot, ball)
    assert body is not None
    pose = robot.source.placements[-1]
    back = pose[:3, :3] @ np.asarray(body.centre_of_gravity) + pose[:3, 3]
    np.testing.assert_allclose(back, ball.centre_of_gravity, atol=_ROUNDING)
    np.testing.assert_allclose(
        pose[:3, :3] @ np.asarray(body.inertia) @ pose[:3, :3].T, ball.inertia, atol=_ROUNDING
    )
    assert in_last_body_frame(network.robot, ball) is None
    assert in_last_body_frame(robot, None) is None
