import dataclasses
import json

import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.checks import TorqueLag
from jaxcslc.least_squares import settings_document, settings_from
from jaxcslc.recordings import AbstractSmoothing, CentralDifferences, Sampling, register_smoothing
from jaxcslc.selection import _selection as selection_module
from jaxcslc.selection._selection import settled_alignment
from tests import arms


INTERVAL = 0.002
K = np.array([0.5, 0.3, -0.1, 0.4, 0.6])
# Of the pendulum's motion [rad/s, rad]: it ends at 2 Hz.
RATES, SIZES = np.array([3.1, 7.3, 12.7]), np.array([0.9, 0.5, 0.12])


@pytest.fixture(scope="module")
def pendulum() -> jc.CSLC:
    return arms.pendulum()


def swing(
    network: jc.CSLC, rng: np.random.Generator, *, position: float = 1e-4, torque: float = 0.0
) -> jc.Recording:
    """8 s of a pendulum with noise of the given deviations."""
    time = np.arange(4000) * INTERVAL
    phase = np.outer(time, RATES)
    q = (np.sin(phase) @ SIZES)[:, None]
    qd = (np.cos(phase) @ (SIZES * RATES))[:, None]
    qdd = (-np.sin(phase) @ (SIZES * RATES**2))[:, None]
    clean = np.asarray(network.torque(K, q, qd, qdd))
    return jc.Recording(
        time,
        q + rng.normal(0.0, position, q.shape),
        clean + rng.normal(0.0, torque, clean.shape),
    )


def moved(recording: jc.Recording, torque: np.ndarray) -> jc.Recording:
    return dataclasses.replace(recording, torque=torque)


def smoothing_of(selection: jc.Selection) -> AbstractSmoothing:
    return selection.settings.preparation.smoothing


@pytest.mark.parametrize("by", ["threads", "processes"])
@pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")
@pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning")
def test_candidates_side_by_side_are_those_one_after_the_other(
    pendulum: jc.CSLC, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, by: str
):
    """Several motions, and several settings of one motion."""
    recording = swing(pendulum, rng, torque=0.01)
    candidates = jc.Candidates(smoothings=tuple(map(jc.AveragedSplines, (5, 9, 17, 25))))
    alone = jc.choose_settings(pendulum, recording, candidates)
    if by == "threads":
        monkeypatch.setattr(selection_module, "SAMPLES_OF_THREADS", 1)
        monkeypatch.setattr(selection_module, "core_count", lambda: 3)
    else:
        monkeypatch.setattr(selection_module, "can_fork", lambda: True)
        monkeypatch.setattr("jaxcslc._processes.can_fork", lambda: True)
    together = jc.choose_settings(pendulum, recording, candidates)
    assert together.settings == alone.settings
    assert [x.settings for x in together.trials] == [x.settings for x in alone.trials]
    assert [x.score for x in together.trials] == [x.score for x in alone.trials]


# The choice


def test_smooths_more_where_there_is_more_noise(pendulum: jc.CSLC, rng: np.random.Generator):
    reaches = [
        smoothing_of(jc.choose_settings(pendulum, swing(pendulum, rng, position=noise))).reach(
            INTERVAL, 1
        )
        for noise in (1e-6, 1e-3)
    ]
    assert reaches[0] < reaches[1]


def test_the_chosen_smoothing_gives_nearly_the_best_accelerations(
    pendulum: jc.CSLC, rng: np.random.Generator
):
    recording = swing(pendulum, rng, position=3e-4, torque=0.3)
    choice = smoothing_of(jc.choose_settings(pendulum, recording))
    truth = (-np.sin(np.outer(recording.time, RATES)) @ (SIZES * RATES**2))[:, None]

    def error(smoothing: AbstractSmoothing) -> float:
        _, _, qdd = smoothing.smooth(recording.time, recording.position)
        return float(np.sqrt(np.mean((qdd - truth)[300:-300] ** 2)))

    spacings = (5, 7, 9, 13, 17, 25, 35, 49, 69, 97, 137)
    best = min(error(jc.AveragedSplines(spacing)) for spacing in spacings)
    assert error(choice) < 1.5 * best


@pytest.mark.parametrize("alignment", ["sample", "mean", "previous"])
@pytest.mark.parametrize("torque_noise", [0.0, 0.3])
def test_finds_which_torque_belongs_to_a_sample(
    pendulum: jc.CSLC, rng: np.random.Generator, alignment: str, torque_noise: float
):
    # Demands that were ahead of the motion by none, half or all of an interval. Averaging must
    # not win merely because it halves the noise of the torque.
    ahead = {"sample": 0.0, "mean": 0.5, "previous": 1.0}[alignment]
    recording = swing(pendulum, rng, position=1e-5)
    torque = recording.torque[:, 0]
    early = np.interp(recording.time + ahead * INTERVAL, recording.time, torque)[:, None]
    early = early + rng.normal(0.0, torque_noise, early.shape)
    selection = jc.choose_settings(pendulum, moved(recording, early))
    assert selection.settings.preparation.torque_alignment == alignment


