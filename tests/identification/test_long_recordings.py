"""Long recordings in bounded memory: stretches are the whole, and a part is said."""

import dataclasses

import numpy as np
import pytest
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc.cli._common import PASSED, progress_lines
from jaxcslc.least_squares import Rows, _columns, _equations, equations_of, rows_of, torque_of
from jaxcslc.selection import section_of
from tests import arms


_FORGOTTEN = 1e-8  # what a filter remembers beyond the part of its neighbours that a stretch has


@pytest.fixture(scope="module")
def network() -> jc.CSLC:
    return arms.elbow()


@pytest.fixture(scope="module")
def recording(network: jc.CSLC) -> jc.Recording:
    """A hundred seconds of an arm that moves more from a third of the time on."""
    time, w = np.arange(10_000) * 0.01, np.array([1.3, 2.1])
    size = np.where(time > 33.0, 1.0, 0.3)[:, None]
    angle = time[:, None] * w
    q, qd, qdd = size * np.sin(angle), size * w * np.cos(angle), -size * w**2 * np.sin(angle)
    k = np.linspace(0.1, 1.0, network.size)
    torque = np.asarray(network.torque(k, q, qd, qdd))
    noise = np.random.default_rng(0).normal(size=q.shape)
    return jc.Recording(time, q, torque + 0.05 * noise)


@pytest.fixture
def patterns(recording: jc.Recording) -> jc.Patterns:
    return jc.Settings().patterns(recording)


def split(monkeypatch: pytest.MonkeyPatch) -> None:
    """Makes a stretch of every 4,096 samples."""
    monkeypatch.setattr(_columns, "LONG", 4096)
    monkeypatch.setattr(_equations, "LONG", 4096)


@pytest.mark.parametrize("cutoff", [None, 2.0, 0.1])
def test_equations_of_stretches_are_those_of_the_whole(
    cutoff: float | None,
    network: jc.CSLC,
    patterns: jc.Patterns,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Also where the filter reaches further than a stretch."""
    whole = equations_of(network, patterns, cutoff)
    split(monkeypatch)
    joined = equations_of(network, patterns, cutoff)
    for joint in range(2):
        np.testing.assert_array_equal(joined.sample[joint], whole.sample[joint])
        scale = np.max(np.abs(whole.rows[joint]))
        np.testing.assert_allclose(
            joined.rows[joint], whole.rows[joint], atol=_FORGOTTEN * scale, rtol=0
        )


def test_torques_of_stretches_are_those_of_the_whole(
    network: jc.CSLC, patterns: jc.Patterns, monkeypatch: pytest.MonkeyPatch
) -> None:
    k = np.linspace(-1.0, 2.0, network.size)
    expected = np.asarray(network.regressor(patterns.q, patterns.qd, patterns.qdd)) @ k
    split(monkeypatch)
    np.testing.assert_allclose(torque_of(network, patterns, k), expected, atol=1e-12)
    some = rows_of(patterns, slice(10, 20))
    np.testing.assert_array_equal(some.q, np.asarray(patterns.q)[10:20])


def test_sums_of_blocks_are_those_of_all_rows(network: jc.CSLC, patterns: jc.Patterns) -> None:
    """What correlated errors are made of, in one piece and block by block."""
    equations = equations_of(network, patterns, None)
    rows = Rows.from_equations(equations, patterns.samples)
    rng = np.random.default_rng(1)
    residual, joint_weights = rng.normal(size=rows.torque.shape), np.array([1.0, 2.0])
    blocks = rows.cosine_sums(residual, joint_weights, np.ones(3))
    cosines = np.sqrt(2) * np.cos(np.pi * np.arange(1, 4)[:, None] * np.asarray(rows.phase))
    dense = np.zeros((len(rows.phase), 2, network.size))
    every = rows.columns(slice(None))
    for joint, (support, columns) in enumerate(zip(network.support, every, strict=True)):
        dense[:, joint, list(support)] = columns.T
    sums = np.einsum("ct,tj,tjp->cp", cosines, residual, dense)
    np.testing.assert_allclose(np.asarray(blocks.sums), sums, rtol=1e-9, atol=1e-9)
    weight = np.asarray(rows.counts) * joint_weights**2
    grams = np.einsum("ct,tj,tjp,tjq->cpq", cosines, weight, dense, dense, optimize=True)
    np.testing.assert_allclose(np.asarray(blocks.grams), grams, rtol=1e-7, atol=1e-6)


def test_a_section_is_where_joints_move(network: jc.CSLC, recording: jc.Recording) -> None:
    assert section_of(network, recording, 1.0) is None
    section = section_of(network, recording, 1e-6)
    assert section is not None and section.recording.samples == 4096
    assert section.recording.time[0] > 30.0
    assert "4096 of 10000 samples" in section.description
    # Without its last minute's continuity, elsewhere: no filter passes a gap.
    time = np.where(recording.time < 60.0, recording.time, recording.time + 5.0)
    gap = section_of(network, dataclasses.replace(recording, time=time), 1e-6)
    assert gap is not None and np.max(np.diff(gap.recording.time)) < 0.02
    with pytest.raises(ValueError, match="memory: expected more than 0 GB, got 0"):
        section_of(network, recording, 0.0)


def test_identify_fits_all_and_says_what_it_judged(
    network: jc.CSLC, recording: jc.Recording, patterns: jc.Patterns
) -> None:
    report = jc.identify(
        network, recording, settings=jc.Settings(), checks=False, possible="never", memory=1e-6
    )
    expected: Float[np.ndarray, " _"] = np.asarray(jc.LeastSquares().fit(network, patterns).k)
    np.testing.assert_allclose(np.asarray(report.k), expected, rtol=1e-9)
    assert report.judged_part is not None and report.judged_part in str(report)
    assert report.patterns["training"].samples > 9000


class TestProgress:
    def test_short_work_is_silent(self) -> None:
        lines: list[str] = []
        with progress_lines("reading", lines.append) as step:
            step("fitting coefficients")
        assert lines == []

    def test_long_work_says_what_is_left(self) -> None:
        """A step that begins when half of the time has passed leaves the other half."""
        now, lines = [0.0], list[str]()
        with progress_lines("reading", lines.append, clock=lambda: now[0]) as step:
            now[0] = 64.0
            step("fitting coefficients")
            now[0] = 70.0
            step("something else")
            now[0] = 80.0
            step("writing")
        assert PASSED["fitting coefficients"] == 0.5
        assert lines == [
            "jaxcslc: fitting coefficients, 64 s so far, about 64 s left",
            "jaxcslc: something else, 70 s so far",
            "jaxcslc: writing, 80 s so far, about 12 s left",
        ]
        assert list(PASSED.values()) == sorted(PASSED.values())

    def test_nothing_is_said_of_what_is_not_known(self) -> None:
        now, lines = [0.0], list[str]()
        with progress_lines("reading", lines.append, passed={}, clock=lambda: now[0]) as step:
            now[0] = 64.0
            step("fitting coefficients")
        assert lines == ["jaxcslc: fitting coefficients, 64 s so far"]
