"""Maximum likelihood of joints that yield before they slide: states, fits to simulated motion."""

import numpy as np
import pytest
import scipy
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.friction import fit_pre_sliding
from jaxcslc.likelihood import EquationPoint, MotionEquations, PreSlidingEquations
from jaxcslc.likelihood._pre_sliding_equations import mean_states
from tests import arms


INTERVAL, SAMPLES, COUNT, NOISE = 0.005, 1600, 1e-4, 0.02
TRUE = {"kB1": 0.4, "kB2": 3.0 / 9.81, "kB3": 0.0, "kv1": 0.3, "kd1": 0.8}
LENGTHS = (0.03, 0.002)


def swing(length: float, seed: int) -> jc.Recording:
    """A pendulum around rest under held torques, integrated by SciPy; counts and torque noise."""
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0.0, 2.0 * np.pi, 3)
    time = INTERVAL * np.arange(SAMPLES)
    size, rate = np.array([1.3, 1.0, 0.6]), np.array([1.7, 5.1, 11.0])
    torque = 3.0 + np.sum(size * np.sin(rate * time[:, None] + phase), axis=1)
    state, rows = np.zeros(3), []
    for held in torque:
        rows.append(state[0])

        def rates(t: float, x: np.ndarray, held: float = held) -> list[float]:
            q, qd, w = x
            net = held - 3.0 * np.cos(q) - TRUE["kv1"] * qd - TRUE["kd1"] * w
            return [qd, net / TRUE["kB1"], (qd - abs(qd) * w) / length]

        solution = scipy.integrate.solve_ivp(rates, (0.0, INTERVAL), state, rtol=1e-7, atol=1e-9)
        state = solution.y[:, -1]
    counts = COUNT * np.round(np.array(rows) / COUNT)
    noisy = torque + NOISE * rng.normal(size=SAMPLES)
    return jc.Recording(time, counts[:, None], noisy[:, None])


@pytest.fixture(scope="module", params=LENGTHS)
def recording(request: pytest.FixtureRequest) -> tuple[float, jc.Recording]:
    return request.param, swing(request.param, 5)


class TestStates:
    """What equations have for friction: means over two intervals of a state along the motion."""

    @pytest.mark.parametrize("length", LENGTHS)
    def test_means_are_those_of_the_differential_equation(self, length: float) -> None:
        """By small explicit steps, at uneven samples, reversals between them included."""
        time = np.cumsum(np.r_[0.0, np.tile([0.004, 0.006], 150)])
        fine = np.linspace(0.0, time[-1], 400_000 + 1)

        def position(t: np.ndarray) -> np.ndarray:
            return 0.1 * np.sin(4.0 * t) + 0.02 * np.sin(13.0 * t)

        w, states = 0.0, [0.0]
        for change in np.diff(position(fine)):
            w += (change - abs(change) * w) / length
            states.append(w)
        expected = []
        for before, at, after in zip(time, time[1:], time[2:], strict=False):
            inside = (fine > before) & (fine < after)
            t = fine[inside]
            weight = np.where(t < at, (t - before) / (at - before), (after - t) / (after - at))
            expected.append(np.sum(weight * np.array(states)[inside]) / np.sum(weight))
        state, _ = mean_states(position(time)[:, None], time, np.array([length]))
        # At speeds of 0.6 rad/s an interval is 1.8 of the shorter length.
        assert_allclose(state[:, 0], expected, atol=4e-3)

    def test_the_first_state_is_forgotten_along_the_path(self) -> None:
        """By e in a length; after five of them it is of no account."""
        time = 0.01 * np.arange(101)
        q = 0.1 * time[:, None] * np.array([[1.0, -1.0]])
        _, unknown = mean_states(q, time, np.array([0.01, 0.0]))
        moved = 0.1 * time[1:-1]
        expected = np.where(moved < 0.04, np.exp(-moved / 0.01), 0.0)
        clear = np.abs(moved - 0.01 * np.log(100.0)) > 2e-3
        assert_allclose(unknown[clear, 0], np.where(clear, expected, 0.0)[clear], atol=0.02)
        assert np.all(unknown[:, 1] == 0.0)

    def test_equations_have_the_state_in_place_of_the_sign(self) -> None:
        """Torque and the column of dry friction; other columns, and joints without, as before."""
        robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0), (0, 0.5, 0, 0)])
        network = jc.derive(robot.with_friction("viscous", "dry"), lengths="numeric")
        time = 0.01 * np.arange(40)
        q = np.stack([0.2 * np.sin(5.0 * time), 0.3 * np.sin(3.0 * time)], axis=1)
        base, distance = MotionEquations(network, np.diff(time)), np.array([0.05, 0.0])
        part = np.zeros(40, int)
        equations = PreSlidingEquations.of(base, distance, q, time, part)
        k = np.arange(1.0, network.size + 1.0)
        signs = np.sign(np.diff(q, axis=0)[1:])
        motion = np.zeros(2), q, -np.ones(signs.shape), signs
        at = EquationPoint(k, *motion)
        torque, plain = equations.torque(at), base.torque(at)
        index = network.names.index("kd1")
        step = base.linearised(at).by_coefficient.dense[:, 0, index]
        state, _ = mean_states(q, time, distance)
        assert_allclose(torque[:, 0], plain[:, 0] + k[index] * (state[:, 0] - step), atol=1e-12)
        assert_allclose(torque[:, 1], plain[:, 1], atol=1e-12)
        derivatives = equations.linearised(at)
        assert_allclose(derivatives.torque, torque, atol=1e-12)
        columns = base.linearised(at).by_coefficient.dense
        columns[:, 0, index] = state[:, 0]
        assert_allclose(derivatives.by_coefficient.dense, columns, atol=1e-12)

    def test_recordings_begin_anew(self) -> None:
        network = arms.pendulum("dry")
        time = 0.01 * np.arange(60)
        q = 0.2 * np.sin(5.0 * time)[:, None]
        twice = np.concatenate([time, 1.0 + time])
        base, part = MotionEquations(network, np.diff(twice)), np.repeat([0, 1], 60)
        equations = PreSlidingEquations.of(
            base, np.array([0.05]), np.concatenate([q, q]), twice, part
        )
        assert_allclose(equations.state[:58], equations.state[60:], atol=1e-15)


