"""Joints at rest, by what their encoders can tell, whatever the clock."""

import numpy as np
import pytest
from jaxtyping import Float
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.recordings import at_rest, directions_beside, without_motion_at_rest
from jaxcslc.report import predicted_torque
from tests import arms


STEP = 1e-4  # rad
CLOCKS = (100.0, 250.0, 1000.0, 4000.0)  # Hz
# At both ends of a rest: as long as the slowest motion that counts needs to leave a step.
ENDS = 0.2  # s


def motion(time: np.ndarray) -> tuple[np.ndarray, ...]:
    """Four moves of 1 s, with rests of 1 s: on, on, back, on. Positions and two derivatives."""
    move, within = np.divmod(time, 2.0)
    phase = np.clip(within, 0.0, 1.0)
    direction = np.array([1.0, 1.0, -1.0, 1.0])[np.minimum(move.astype(int), 3)]
    start = np.array([0.0, 1.0, 2.0, 1.0])[np.minimum(move.astype(int), 3)]
    moves = within < 1.0
    q = start + direction * (phase - np.sin(2 * np.pi * phase) / (2 * np.pi))
    qd = np.where(moves, direction * (1.0 - np.cos(2 * np.pi * phase)), 0.0)
    return q, qd, np.where(moves, direction * 2 * np.pi * np.sin(2 * np.pi * phase), 0.0)


def rests(time: np.ndarray) -> np.ndarray:
    """The middles of the rests."""
    within = np.mod(time, 2.0)
    return (within > 1.0 + ENDS) & (within < 2.0 - ENDS)


def quantised(q: np.ndarray, rng: np.random.Generator) -> Float[np.ndarray, "samples 1"]:
    """Counts of an encoder, which flicker between two of them."""
    return STEP * np.round(q / STEP + rng.normal(scale=0.15, size=q.shape))[:, None]


def recorded(clock: float, rng: np.random.Generator) -> jc.Recording:
    """A turntable's motion and torque; at rest it is held by what friction there is."""
    time = np.arange(int(8.0 * clock)) / clock
    q, qd, qdd = motion(time)
    torque = np.asarray(arms.turntable().torque(np.array(K), *(x[:, None] for x in (q, qd, qdd))))
    noise = 0.02 * np.sqrt(clock / 1000.0) * rng.normal(size=torque.shape)
    return jc.Recording(time, quantised(q, rng), torque + noise)


SMOOTHING = jc.Butterworth(20.0)
K = [0.5, 2.0, 1.0]  # inertia, viscous and dry friction


class TestRest:
    @pytest.mark.parametrize("clock", CLOCKS)
    def test_it_does_not_depend_on_the_clock(self, clock: float, rng: np.random.Generator) -> None:
        recording = recorded(clock, rng)
        time, position = recording.time, recording.position
        _, qd, _ = SMOOTHING.smooth(time, position)
        stopped = without_motion_at_rest(time, position, qd)
        still = np.asarray(at_rest(stopped))[:, 0]
        assert np.all(still[rests(time)])
        fast = np.abs(motion(time)[1]) > 0.02
        assert not np.any(still[fast])
        assert_allclose(stopped[fast], qd[fast])

    @pytest.mark.parametrize("clock", CLOCKS)
    def test_directions_are_those_of_moves(self, clock: float, rng: np.random.Generator) -> None:
        recording = recorded(clock, rng)
        patterns = jc.Preparation(SMOOTHING).patterns(recording)
        qd, time = np.asarray(patterns.qd), np.asarray(patterns.time)
        middle = rests(time)
        before, after = (x[middle, 0] for x in directions_beside(qd, np.asarray(at_rest(qd))))
        number = (time[middle] // 2.0).astype(int)
        assert_allclose(before, np.array([1.0, 1.0, -1.0, 1.0])[number])
        assert_allclose(after, np.array([1.0, -1.0, 1.0, 0.0])[number])

    def test_coefficients_and_torques_at_rest(self, rng: np.random.Generator) -> None:
        """Coulomb friction is that of moves, and at rest the mean of those on either side."""
        network = arms.turntable()
        for clock in CLOCKS:
            recording = recorded(clock, rng)
            settings = jc.Settings(jc.Preparation(SMOOTHING))
            patterns = settings.patterns(recording)
            fit = settings.fit(network, patterns)
            assert_allclose(fit.k, K, rtol=0.03)
            time = np.asarray(patterns.time)
            middle = rests(time)
            torque = np.asarray(predicted_torque(network, patterns, np.array(K)))[middle, 0]
            number = (time[middle] // 2.0).astype(int)
            assert_allclose(torque, np.array([1.0, 0.0, 0.0, 0.5])[number], atol=0.05)

    def test_a_joint_that_only_flickers(self, rng: np.random.Generator) -> None:
        """Its columns are zero: nothing in the recording tells its friction."""
        network = arms.planar_arm("viscous", "dry")
        time = np.arange(2000) / 1000.0
        q = np.stack([np.sin(3.0 * time), np.full(2000, 0.4)], axis=1)
        position = np.concatenate([quantised(column, rng) for column in q.T], axis=1)
        recording = jc.Recording(time, position, rng.normal(size=position.shape))
        patterns = jc.Preparation(SMOOTHING).patterns(recording)
        assert not np.any(patterns.qd[:, 1]) and not np.any(patterns.mask[:, 1])
        fit = jc.LeastSquares().fit(network, patterns)
        friction = [network.names.index(name) for name in ("kv2", "kd2")]
        assert not np.any(np.asarray(fit.determined)[friction])

    def test_noise_without_steps(self, rng: np.random.Generator) -> None:
        time = np.arange(8000) / 1000.0
        q, qd, _ = motion(time)
        position = (q + 3e-5 * rng.normal(size=q.shape))[:, None]
        noisy = qd[:, None] + 0.01 * rng.normal(size=position.shape)
        still = without_motion_at_rest(time, position, noisy)[:, 0] == 0.0
        assert np.mean(still[rests(time)]) > 0.95
        assert not np.any(still[np.abs(qd) > 0.02])

    def test_exact_motion_is_left_as_it_is(self) -> None:
        time = np.arange(1000) / 100.0
        q, qd = np.sin(time)[:, None], np.cos(time)[:, None]
        assert np.array_equal(without_motion_at_rest(time, q, qd), qd)
