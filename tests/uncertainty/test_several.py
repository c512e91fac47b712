"""Several recordings in one fit: weights, offsets, and whether they agree."""

from pathlib import Path

import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.cli._inputs import recordings_of
from jaxcslc.least_squares import LeastSquares
from jaxcslc.report import Table
from jaxcslc.uncertainty import fit_recordings
from tests import arms


SAMPLES = 600
K = np.array([0.3, 0.4, 0.45, 0.5, 0.6, 0.65, 0.7, 0.8, 0.85, 0.9, 1.0, 1.05, 1.1, 1.2])
SOLVER = LeastSquares(errors="independent")


@pytest.fixture(scope="module")
def network() -> jc.CSLC:
    return arms.elbow()


@pytest.fixture(scope="module")
def motions(network: jc.CSLC) -> list[jc.Patterns]:
    """Three motions of the same robot without noise."""
    patterns: list[jc.Patterns] = []
    for i in range(3):
        t = np.arange(SAMPLES) * 0.02
        rate = np.array([1.1, 1.7]) + 0.1 * i
        angle = np.outer(t, rate) + i
        q, qd, qdd = np.sin(angle), rate * np.cos(angle), -(rate**2) * np.sin(angle)
        pairs = np.ones(q.shape, bool)
        pairs[::7, i % 2] = False
        patterns.append(
            jc.Patterns(t, q, qd, qdd, np.asarray(network.torque(K, q, qd, qdd)), pairs, pairs)
        )
    return patterns


def with_torque(patterns: jc.Patterns, more: np.ndarray) -> jc.Patterns:
    motion = (patterns.time, patterns.q, patterns.qd, patterns.qdd)
    torque = np.asarray(patterns.torque) + more
    return jc.Patterns(*motion, torque, patterns.backlash_mask, patterns.friction_mask)


def noisy(
    motions: list[jc.Patterns], rng: np.random.Generator, *sizes: float
) -> dict[str, jc.Patterns]:
    return {
        f"recording {i}": with_torque(motions[i], size * rng.standard_normal((SAMPLES, 2)))
        for i, size in enumerate(sizes)
    }


def stacked(
    network: jc.CSLC, patterns: dict[str, jc.Patterns], weights: list[np.ndarray], *, offsets: bool
) -> np.ndarray:
    """NumPy's weighted least squares of all equations, a column for every offset."""
    rows: list[np.ndarray] = []
    torque: list[np.ndarray] = []
    for i, some in enumerate(patterns.values()):
        regressor = np.asarray(network.regressor(some.q, some.qd, some.qdd))
        constants = np.zeros((SAMPLES, 2, 2 * len(patterns)))
        constants[:, [0, 1], [2 * i, 2 * i + 1]] = 1.0
        whole = np.concatenate([regressor, constants], axis=2) if offsets else regressor
        mask = np.asarray(some.mask)
        weight = np.broadcast_to(weights[i], mask.shape)[mask]
        rows.append(whole[mask] * weight[:, None])
        torque.append(np.asarray(some.torque)[mask] * weight)
    return np.linalg.lstsq(np.concatenate(rows), np.concatenate(torque), rcond=None)[0]


@pytest.mark.parametrize("offsets", [False, True])
def test_the_fit_is_least_squares_weighted_by_noise(
    network: jc.CSLC, motions: list[jc.Patterns], rng: np.random.Generator, offsets: bool
) -> None:
    patterns = noisy(motions, rng, 0.01, 0.1)
    shifts = np.array([[0.5, -0.3], [-0.4, 0.2]]) * offsets
    patterns = {n: with_torque(p, s) for (n, p), s in zip(patterns.items(), shifts, strict=True)}
    several = fit_recordings(network, patterns, SOLVER, offsets=offsets)
    noise = [several.noise[name] for name in patterns]
    np.testing.assert_allclose(noise, [[0.01] * 2, [0.1] * 2], rtol=0.15)
    expected = stacked(network, patterns, [1.0 / size for size in noise], offsets=offsets)
    # The fit's weights are of fits of each recording by itself: they differ by a percent or two.
    error = np.asarray(several.fit.standard_error)
    assert np.max(np.abs(np.asarray(several.fit.k) - expected[: network.size]) / error) < 0.05
    if offsets:
        fitted = np.concatenate([several.offsets[name] for name in patterns])
        np.testing.assert_allclose(fitted, expected[network.size :], atol=2e-3)
        np.testing.assert_allclose(fitted, shifts.ravel(), atol=0.03)
        left = [np.asarray(p.torque) for p in several.patterns.values()]
        expected_left = [
            np.asarray(p.torque) - s for p, s in zip(patterns.values(), shifts, strict=True)
        ]
        np.testing.assert_allclose(left, expected_left, atol=0.03)


