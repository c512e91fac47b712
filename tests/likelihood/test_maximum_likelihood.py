"""Positions and coefficients estimated together: against motion integrated by other means."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.least_squares import Errors
from tests import arms


STEP, SUBSTEPS = 0.005, 50
# B = I + m l², G = m g l, viscous, dry friction, static friction beyond dry.
INERTIA, WEIGHT, VISCOUS, DRY, STATIC, SLOPE = 0.4, 3.0, 0.3, 0.8, 0.3, 8.0


def swing(samples: int, static: float = STATIC) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, position and the held torque of a pendulum, integrated with short steps."""
    time = STEP * np.arange(samples)
    q, qd, positions, torques = 0.0, 0.0, [], []
    for t in time:
        positions.append(q)
        torque = WEIGHT * np.cos(q) + 4.0 * np.sin(3.1 * t) + 3.0 * np.sin(7.3 * t + 1.0)
        torques.append(torque)
        h = STEP / SUBSTEPS
        for _ in range(SUBSTEPS):
            drive = torque - WEIGHT * np.cos(q) - VISCOUS * qd
            level = DRY + static * np.exp(-SLOPE * abs(qd))
            if abs(qd) < 1e-12 and abs(drive) <= level:
                continue
            sign = np.sign(qd) if abs(qd) >= 1e-12 else np.sign(drive)
            after = qd + h * (drive - sign * level) / INERTIA
            if qd * after < 0.0:  # comes to rest within the step
                after = 0.0
            q, qd = q + 0.5 * h * (qd + after), after
    return time, np.array(positions)[:, None], np.array(torques)[:, None]


TRUE = {"kB1": INERTIA, "kv1": VISCOUS, "kd1": DRY, "ks1": STATIC}


def test_exact_positions_give_exact_coefficients() -> None:
    network = arms.pendulum("viscous")
    t = 0.01 * np.arange(400)[:, None]
    q, qd, qdd = np.sin(2 * t), 2 * np.cos(2 * t), -4 * np.sin(2 * t)
    k = np.array([0.5, 0.3, -0.1, 0.2])
    # The torque whose mean over both intervals belongs to the second difference of positions.
    second = np.diff(q, 2, axis=0) / 0.01**2
    first = (q[2:] - q[:-2]) / 0.02
    wanted = np.asarray(network.torque(k, q[1:-1], first, second))
    demand = np.zeros_like(q)
    demand[0] = float(np.asarray(network.torque(k, q[:1], qd[:1], qdd[:1]))[0, 0])
    for row in range(len(wanted)):
        demand[row + 1] = 2.0 * wanted[row] - demand[row]
    result = jc.MaximumLikelihood().fit(network, jc.Recording(t[:, 0], q, demand))
    assert result.converged
    assert_allclose(result.k, k, rtol=1e-6)


@pytest.fixture(scope="module")
def clean() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return swing(1200)


def deviations(result: jc.LikelihoodFit) -> dict[str, float]:
    """Errors over standard errors."""
    value = dict(zip(result.fit.names, np.asarray(result.k), strict=True))
    error = dict(zip(result.fit.names, np.asarray(result.fit.standard_error), strict=True))
    return {name: (value[name] - true) / error[name] for name, true in TRUE.items()}


