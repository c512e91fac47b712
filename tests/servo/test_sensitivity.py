"""Derivatives of simulated positions, against differences of simulations of the whole arm."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from jaxcslc.manipulator import LinkParameters
from jaxcslc.servo import ServoDrive, ServoRecording, simulate
from jaxcslc.servo._fit import _Search, known_rows, scaled
from jaxcslc.servo._identifiability import ConfoundedParameters
from jaxcslc.servo._intervals import Stack
from jaxcslc.servo._search import UNKNOWNS, JointProblem
from jaxcslc.servo._sensitivity import lengths_of_steps
from jaxcslc.servo._simulation import with_payload
from tests.servo.arms import arm, held_sines


TIME = np.arange(0.0, 8.0, 0.02)
DRIVE = ServoDrive(12.0, 0.9, delay=0.03, armature=0.01, coulomb=0.02, load_friction=0.3)
NAMES = ("gain", "damping", "delay", "offset", "armature", "coulomb")


def test_derivatives_are_those_of_the_whole_arm(tmp_path: Path) -> None:
    """Of every joint with respect to every joint's unknowns, and to the masses' scale."""
    robot = arm(tmp_path)
    command = held_sines(TIME, 3)
    payload = LinkParameters(0.1, np.array([0.1, 0.0, 0.0]), 1e-5 * np.eye(3))
    drives = [dataclasses.replace(DRIVE, offset=x) for x in (0.05, -0.1, 0.1)]
    position = simulate(robot, drives, TIME, command, command[0])
    recording = ServoRecording(TIME, position, command)
    search = _Search(robot, [recording], [payload], known_rows(robot, [recording], {}), NAMES)
    search.alone(0.2)
    simulated = search._simulated(search.unknowns, search.masses)
    search._take_motions(simulated)
    got = search.sensitivities()

    def moved(i: int, k: int, step: float) -> np.ndarray:
        unknowns = [x.copy() for x in search.unknowns]
        unknowns[i][k] += step
        return search._simulated(unknowns, search.masses)[0]

    at = 0
    for i, (problem, x) in enumerate(zip(search.problems, search.unknowns, strict=True)):
        for k, unknown in enumerate(problem.unknowns):
            step = 0.5 * unknown.step
            want = (moved(i, k, step) - moved(i, k, -step)) / (2.0 * step)
            for j in range(3):
                error = np.sqrt(np.mean((got[j][:, at + k] - want[:, j]) ** 2))
                assert error < 0.1 * np.sqrt(np.mean(want**2)), (j, i, problem.names[k])
        at += len(x)
    up, down = (
        search._simulated(search.unknowns, search.masses * math.exp(x))[0] for x in (0.02, -0.02)
    )
    want = (up - down) / 0.04
    for j in range(3):
        error = np.sqrt(np.mean((got[j][:, -1] - want[:, j]) ** 2))
        assert error < 0.1 * np.sqrt(np.mean(want**2))


def test_steps_move_a_joint_by_2_mrad() -> None:
    """But by no less than the table's steps, and within the prior's deviations."""
    problem = JointProblem(("offset", "delay", "armature"), np.zeros(19), (), 1.0, 0.001)
    signs = np.tile([1.0, -1.0], 50)[:, None]
    J = signs * np.array([0.05, 0.5, 0.01, 70.0, 70.0, 70.0])
    first, second = lengths_of_steps([problem, problem], [J, J])
    np.testing.assert_allclose(first, [0.002 / 0.05, 0.002 / 0.5, UNKNOWNS["armature"].deviation])
    np.testing.assert_allclose(second, problem.steps)


def test_confounded_parameters_have_their_covariance_on_top() -> None:
    """In the place of the pair's unknowns; a parameter that is known has none."""
    problem = JointProblem(("gain", "delay", "damping"), np.zeros(19), (), 1.0, 0.001)
    stack = Stack(np.zeros(7), np.eye(7), np.eye(7), 9, False)
    pair = ConfoundedParameters(1, ("damping", "lead"), "", "")
    wider = stack.with_confounded([problem] * 2, pair, np.array([[4.0, -3.0], [-3.0, 5.0]]))
    np.testing.assert_array_equal(np.diag(wider.covariance), [1, 1, 1, 1, 1, 5, 1])
    both = ConfoundedParameters(1, ("delay", "damping"), "", "")
    wider = stack.with_confounded([problem] * 2, both, np.array([[4.0, -3.0], [-3.0, 5.0]]))
    want = np.eye(7)
    want[4:6, 4:6] += [[4.0, -3.0], [-3.0, 5.0]]
    np.testing.assert_array_equal(wider.covariance, want)


def test_zero_positions_and_masses_are_found_together(tmp_path: Path) -> None:
    """Gravity turns a joint by the zero positions of all joints before it."""
    robot = arm(tmp_path)
    command = held_sines(TIME, 3) + 0.08 * np.sin(9.0 * TIME)[:, None]
    offsets = np.array([0.1, -0.15, 0.12])
    drives = [dataclasses.replace(DRIVE, load_friction=0.1, offset=float(x)) for x in offsets]
    payload = LinkParameters(0.3, np.array([0.1, 0.0, 0.0]), 1e-5 * np.eye(3))
    recordings = [
        ServoRecording(
            TIME,
            simulate(with_payload(robot, body), drives, TIME, command, command[0]),
            command,
        )
        for body in (None, payload)
    ]
    heavy = scaled(robot, 1.2)
    base = known_rows(heavy, recordings, {})
    search = _Search(heavy, recordings, [None, payload], base, NAMES)
    search.alone(0.2)
    np.testing.assert_allclose(search.offsets, offsets, atol=0.04)  # 0.15 without
    assert search.masses * 1.2 == pytest.approx(1.0, rel=0.05)