def test_finds_how_late_torques_were_measured(pendulum: jc.CSLC, rng: np.random.Generator):
    recording = swing(pendulum, rng, position=1e-5)
    late = np.interp(recording.time - 3 * INTERVAL, recording.time, recording.torque[:, 0])
    candidates = dataclasses.replace(
        jc.Candidates.suited_to(recording),
        torque_alignments=("sample",),
        torque_lags=tuple(INTERVAL * lag for lag in range(-2, 7)),
    )
    selection = jc.choose_settings(pendulum, moved(recording, late[:, None]), candidates)
    assert selection.settings.preparation.torque_lag == pytest.approx(3 * INTERVAL)
    patterns = selection.settings.patterns(moved(recording, late[:, None]))
    straight = jc.Preparation(selection.settings.preparation.smoothing).patterns(recording)
    aligned = np.isin(np.asarray(straight.time), np.asarray(patterns.time))
    np.testing.assert_allclose(patterns.torque, straight.torque[aligned], atol=1e-9)


def test_leaves_out_more_slow_samples_where_static_friction_is_strong(
    pendulum: jc.CSLC, rng: np.random.Generator
):
    recording = swing(pendulum, rng)
    qd = jc.AveragedSplines(9).smooth(recording.time, recording.position)[1]
    stuck = 3.0 * np.sign(qd) * np.exp(-np.abs(qd) / 0.15)
    sticky = jc.choose_settings(pendulum, moved(recording, recording.torque + stuck))
    assert sticky.settings.preparation.threshold_fraction == 0.1


def test_coefficients_are_recovered_under_the_chosen_settings(
    pendulum: jc.CSLC, rng: np.random.Generator
):
    recording = swing(pendulum, rng, position=1e-4, torque=0.05)
    settings = jc.choose_settings(pendulum, recording).settings
    fit = settings.fit(pendulum, settings.patterns(recording))
    np.testing.assert_allclose(fit.k, K, atol=0.01)


def test_is_deterministic_and_reports_every_trial(pendulum: jc.CSLC, rng: np.random.Generator):
    recording = swing(pendulum, rng)
    first, second = (jc.choose_settings(pendulum, recording) for _ in range(2))
    assert [t.score for t in first.trials] == [t.score for t in second.trials]
    assert first.settings == second.settings
    family = type(smoothing_of(first))
    trials: dict[bool, list[float]] = {True: [], False: []}
    for trial in first.trials:
        trials[isinstance(trial.settings.preparation.smoothing, family)].append(trial.score)
    assert first.best.score == pytest.approx(min(trials[True]), rel=1e-5)
    # Another family of smoothings was tried, and was not better by a fifth.
    assert first.best.score < min(trials[False]) / 0.8
    assert len({str(trial.settings) for trial in first.trials}) == len(first.trials)
    assert "\n" not in str(first) and str(first.settings) in str(first)


def test_scores_do_not_depend_on_the_unit_of_torque(pendulum: jc.CSLC, rng: np.random.Generator):
    recording = swing(pendulum, rng)
    scaled = moved(recording, 1000.0 * recording.torque)
    one, other = (jc.choose_settings(pendulum, r) for r in (recording, scaled))
    assert one.settings == other.settings
    assert other.best.score == pytest.approx(1000.0 * one.best.score)


def test_only_candidates_that_were_given_are_tried(pendulum: jc.CSLC, rng: np.random.Generator):
    candidates = jc.Candidates(
        smoothings=(jc.Butterworth(10.0), jc.Butterworth(20.0)),
        torque_alignments=("sample",),
        threshold_fractions=(0.02,),
        cutoffs=(None,),
        joint_weights=("equal",),
    )
    selection = jc.choose_settings(pendulum, swing(pendulum, rng), candidates)
    assert len(selection.trials) == 2
    tried = [trial.settings.preparation.smoothing for trial in selection.trials]
    assert all(smoothing in tried for smoothing in candidates.smoothings)


def test_uneven_time_is_no_reason_to_fail(pendulum: jc.CSLC, rng: np.random.Generator):
    recording = swing(pendulum, rng)
    kept = rng.uniform(size=recording.samples) < 0.9
    selection = jc.choose_settings(pendulum, recording.rows(kept))
    assert selection.settings.solver.cutoff is None


# What cannot be chosen


