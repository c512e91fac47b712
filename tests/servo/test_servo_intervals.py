"""Covariance of servo drives, against fits without each block of a recording."""

import numpy as np
import pytest

from jaxcslc.servo import ServoDrive
from jaxcslc.servo._drive import DRIVE_UNITS
from jaxcslc.servo._identifiability import EXCHANGED, confounded
from jaxcslc.servo._intervals import Stack
from jaxcslc.servo._search import JointMotion, JointProblem
from jaxcslc.servo._simulation import JointLoads, drive_rows, simulate_joint


NAMES = ("delay", "coulomb", "armature")
BLOCK = 100  # samples: two seconds at 50 Hz
BLOCKS = 12


def test_covariance_is_the_scatter_of_fits_without_each_block(rng: np.random.Generator) -> None:
    samples = BLOCKS * BLOCK
    time = 0.02 * np.arange(samples)
    zero = np.zeros(samples)
    loads = JointLoads(np.zeros((samples, 4)), zero)
    known = np.zeros(len(DRIVE_UNITS))
    known[list(DRIVE_UNITS).index("encoder_step")] = 10.0  # residuals are rounding
    motion = JointMotion(time, zero, zero, np.zeros(2), loads)
    problem = JointProblem(NAMES, known, (motion,), 40.0, 0.01)
    A = rng.normal(size=(samples, len(NAMES))) * [1.0, 3.0, 20.0]
    y = rng.normal(size=samples) + np.repeat(rng.normal(size=BLOCKS), BLOCK)
    prior = np.diag(1.0 / problem.deviations)

    def fitted(rows: np.ndarray) -> np.ndarray:
        root = np.sqrt(problem.weight)
        stacked = np.vstack([root * A[rows], prior])
        return np.linalg.lstsq(stacked, np.append(root * y[rows], np.zeros(len(NAMES))))[0]

    everything = np.arange(samples)
    best = fitted(everything)
    moves = np.array(
        [fitted(everything[everything // BLOCK != block]) - best for block in range(BLOCKS)]
    )
    inverse = np.linalg.inv(problem.weight * A.T @ A + prior**2)
    want = (1.0 - 1.0 / BLOCKS) * moves.T @ moves + inverse @ prior**2 @ inverse
    J = np.column_stack([A, zero])  # nothing of the masses' scale
    got = Stack.of([problem], [best], [A @ best - y], [J], 1.0, 0.2, False).covariance
    assert got[:-1, :-1] == pytest.approx(want, rel=1e-9)


TICK = 2.0 * np.pi / 4096


@pytest.mark.parametrize("gravity", [0.0, 0.6])
@pytest.mark.parametrize("phase", [0.0, 1.0])
def test_a_dead_zone_and_friction_are_told_apart_by_load_alone(
    gravity: float, phase: float
) -> None:
    """Play makes positions rough: that tells them apart in derivatives, and not in truth."""
    time = np.arange(0.0, 30.0, 0.02)
    command = 0.6 * np.sin(0.7 * time + phase) + 0.25 * np.sin(1.6 * time)
    command += np.where(time > 12.0, 0.08 * np.sin(7.0 * time), 0.0)
    drive = ServoDrive(
        *(12.0, 0.8),
        **{"delay": 0.03, "armature": 0.015, "coulomb": 0.06, "static": 0.03, "stribeck": 0.1},
        **{"dead_zone": 1.5 * TICK, "play": 0.0175},
    )
    torque = gravity * np.eye(4)[[1] * time.size]
    loads, row = JointLoads(torque, np.full(time.size, 0.004)), drive_rows([drive])
    start = np.array([command[0], 0.0])
    position = TICK * np.round(simulate_joint(loads, row, time, command, start)[0] / TICK)
    motion = JointMotion(time, command, position, np.array([position[0], 0.0]), loads)
    names = ("gain", "damping", "delay", "armature", "coulomb", "static", "dead_zone", "play")
    problem = JointProblem(names, row[0], (motion,), 1.2 / TICK**2, 0.00125)
    x = problem.unknowns_of(row[0])
    found = {pair.parameters: covariance for pair, covariance in confounded(0, problem, x, 1.0)}
    assert (EXCHANGED in found) == (gravity == 0.0)
    if EXCHANGED in found:  # its errors reach to where either is zero
        sizes = np.array([drive.dead_zone, drive.coulomb / drive.gain])
        assert np.all(2.0 * np.sqrt(np.diag(found[EXCHANGED])) > sizes)