def test_disagreement_is_no_noise(
    network: jc.CSLC, motions: list[jc.Patterns], rng: np.random.Generator
) -> None:
    """The second recording is noisier, and of an arm with twice the friction and inertia."""
    patterns = noisy(motions, rng, 0.01, 0.1)
    name = "recording 1"
    patterns[name] = with_torque(patterns[name], np.asarray(motions[1].torque))
    several = fit_recordings(network, patterns, SOLVER)
    right = motions[0]
    errors = [
        np.asarray(network.torque(k, right.q, right.qd, right.qdd)) - np.asarray(right.torque)
        for k in (
            several.fit.k,
            stacked(network, patterns, [np.full(2, 1.0 / x) for x in (0.01, 0.1)], offsets=False),
            stacked(network, patterns, [np.ones(2), np.ones(2)], offsets=False),
        )
    ]
    of_fit, of_known_noise, of_equal_weights = (float(np.std(error)) for error in errors)
    assert of_fit < 1.2 * of_known_noise
    assert of_fit < 0.1 * of_equal_weights


def test_recordings_of_one_robot_agree(
    network: jc.CSLC, motions: list[jc.Patterns], rng: np.random.Generator
) -> None:
    for _ in range(3):
        agreement = fit_recordings(network, noisy(motions, rng, 0.05, 0.1, 0.05), SOLVER).agreement
        assert agreement.warnings == ()
        assert str(agreement) == "the 3 recordings agree in all coefficients"
        scores = [
            agreement.difference[name] / agreement.standard_error[name] for name in agreement.limit
        ]
        # 42 scores, correlated: their mean square is 1 with a deviation of about a third.
        assert 0.2 < np.mean(np.square(scores)) < 2.5


def test_what_differs_is_named(
    network: jc.CSLC, motions: list[jc.Patterns], rng: np.random.Generator
) -> None:
    """A warm gear in the second recording: viscous friction of the second joint is lower."""
    patterns = noisy(motions, rng, 0.02, 0.02, 0.02)
    qd = np.asarray(motions[1].qd)
    patterns["recording 1"] = with_torque(patterns["recording 1"], -0.2 * qd * [0.0, 1.0])
    agreement = fit_recordings(network, patterns, SOLVER).agreement
    assert agreement.differing["recording 1"][0] == "kv2"
    (sentence,) = [s for s in agreement.warnings if s.startswith("recording 1 ")]
    assert sentence.startswith("recording 1 disagrees with the others in kv2")
    assert "RMS torque error of joint 2" in sentence


def test_one_recording_is_not_several(network: jc.CSLC, motions: list[jc.Patterns]) -> None:
    with pytest.raises(ValueError, match="got 1 recordings; expected two or more"):
        fit_recordings(network, {"a": motions[0]})