def test_refuses_what_makes_no_sense(pendulum: jc.CSLC, rng: np.random.Generator):
    recording = swing(pendulum, rng)
    for folds in (0, 1, 1000):
        with pytest.raises(ValueError, match=f"{folds} folds of"):
            jc.choose_settings(pendulum, recording, folds=folds)
    with pytest.raises(ValueError, match=r"too short: .* samples left after smoothing; expected"):
        jc.choose_settings(pendulum, recording.rows(slice(30)))
    with pytest.raises(ValueError, match=r"1 joints, .* has 6"):
        jc.choose_settings(jc.derive(jc.puma560()), recording)
    with pytest.raises(ValueError, match="no candidates for cutoffs"):
        jc.Candidates(cutoffs=())
    with pytest.raises(ValueError, match="half the sampling rate"):
        jc.choose_settings(pendulum, recording, jc.Candidates(cutoffs=(400.0,)))


def test_refuses_a_joint_that_stands_still(pendulum: jc.CSLC):
    time = np.arange(2000) * INTERVAL
    still = jc.Recording(time, np.zeros((2000, 1)), np.ones((2000, 1)))
    with pytest.raises(ValueError, match="leaves nothing"):
        jc.choose_settings(pendulum, still)


# A smoothing of a user's


@register_smoothing("moving_average_of_a_test")
class MovingAverage(AbstractSmoothing):
    width: int

    def smooth(self, time: np.ndarray, position: np.ndarray):
        return CentralDifferences().smooth(time, self.low_pass(time, position))

    def low_pass(self, time: np.ndarray, signal: np.ndarray):
        kernel = np.ones(self.width) / self.width
        return np.stack([np.convolve(x, kernel, "same") for x in signal.T], axis=1)

    def reach(self, interval: float, joints: int) -> int:
        return self.width // 2 + 2

    @property
    def description(self) -> str:
        return f"moving average of {self.width} samples"


def test_a_users_smoothing_works_like_a_built_in(pendulum: jc.CSLC, rng: np.random.Generator):
    recording = swing(pendulum, rng)
    candidates = dataclasses.replace(
        jc.Candidates.suited_to(recording),
        smoothings=tuple(MovingAverage(width) for width in (3, 5, 9, 15, 21, 31, 41)),
    )
    settings = jc.choose_settings(pendulum, recording, candidates).settings
    smoothing = settings.preparation.smoothing
    assert isinstance(smoothing, MovingAverage)
    assert str(settings).startswith(f"moving average of {smoothing.width} samples, ")
    reach = smoothing.width // 2 + 2
    assert settings.preparation.trimmed(recording) == reach
    assert settings.patterns(recording).samples == recording.samples - 2 * reach
    again = settings_from(json.loads(json.dumps(settings_document(settings))))
    assert again == settings and again.chosen_on == settings.chosen_on


def test_a_smoothing_without_a_name_in_files_says_so():
    class Nameless(MovingAverage):
        pass

    settings = jc.Settings(jc.Preparation(Nameless(5)))
    with pytest.raises(ValueError, match="Nameless has no name in a file; expected a class dec"):
        settings_document(settings)
    with pytest.raises(ValueError, match="the smoothing 'butterworth' is Butterworth; expected a"):
        register_smoothing("butterworth")(Nameless)


# Recorded velocities


def true_velocity(recording: jc.Recording) -> np.ndarray:
    return (np.cos(np.outer(recording.time, RATES)) @ (SIZES * RATES))[:, None]


@pytest.mark.parametrize(("noise", "source"), [(1e-4, "recorded"), (1.0, "position")])
def test_recorded_velocities_are_used_where_they_are_better(
    pendulum: jc.CSLC, rng: np.random.Generator, noise: float, source: str
):
    recording = swing(pendulum, rng, position=1e-3)
    velocity = true_velocity(recording) + rng.normal(0.0, noise, recording.position.shape)
    recording = dataclasses.replace(recording, velocity=velocity)
    settings = jc.choose_settings(pendulum, recording).settings
    assert settings.preparation.velocity == source
    words = {"recorded": "recorded velocities", "position": "velocities from positions"}[source]
    assert words in str(settings)
    without = swing(pendulum, rng)
    if source == "recorded":
        with pytest.raises(ValueError, match="the recording has no velocity; expected"):
            settings.patterns(without)
        assert "no recorded velocities, which the settings use" in settings.check(without)


# Settings applied to another recording


