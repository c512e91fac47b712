"""Fits of simulated to recorded positions over windows, across velocity reversals."""

import numpy as np
import pytest

import jaxcslc as jc
from scripts.studies.static_friction.windows import fit_windows, motion_windows
from tests import arms


def test_windows_end_where_a_joint_rests() -> None:
    velocity = np.ones((200, 2))
    velocity[50:53, 0] = [0.001, -0.001, 0.001]  # turns round, and back
    velocity[120:140, 1] = 0.0  # rests
    windows = motion_windows(velocity, length=60, slowest=0.005, trim=5)
    used = [rows[within] for rows, within in zip(windows.rows, windows.within, strict=True)]
    assert np.array_equal(np.concatenate(used), [*range(5, 120), *range(140, 195)])
    assert max(len(rows) for rows in used) <= 60


SLOPE, TIME = 8.0, np.arange(600) * 0.002
K = np.array([0.5, 0.3, 0.0, 0.2, 0.3, 0.2])


def pendulum(rng: np.random.Generator, samples: int) -> tuple[jc.CSLC, jc.Recording, np.ndarray]:
    """Simulated with a step a hundred times finer; only positions are passed on."""
    network = arms.pendulum("viscous", "dry", "static")
    time = TIME[:samples]
    demand = 2.5 * np.sin(9.0 * time) + 0.5 * np.sin(23.0 * time)
    state, steps = np.array([0.3, 0.0]), 100
    motion = np.zeros((2, samples, 1))
    for row in range(samples):
        motion[0, row], motion[1, row] = state
        for _ in range(steps):
            friction = K[3] * state[1] + np.sign(state[1]) * (
                K[4] + K[5] * np.exp(-SLOPE * abs(state[1]))
            )
            weight = 9.81 * (K[1] * np.cos(state[0]) - K[2] * np.sin(state[0]))
            state[1] += 0.002 / steps * (demand[row] - friction - weight) / K[0]
            state[0] += 0.002 / steps * state[1]
    noise = 1e-6 * rng.normal(size=motion[0].shape)
    return network, jc.Recording(time, motion[0] + noise, demand[:, None]), motion


def test_windows_recover_a_pendulum_across_its_turns(rng: np.random.Generator) -> None:
    network, recording, (q, qd) = pendulum(rng, len(TIME))
    windows = motion_windows(qd, length=60, slowest=0.005, trim=1)
    start = network.with_static_slopes([4.0])
    wrong = K * np.array([1.1, 0.9, 1.0, 1.1, 1.1, 0.5])
    fit = fit_windows(start, wrong, recording, windows, (q, qd))
    assert fit.converged
    assert np.allclose(fit.slopes, SLOPE, rtol=0.05)
    assert np.allclose(fit.k, K, rtol=0.03, atol=5e-3)


def test_a_fit_that_ends_early_says_so(rng: np.random.Generator) -> None:
    network, recording, (q, qd) = pendulum(rng, 200)
    windows = motion_windows(qd, length=60, slowest=0.005, trim=1)
    start = network.with_static_slopes([4.0])
    fit = fit_windows(start, 1.1 * K, recording, windows, (q, qd), rounds=1)
    assert not fit.converged


def test_what_the_motion_does_not_determine_has_no_finite_error(rng: np.random.Generator) -> None:
    """Static friction with this slope is gone at any speed that was recorded."""
    network, recording, (q, qd) = pendulum(rng, 200)
    windows = motion_windows(qd, length=60, slowest=0.005, trim=1)
    start = network.with_static_slopes([1e300])
    fit = fit_windows(start, K, recording, windows, (q, qd))
    static = network.names.index("ks1")
    assert not fit.converged
    assert np.isinf(fit.error[static]) and np.isinf(fit.slope_error[0])
    others = np.delete(fit.error, static)
    assert np.all(np.isfinite(others)) and np.all(others > 0.0)


def test_other_friction_is_refused() -> None:
    network = arms.turntable("viscous", "dry")
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