def test_errors_of_encoders_are_those_it_states(
    clean: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    time, position, torque = clean
    network = arms.pendulum("viscous", "dry", "static")
    all_deviations = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        step = 2e-4
        counts = step * np.round(position / step + rng.uniform(-0.5, 0.5))
        recording = jc.Recording(time, counts, torque)
        result = jc.MaximumLikelihood(errors="independent").fit(network, recording)
        all_deviations.append(list(deviations(result).values()))
        assert_allclose(result.position_noise, step / np.sqrt(12), rtol=1e-6)
        # The estimated motion is nearer to the true one than a count's standard deviation.
        assert np.std(result.position - position) < 0.5 * step / np.sqrt(12)
    spread = np.sqrt(np.mean(np.square(all_deviations)))
    assert 0.4 < spread < 1.6


def test_it_is_nearer_than_regression(clean: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    time, position, torque = clean
    step = 2e-4
    recording = jc.Recording(time, step * np.round(position / step), torque)
    network = arms.pendulum("viscous", "dry")
    settings = jc.Settings().with_options(torque_alignment="mean")
    regression = settings.fit(network, settings.patterns(recording))
    likely = jc.MaximumLikelihood().fit(arms.pendulum("viscous", "dry", "static"), recording)

    def error(fit: jc.Identification) -> float:
        value = dict(zip(fit.names, np.asarray(fit.k), strict=True))
        return float(np.mean([abs(value[name] / TRUE[name] - 1) for name in ("kB1", "kv1")]))

    assert error(likely.fit) < 0.5 * error(regression)


def test_noise_levels_are_estimated(clean: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    time, position, torque = swing(1200, static=0.0)
    rng = np.random.default_rng(0)
    noisy = jc.Recording(
        time,
        position + 1e-4 * rng.normal(size=position.shape),
        torque + 0.2 * rng.normal(size=torque.shape),
    )
    result = jc.MaximumLikelihood(resolution=(0.0,)).fit(arms.pendulum("viscous", "dry"), noisy)
    # The means of two held torques that follow each other share one: slow noise of their equations
    # is that of single torques, and positions take up the quick noise.
    assert_allclose(result.torque_noise, 0.2, rtol=0.25)
    assert_allclose(result.position_noise, 1e-4, rtol=0.15)


def test_rounding_far_below_the_noise_is_no_encoder() -> None:
    time, position, torque = swing(1200, static=0.0)
    rng = np.random.default_rng(0)
    noisy = 1e-7 * np.round((position + 1e-4 * rng.normal(size=position.shape)) / 1e-7)
    network = arms.pendulum("viscous", "dry")
    result = jc.MaximumLikelihood().fit(network, jc.Recording(time, noisy, torque))
    assert_allclose(result.position_noise, 1e-4, rtol=0.15)
    assert_allclose(result.edge, 0.0)


class TestSeveralRecordings:
    def test_each_has_its_noise(self) -> None:
        time, position, torque = swing(1600, static=0.0)
        rng = np.random.default_rng(0)
        noises = ((1e-4, 0.05), (3e-4, 0.4))
        parts = [
            jc.Recording(
                time[rows],
                position[rows] + noise * rng.normal(size=(800, 1)),
                torque[rows] + level * rng.normal(size=(800, 1)),
            )
            for rows, (noise, level) in zip((slice(0, 800), slice(800, None)), noises, strict=True)
        ]
        result = jc.MaximumLikelihood(resolution=(0.0,)).fit(arms.pendulum("viscous", "dry"), parts)
        assert_allclose(result.torque_noise[:, 0], [0.05, 0.4], rtol=0.3)
        assert_allclose(result.position_noise[:, 0], [1e-4, 3e-4], rtol=0.2)
        assert result.position.shape == (1600, 1)

    def test_each_has_its_encoder_offset(
        self, clean: tuple[np.ndarray, np.ndarray, np.ndarray]
    ) -> None:
        time, position, torque = clean
        step = 5e-3
        parts = [
            jc.Recording(time, step * np.round(position / step + shift) - step * shift, torque)
            for shift in (-0.3, 0.4)
        ]
        shifted = [
            jc.Recording(part.time, part.position + shift, part.torque)
            for part, shift in zip(parts, (-1e-3, 1e-3), strict=True)
        ]
        result = jc.MaximumLikelihood().fit(arms.pendulum("viscous", "dry", "static"), shifted)
        assert_allclose(result.offset[:, 0], [-1e-3, 1e-3], atol=4 * result.offset_error.max())
        # The mean of both is gravity's to find; their difference is not that of gravity.
        assert np.ptp(result.offset) > 1e-3
        for deviation in deviations(result).values():
            assert abs(deviation) < 4.0

    def test_a_recording_in_two_is_the_recording(self) -> None:
        time, position, torque = swing(1200, static=0.0)
        rng = np.random.default_rng(0)
        position = position + 1e-4 * rng.normal(size=position.shape)
        torque = torque + 0.1 * rng.normal(size=torque.shape)
        network = arms.pendulum("viscous", "dry")
        parts = [
            jc.Recording(time[rows], position[rows], torque[rows])
            for rows in (slice(0, 700), slice(700, None))
        ]
        one = jc.MaximumLikelihood().fit(network, jc.Recording(time, position, torque))
        two = jc.MaximumLikelihood().fit(network, parts)
        error = np.asarray(one.fit.standard_error)
        assert np.all(np.abs(np.asarray(two.k - one.k)) < error)
        assert_allclose(two.fit.standard_error, error, rtol=0.3)


def test_errors_allow_for_noise_that_is_not_white() -> None:
    """Slow errors of torque, as a model that lacks something leaves them."""
    network = arms.pendulum("viscous", "dry")
    time, position, torque = swing(1200, static=0.0)
    spread: dict[Errors, list[float]] = {"independent": [], "correlated": []}
    for seed in range(8):
        rng = np.random.default_rng(seed)
        slow = np.zeros_like(torque)
        for row in range(1, len(slow)):
            slow[row] = 0.95 * slow[row - 1] + 0.1 * rng.normal()
        noisy = jc.Recording(time, position + 1e-5 * rng.normal(size=position.shape), torque + slow)
        for errors, squares in spread.items():
            result = jc.MaximumLikelihood(resolution=(0.0,), errors=errors).fit(network, noisy)
            if errors == "correlated":
                # The sandwich, with as many degrees of freedom as it has components.
                assert result.fit.degrees_of_freedom <= 32
            true = np.array([INERTIA, WEIGHT / 9.81, 0.0, VISCOUS, DRY])
            squares += (((result.k - true) / result.fit.standard_error) ** 2).tolist()
            assert_allclose(
                np.sqrt(np.diag(result.fit.independent_covariance)),
                result.fit.standard_error,
                rtol=1e-9 if errors == "independent" else 10.0,
            )
    assert np.sqrt(np.mean(spread["independent"])) > 2.5
    assert 0.6 < np.sqrt(np.mean(spread["correlated"])) < 1.7


def test_errors_of_white_noise_are_the_bound(
    clean: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    time, position, torque = clean
    step, ratios, degrees = 2e-4, [], []
    for seed in range(4):
        shift = np.random.default_rng(seed).uniform(-0.5, 0.5)
        counts = step * np.round(position / step + shift)
        network = arms.pendulum("viscous", "dry", "static")
        result = jc.MaximumLikelihood().fit(network, jc.Recording(time, counts, torque))
        bound = np.sqrt(np.diag(np.asarray(result.fit.independent_covariance)))
        ratios += (np.asarray(result.fit.standard_error) / bound).tolist()
        degrees.append(float(result.fit.degrees_of_freedom))
    assert np.min(ratios) > 1.0 - 1e-9
    # By chance, single ones are larger.
    assert np.mean(np.array(ratios) < 1.0 + 1e-9) > 0.7
    assert np.median(degrees) > 1000


def test_a_joint_that_never_moves_is_undetermined() -> None:
    network = arms.planar_arm("viscous", "dry")
    t = 0.01 * np.arange(300)[:, None]
    q = np.concatenate([np.sin(3 * t), np.full_like(t, 0.3)], axis=1)
    k = np.linspace(0.5, 1.0, network.size)
    qd = np.concatenate([3 * np.cos(3 * t), 0 * t], axis=1)
    qdd = np.concatenate([-9 * np.sin(3 * t), 0 * t], axis=1)
    recording = jc.Recording(t[:, 0], q, np.asarray(network.torque(k, q, qd, qdd)))
    result = jc.MaximumLikelihood(torque_sampling="sampled").fit(network, recording)
    determined = dict(zip(network.names, np.asarray(result.fit.determined), strict=True))
    assert not determined["kd2"]
    assert np.all(np.isfinite(np.asarray(result.k)))


def test_a_coarse_encoder() -> None:
    """500 counts a turn: the bound is wide, and holds."""
    time, position, torque = swing(1200, static=0.0)
    step = 2 * np.pi / 500
    recording = jc.Recording(time, step * np.round(position / step), torque)
    result = jc.MaximumLikelihood(errors="independent").fit(
        arms.pendulum("viscous", "dry"), recording
    )
    true = np.array([INERTIA, WEIGHT / 9.81, 0.0, VISCOUS, DRY])
    assert np.all(np.abs(np.asarray(result.k) - true) < 4.0 * np.asarray(result.fit.standard_error))
    assert_allclose(result.k[0], INERTIA, rtol=0.1)


def test_a_joint_that_is_long_at_its_limit() -> None:
    """There its torque is anything, and says nothing."""
    time, position, torque = swing(1200, static=0.0)
    turn = 500 + int(np.flatnonzero(np.diff(np.sign(np.diff(position[500:, 0]))))[0]) + 1
    stopped = np.where(np.arange(1200)[:, None] > turn, position[turn], position)
    pushed = np.where(np.arange(1200)[:, None] > turn, torque + 30.0, torque)
    network, estimator = arms.pendulum("viscous", "dry"), jc.MaximumLikelihood()
    result = estimator.fit(network, jc.Recording(time, stopped, pushed))
    alone = estimator.fit(network, jc.Recording(time[:turn], position[:turn], torque[:turn]))
    assert_allclose(result.k, alone.k, atol=0.05)


def test_long_rests() -> None:
    """Half of the recording at standstill: what is known is that of the motion."""
    _, position, torque = swing(900)
    still = 450
    turn = 300 + int(np.flatnonzero(np.diff(np.sign(np.diff(position[300:, 0]))))[0]) + 1
    step = 2e-4
    halted = np.concatenate([position[:turn], np.repeat(position[turn : turn + 1], still, axis=0)])
    demand = np.concatenate(
        [torque[:turn], np.full((still, 1), WEIGHT * np.cos(position[turn, 0]))]
    )
    counts = step * np.round(halted / step)
    recording = jc.Recording(STEP * np.arange(len(counts)), counts, demand)
    network = arms.pendulum("viscous", "dry", "static")
    result = jc.MaximumLikelihood(errors="independent").fit(network, recording)
    assert result.converged
    for deviation in deviations(result).values():
        assert abs(deviation) < 4.0


def test_twelve_joints() -> None:
    """A chain of sliders along one line: each drives all that follow."""
    n, masses = 12, np.linspace(2.0, 0.5, 12)
    robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)] * n, kinds="P" * n, gravity=(0, 0, 0))
    network = jc.derive(robot.with_friction("viscous"), lengths="numeric")
    rng = np.random.default_rng(0)
    t = 0.01 * np.arange(200)[:, None]
    rate, phase = rng.uniform(3.0, 9.0, n), rng.uniform(0.0, 6.0, n)
    q = 0.1 * np.sin(rate * t + phase)
    qd, qdd = 0.1 * rate * np.cos(rate * t + phase), -0.1 * rate**2 * np.sin(rate * t + phase)
    carried = np.cumsum(masses[::-1])[::-1]
    inertia = np.minimum.outer(carried, carried)
    torque = qdd @ inertia + 0.5 * qd
    result = jc.MaximumLikelihood(torque_sampling="sampled").fit(
        network, jc.Recording(t[:, 0], q + 1e-5 * rng.normal(size=q.shape), torque)
    )
    assert result.converged
    value = dict(zip(result.fit.names, np.asarray(result.k), strict=True))
    assert_allclose([value[f"kv{joint}"] for joint in range(1, n + 1)], 0.5, atol=0.02)


def test_ten_samples(clean: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    time, position, torque = clean
    network = arms.pendulum("viscous")
    short = jc.Recording(time[100:110], position[100:110], torque[100:110])
    settings = jc.Settings().with_options(smoothing=jc.recordings.CentralDifferences(), trim=0)
    result = jc.MaximumLikelihood(settings=settings).fit(network, short)
    assert np.all(np.isfinite(np.asarray(result.k)))


def test_a_fit_near_is_a_start(clean: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    """To what is before the end of a recording, in a few steps."""
    time, position, torque = clean
    step = 2e-4
    counts = step * np.round(position / step)
    network, estimator = arms.pendulum("viscous", "dry", "static"), jc.MaximumLikelihood()
    whole = estimator.fit(network, jc.Recording(time, counts, torque))
    first = jc.Recording(time[:900], counts[:900], torque[:900])
    alone = estimator.fit(network, first)
    near = estimator.fit(network, first, whole.at(np.arange(1200) < 900))
    assert alone.converged and near.converged
    assert near.steps <= alone.steps // 2
    assert_allclose(near.torque_noise, whole.torque_noise)
    error = np.asarray(alone.fit.standard_error)
    assert np.all(np.abs(np.asarray(near.k - alone.k)) < 0.5 * error)
    with pytest.raises(ValueError, match=r"positions are \(1200, 1\) of 1 .* expected \(900, 1\)"):
        estimator.fit(network, first, whole)


def test_static_friction_without_dry_friction(
    clean: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    """Nothing is then known of its size beforehand: it takes up what it can of dry friction."""
    time, position, torque = clean
    recording = jc.Recording(time, position, torque)
    result = jc.MaximumLikelihood().fit(arms.pendulum("viscous", "static"), recording)
    static = dict(zip(result.fit.names, np.asarray(result.k), strict=True))["ks1"]
    assert 0.5 * DRY < static < 2.0 * (DRY + STATIC)


class TestBadInput:
    def test_a_payload(self, clean: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
        network = arms.pendulum("viscous").with_payload()
        with pytest.raises(ValueError, match="has a payload; expected a network without one"):
            jc.MaximumLikelihood().fit(network, jc.Recording(*clean))

    def test_other_joints(self, clean: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
        time, position, torque = clean
        recording = jc.Recording(time, np.tile(position, 2), np.tile(torque, 2))
        with pytest.raises(ValueError, match="recording has 2 joints; expected 1"):
            jc.MaximumLikelihood().fit(arms.pendulum(), recording)

    def test_no_recording(self) -> None:
        with pytest.raises(ValueError, match="got no recording; expected one or more"):
            jc.MaximumLikelihood().fit(arms.pendulum(), [])

    def test_too_few_samples(self, clean: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
        time, position, torque = (x[:6] for x in clean)
        with pytest.raises(ValueError, match="has 6 samples; expected at least 10"):
            jc.MaximumLikelihood().fit(arms.pendulum(), jc.Recording(time, position, torque))

    def test_errors(self) -> None:
        with pytest.raises((ValueError, TypeError), match="none"):
            jc.MaximumLikelihood(errors="none")  # type: ignore[arg-type]

    def test_sampling(self) -> None:
        # A type checker at run time speaks first.
        with pytest.raises((ValueError, TypeError), match="often"):
            jc.MaximumLikelihood(torque_sampling="often")  # type: ignore[arg-type]