def test_settings_name_what_differs_in_another_recording(
    pendulum: jc.CSLC, rng: np.random.Generator
):
    recording = swing(pendulum, rng, position=0.0)
    position = recording.position

    def read(step: float) -> jc.Recording:
        return dataclasses.replace(recording, position=step * np.round(position / step))

    settings = jc.Settings(
        jc.Preparation(jc.AveragedSplines(17)), jc.LeastSquares(cutoff=8.0), Sampling.of(read(1e-4))
    )
    assert settings.check(read(1e-4)) == () == settings.check(read(5e-5))
    (coarse,) = settings.check(read(1e-3))
    assert coarse == (
        "joint 1: encoder steps of 0.001, 10 times the 0.0001 that the settings were chosen for"
    )
    (slow,) = settings.check(read(1e-4).rows(slice(None, None, 2)))
    assert slow.startswith("sampled every 4 ms, 2 ms where the settings were chosen: averaged")
    assert slow.endswith("reach over 68 ms to either side instead of 34 ms")
    kept = rng.uniform(size=recording.samples) < 0.9
    irregular, filtered = settings.check(read(1e-4).rows(kept))
    assert irregular.startswith("irregular time stamps: intervals differ from their median by")
    assert filtered.startswith("the filter at 8 Hz cannot be used: time is not uniform")
    again = jc.choose_settings(
        pendulum, read(1e-3), jc.Candidates.suited_to(read(1e-3)).keeping(settings)
    ).settings
    assert again.solver.cutoff == 8.0 and again.check(read(1e-3)) == ()


# Static friction and masks


def test_slow_pairs_are_kept_where_a_term_explains_them(rng: np.random.Generator):
    robot = jc.examples.pendulum()
    network = jc.derive(robot.with_friction("viscous", "dry", "static"), lengths="numeric")
    plain = jc.derive(robot, lengths="numeric")
    recording = swing(plain, rng)
    resolved = jc.Settings().for_network(network)
    assert resolved.preparation.threshold_fraction == (0.003,)
    assert jc.Settings().for_network(plain) == jc.Settings()
    by_hand = jc.Settings(jc.Preparation(threshold_fraction=0.03))
    assert by_hand.for_network(network) == by_hand
    fractions = jc.Candidates.suited_to(recording, network).threshold_fractions
    assert fractions == ((0.001,), (0.003,), (0.01,))
    patterns = resolved.patterns(recording)
    assert np.sum(patterns.mask) > np.sum(by_hand.patterns(recording).mask)


def test_a_validation_recording_of_a_coarser_encoder_is_named(
    pendulum: jc.CSLC, rng: np.random.Generator
):
    recording = swing(pendulum, rng, position=0.0)
    fine, coarse = (
        dataclasses.replace(recording, position=step * np.round(recording.position / step))
        for step in (1e-4, 1e-3)
    )
    settings = jc.Settings(jc.Preparation(jc.AveragedSplines(9)))
    report = jc.identify(pendulum, fine, coarse, settings)
    start = "validation recording: joint 1: encoder steps of 0.001, 10 times the 0.0001"
    (warning,) = [text for text in report.warnings if text.startswith(start)]
    assert warning.endswith("that the settings were chosen for")
    adapted = jc.identify(pendulum, fine, coarse)
    (warning,) = [text for text in adapted.warnings if text.startswith(start)]
    assert "; prepared by settings of its own: " in warning
    # Smoothed for its own encoder, it shows smaller errors than by the other recording's settings.
    errors = [float(r.errors["validation"].rms[0, 0]) for r in (adapted, report)]
    assert errors[0] < errors[1]
    later = fine.rows(slice(200, None))
    assert not any(text.startswith(start) for text in jc.identify(pendulum, fine, later).warnings)


def settled(scores: dict[str, float], lag: TorqueLag | None, *convention: str) -> str:
    """The alignment that is settled on, at 2 ms, for scores and a lag [ms]."""

    def estimate() -> TorqueLag:
        if lag is None:
            raise ValueError("too short")
        return lag

    settings = settled_alignment(
        jc.Settings(),
        convention,  # pyright: ignore[reportArgumentType]
        lambda settings: scores[settings.preparation.torque_alignment],
        estimate,
        0.002,
    )
    return settings.preparation.torque_alignment


def lag_of(lag: float, half: float) -> TorqueLag:
    return TorqueLag(1e-3 * lag, 1e-3 * (lag - half), 1e-3 * (lag + half), 0.0)


def test_an_alignment_is_settled_by_a_clear_score_or_by_the_lag() -> None:
    clear = {"mean": 1.0, "sample": 0.8, "previous": 1.0}
    held, measured = ("mean", "sample", "previous"), ("sample", "mean", "previous")
    assert settled(clear, None, *held) == "sample"
    close = {"mean": 1.0, "sample": 0.999, "previous": 1.0}
    # A lag of none, a half and a whole sample, known to a tenth of one.
    for lag, alignment in ((0.0, "sample"), (-1.0, "mean"), (-2.0, "previous")):
        assert settled(close, lag_of(lag, 0.2), *held) == alignment
        assert settled(close, lag_of(lag, 0.2), *measured) == alignment
        # Known to no better than a sample: the convention stays.
        assert settled(close, lag_of(lag, 2.0), *held) == "mean"
        assert settled(close, lag_of(lag, 2.0), *measured) == "sample"
    assert settled(close, None, *held) == "mean"
    assert settled(close, lag_of(0.0, np.inf), *held) == "mean"