class TestFits:
    def test_they_are_nearer_than_regression_and_than_without_states(
        self, recording: tuple[float, jc.Recording]
    ) -> None:
        """With distances of the regression, as with the true ones; intervals hold the truth."""
        length, motion = recording
        network = arms.pendulum("viscous", "dry")
        true = np.array([TRUE[name] for name in network.names])
        settings = jc.Settings(jc.Preparation(jc.Butterworth(20.0), threshold_fraction=0.0))
        regression = fit_pre_sliding(network, settings.patterns(motion))
        fits = [
            jc.MaximumLikelihood(presliding_distance=distance, every=1).fit(network, motion)
            for distance in ((length,), tuple(regression.presliding_distance.tolist()), ())
        ]
        assert all(fit.converged for fit in fits)
        dry, inertia = network.names.index("kd1"), network.names.index("kB1")
        exact, identified, without = (np.abs(np.asarray(fit.k) - true) for fit in fits)
        smoothed = np.abs(np.asarray(regression.fit.k) - true)
        size = np.array([0.4, 0.3, 0.3, 0.3, 0.8])
        # With the greater distance, 1,600 samples leave the Coulomb friction of both as uncertain.
        nearer = 0.7 if length < 0.03 else 1.0
        for error in (exact, identified):
            assert np.linalg.norm(error / size) < nearer * np.linalg.norm(smoothed / size)
            assert np.linalg.norm(error / size) < 0.1 * np.linalg.norm(without / size)
        assert exact[dry] < 0.005 and exact[inertia] < 5e-4
        assert np.all(exact < 3.5 * np.asarray(fits[0].fit.standard_error))
        # Beside counts of intervals that hold it, the level is a little too large.
        assert_allclose(fits[0].torque_noise, NOISE, rtol=0.25)
        assert fits[0].presliding_distance.tolist() == [length] and fits[
            2
        ].presliding_distance.tolist() == [0.0]

    def test_a_step_of_friction_has_no_length(self) -> None:
        """Nothing changes where no joint has one."""
        network, motion = arms.pendulum("viscous", "dry"), swing(0.002, 6)
        fits = [
            jc.MaximumLikelihood(presliding_distance=distance, every=1).fit(network, motion)
            for distance in ((), (0.0,))
        ]
        assert np.array_equal(np.asarray(fits[0].k), np.asarray(fits[1].k))


@pytest.mark.parametrize("distance", [(0.1, 0.1), (-0.1,), (np.inf,)])
def test_distances_of_no_contact(distance: tuple[float, ...]) -> None:
    network, time = arms.pendulum("dry"), 0.01 * np.arange(40)
    motion = jc.Recording(time, np.sin(time)[:, None], np.cos(time)[:, None])
    with pytest.raises(
        ValueError, match="presliding_distance: expected 1 finite numbers from 0 up"
    ):
        jc.MaximumLikelihood(presliding_distance=distance).fit(network, motion)


def test_joints_without_dry_friction() -> None:
    network, time = arms.pendulum("viscous"), 0.01 * np.arange(40)
    motion = jc.Recording(time, np.sin(time)[:, None], np.cos(time)[:, None])
    with pytest.raises(ValueError, match="has no friction of kind 'dry'"):
        jc.MaximumLikelihood(presliding_distance=(0.1,)).fit(network, motion)
