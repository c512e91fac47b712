"""Fits of simulated to recorded positions over windows, across velocity reversals."""

import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.identification import fit_windows, motion_windows


def test_windows_end_where_a_joint_rests() -> None:
    velocity = np.ones((200, 2))
    velocity[50:53, 0] = [0.001, -0.001, 0.001]  # turns round, and back
    velocity[120:140, 1] = 0.0  # rests
    windows = motion_windows(velocity, length=60, slowest=0.005, trim=5)
    used = [rows[within] for rows, within in zip(windows.rows, windows.within, strict=True)]
    assert np.array_equal(np.concatenate(used), [*range(5, 120), *range(140, 195)])
    assert max(len(rows) for rows in used) <= 60


def test_windows_recover_a_pendulum_across_its_turns(rng: np.random.Generator) -> None:
    """Simulated with a step a hundred times finer; only positions are passed on."""
    robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    network = jc.derive(robot.with_friction("viscous", "dry", "static"), lengths="numeric")
    k, slope = np.array([0.5, 0.3, 0.0, 0.2, 0.3, 0.2]), 8.0
    time = np.arange(600) * 0.002
    demand = 2.5 * np.sin(9.0 * time) + 0.5 * np.sin(23.0 * time)
    state, steps = np.array([0.3, 0.0]), 100
    q, qd = np.zeros((2, 600, 1))
    for row in range(600):
        q[row], qd[row] = state
        for _ in range(steps):
            friction = k[3] * state[1] + np.sign(state[1]) * (
                k[4] + k[5] * np.exp(-slope * abs(state[1]))
            )
            weight = 9.81 * (k[1] * np.cos(state[0]) - k[2] * np.sin(state[0]))
            state[1] += 0.002 / steps * (demand[row] - friction - weight) / k[0]
            state[0] += 0.002 / steps * state[1]
    noise = 1e-6 * rng.normal(size=q.shape)
    recording = jc.Recording(time, q + noise, demand[:, None])
    windows = motion_windows(qd, length=60, slowest=0.005, trim=1)
    start = network.with_static_slopes([4.0])
    wrong = k * np.array([1.1, 0.9, 1.0, 1.1, 1.1, 0.5])
    fit = fit_windows(start, wrong, recording, windows, (q, qd))
    assert np.allclose(fit.slopes, slope, rtol=0.05)
    assert np.allclose(fit.k, k, rtol=0.03, atol=5e-3)


def test_other_friction_is_refused() -> None:
    robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)]).with_friction("viscous", "dry")
    network = jc.derive(robot, lengths="numeric")
    windows = motion_windows(np.ones((50, 1)), length=20, slowest=0.1, trim=2)
    recording = jc.Recording(np.arange(50) * 0.002, np.zeros((50, 1)), np.zeros((50, 1)))
    with pytest.raises(ValueError, match="expected viscous, dry and static friction"):
        fit_windows(
            network,
            np.zeros(network.size),
            recording,
            windows,
            (np.zeros((50, 1)), np.zeros((50, 1))),
        )