class TestIdentify:
    def recording(self, patterns: jc.Patterns, every: int = 1) -> jc.Recording:
        arrays = (patterns.time, patterns.q, patterns.torque)
        return jc.Recording(*(np.asarray(values)[::every] for values in arrays))

    def test_report(self, network: jc.CSLC, motions: list[jc.Patterns]) -> None:
        recordings = {"a": self.recording(motions[0]), "b": self.recording(motions[1])}
        report = jc.identify(
            network, recordings, self.recording(motions[2]), jc.Settings(), offsets=True
        )
        assert report.several is not None and tuple(report.several.patterns) == ("a", "b")
        assert report.patterns["training"].samples == sum(
            patterns.samples for patterns in report.several.patterns.values()
        )
        # What smoothing 50 Hz does to coefficients of motion below 0.3 Hz.
        np.testing.assert_allclose(report.k, K, rtol=0.05, atol=0.02)
        assert "validation" in report.errors and "a: " in str(report)
        page = report.page(charts=False)
        blocks = [block for section in page.sections for block in section.blocks]
        (table,) = (b for b in blocks if isinstance(b, Table) and b.name == "several")
        assert [row[0] for row in table.rows] == ["a", "b"]
        assert report.systematic is not None
        bare = jc.identify(
            network, recordings, settings=jc.Settings(), offsets=True, systematic=False
        )
        assert bare.several is not None and bare.systematic is None
        for name in recordings:
            wide = report.several.agreement.standard_error[name]
            assert np.all(wide > bare.several.agreement.standard_error[name])

    def test_a_disagreement_is_one_message_with_its_cause(
        self, network: jc.CSLC, motions: list[jc.Patterns]
    ) -> None:
        k = K.copy()
        k[network.names.index("kv2")] += 1.0
        warm = with_torque(
            motions[1],
            np.asarray(network.torque(k - K, motions[1].q, motions[1].qd, motions[1].qdd)),
        )
        recordings = {"cold": self.recording(motions[0]), "warm": self.recording(warm)}
        report = jc.identify(network, recordings, settings=jc.Settings(), systematic=False)
        (sentence,) = (s for s in str(report).splitlines() if "disagrees" in s or "friction:" in s)
        assert "warm disagrees with the others in kv2" in sentence
        assert "likely cause: another temperature or state of the gears" in sentence
        assert report.data_check is not None
        assert all(finding.recording != "warm" for finding in report.data_check.findings)

    def test_options_and_folds(self, network: jc.CSLC, motions: list[jc.Patterns]) -> None:
        """They count for all recordings, whether settings are chosen or not."""
        recordings = [self.recording(patterns) for patterns in motions[:2]]
        for settings in (None, jc.Settings()):
            report = jc.identify(
                network,
                recordings,
                settings=settings,
                options={"loss": "huber", "torque_lag": 0.001},
                folds=4,
                checks=False,
                systematic=False,
                possible="never",
            )
            assert report.settings.solver.loss == "huber"
            assert report.settings.preparation.torque_lag == 0.001

    def test_memory_is_shared(
        self, network: jc.CSLC, motions: list[jc.Patterns], rng: np.random.Generator
    ) -> None:
        """Of recordings too long for it parts are used, which the report names."""
        whole = self.recording(motions[0])
        repeated = jc.Recording(
            0.01 * np.arange(12 * whole.samples),
            np.tile(whole.position, (12, 1)),
            np.tile(whole.torque, (12, 1)) + 1e-9 * rng.standard_normal((12 * whole.samples, 2)),
        )
        report = jc.identify(
            network,
            {"long": repeated, "short": whole},
            settings=jc.Settings(),
            memory=1e-6,
            checks=False,
            systematic=False,
            possible="never",
        )
        assert report.several is not None
        used = {name: patterns.samples for name, patterns in report.several.patterns.items()}
        assert used["long"] < repeated.samples and used["short"] <= whole.samples
        (note,) = [note for note in report.notes if "long: of this recording" in note]
        assert "where joints move most" in note and "--memory" in note

    def test_wrong_arguments(self, network: jc.CSLC, motions: list[jc.Patterns]) -> None:
        one = self.recording(motions[0])
        with pytest.raises(ValueError, match="got no recording; expected one or more"):
            jc.identify(network, [])
        with pytest.raises(ValueError, match="offsets= expects several recordings"):
            jc.identify(network, [one], offsets=True)
        with pytest.raises(ValueError, match="previous= expects one recording, got several"):
            jc.identify(network, [one, one], previous=K, groups=["dry"])


def test_recordings_of_a_command_are_called_by_their_files(tmp_path: Path) -> None:
    paths = [tmp_path / "a" / "m.csv", tmp_path / "b" / "m.csv", tmp_path / "n.csv"]
    for path in paths:
        path.parent.mkdir(exist_ok=True)
        path.write_text("time,position_1,torque_1\n" + "".join(f"{i},{i},0\n" for i in range(6)))
    assert list(recordings_of(paths[1:], jc.load_recording)) == ["m.csv", "n.csv"]
    assert list(recordings_of(paths[:2], jc.load_recording)) == [str(path) for path in paths[:2]]
    with pytest.raises(ValueError, match=r"n\.csv: is given twice"):
        recordings_of([paths[2], paths[2]], jc.load_recording)
