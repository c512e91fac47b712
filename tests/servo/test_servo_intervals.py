"""Covariance of servo drives, against fits without each block of a recording."""

import numpy as np
import pytest

from jaxcslc.servo._drive import DRIVE_UNITS
from jaxcslc.servo._intervals import Stack
from jaxcslc.servo._search import JointMotion, JointProblem
from jaxcslc.servo._simulation import JointLoads


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
