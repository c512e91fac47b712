"""Causes that first-order columns show: each is named with its size; Gram matrices are right."""

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import jaxcslc as jc
import sim
from jaxcslc.checks import _evidence
from jaxcslc.checks._channel_findings import Channels
from jaxcslc.checks._evidence import Change, Evidence, removes
from jaxcslc.checks._first_order import BLOCKS, FirstOrder, gravity_columns
from jaxcslc.checks._model_findings import file_factors
from scripts.studies.checks.robots import FILES, Conditions, Fault, Run, arm, record
from scripts.studies.checks.spoiler import clean_conditions
from scripts.studies.checks.spoilers import spoilt


ARM, SEED = "Gen2", 4
# Offset of a size that is estimated beside friction that no model has.
PART = 0.1


def recorded(fault: Fault | None = None) -> Run:
    return record(ARM, Conditions(duration=16.0), SEED, fault)


@pytest.fixture(scope="module")
def network() -> jc.CSLC:
    return arm(ARM, SEED).network


@pytest.fixture(scope="module")
def run() -> Run:
    return recorded()


@pytest.fixture(scope="module")
def clean(run: Run) -> jc.Recording:
    return run.recording


@pytest.fixture(scope="module")
def evidence(network: jc.CSLC, clean: jc.Recording) -> Evidence:
    return Evidence.of(network, clean)


def test_gravity_columns_are_the_torque_at_rest(network: jc.CSLC, rng: np.random.Generator) -> None:
    """Against the network's own equations, which Pinocchio confirms elsewhere."""
    q = rng.uniform(-2.0, 2.0, (7, 6))
    columns = gravity_columns(network, q)
    assert columns is not None and network.robot.links is not None
    k = network.coefficients_from(network.robot.links)
    at_rest = network.torque(k, q, 0 * q, 0 * q)
    np.testing.assert_allclose(columns @ np.array(network.robot.gravity), at_rest, atol=1e-9)


def test_errors_are_those_of_fits_without_their_blocks(evidence: Evidence) -> None:
    """Against NumPy's least squares of the rows themselves, weighted alike."""
    first = FirstOrder.of(evidence)
    patterns, joints = evidence.patterns, evidence.network.joint_count
    rows = np.asarray(evidence.network.regressor(patterns.q, patterns.qd, patterns.qdd))
    constant = np.broadcast_to(np.eye(joints), (*rows.shape[:2], joints))
    rows = np.concatenate([rows, constant], axis=2)
    torque, mask = np.asarray(patterns.torque), np.asarray(patterns.mask)
    bounds = np.linspace(0, len(rows), BLOCKS + 1).round().astype(int)
    block = np.searchsorted(bounds, np.arange(len(rows)), side="right") - 1
    weights = np.sqrt(first._weights)
    squares = np.zeros(joints)
    for fold in range(5):
        inside = block % 5 == fold
        fitted = mask & ~inside[:, None]
        scaled = (weights[:, None] * rows)[fitted]
        k = np.linalg.lstsq(scaled, (weights * torque)[fitted], rcond=None)[0]
        error = np.where(mask & inside[:, None], torque - rows @ k, 0.0)
        squares += np.sum(error**2, axis=0)
    size = np.where(mask, torque**2, 0.0).sum(axis=0)
    np.testing.assert_allclose(first.score().errors, np.sqrt(squares / size), rtol=1e-5)


def test_a_joint_without_torque_has_finite_errors(network: jc.CSLC, clean: jc.Recording) -> None:
    """They are no part of a torque that is zero."""
    torque = clean.torque * (np.arange(clean.joints) != 1)
    silent = Evidence.of(network, dataclasses.replace(clean, torque=torque))
    for errors in (silent.training_errors, silent.relative_errors, silent.noise):
        assert np.all(np.isfinite(errors**2))


def test_sizes_are_those_of_small_faults(evidence: Evidence) -> None:
    """What is done to the patterns comes back as the size of its column."""
    offset = np.zeros(6)
    offset[2] = 0.01
    moved = Change(motion_offsets=offset).patterns(evidence.patterns)
    first = FirstOrder.of(evidence, moved)
    assert first.sizes(first.group("zero", 2))[0] == pytest.approx(-0.01, rel=PART)
    factors = np.ones(6)
    factors[1] = 1.02
    first = FirstOrder.of(evidence, Change(torque_factors=factors).patterns(evidence.patterns))
    assert first.sizes(first.gains(1))[0] == pytest.approx(0.02, rel=PART)


def test_factors_of_the_file_s_gravity(evidence: Evidence) -> None:
    once = file_factors(evidence)
    doubled = dataclasses.replace(
        evidence, patterns=Change(torque_factors=2.0).patterns(evidence.patterns)
    )
    twice = file_factors(doubled)
    assert once is not None and twice is not None and once.joints.size > 0
    np.testing.assert_allclose(twice.factor, 2.0 * once.factor, rtol=1e-9)
    assert 0.6 < once.common < 1.6  # masses differ by 20 % from the file's


def with_torque(clean: jc.Recording, joint: int, factor: float) -> jc.Recording:
    factors = np.ones(6)
    factors[joint] = factor
    return dataclasses.replace(clean, torque=clean.torque * factors)


def with_position(
    clean: jc.Recording, joint: int, change: Callable[[np.ndarray], np.ndarray]
) -> jc.Recording:
    position = clean.position.copy()
    position[:, joint] = change(position[:, joint])
    return dataclasses.replace(clean, position=position)


CASES: dict[str, tuple[Callable[[jc.Recording], jc.Recording], str, str, str]] = {
    # what is done, kind of the finding, its joint, and a part of its evidence
    "scale": (lambda r: with_torque(r, 1, 1.5), "torque scale", "joint_2", "1.5 times"),
    "unit": (lambda r: with_torque(r, 2, 1e3), "torque scale", "joint_3", "times"),
    "zero": (lambda r: with_position(r, 2, lambda q: q + 0.2), "zero position", "joint_3", "11."),
    "ticks": (lambda r: with_position(r, 2, lambda q: 1.5 * q), "position scale", "joint_3", "1.5"),
    "clock": (lambda r: dataclasses.replace(r, time=1.5 * r.time), "clock", "", "divided by 1."),
    "tilt": (lambda r: recorded(Fault(tilt=(0.3, 0.0))).recording, "mounting", "", "17."),
    "turned": (lambda r: recorded(Fault(tilt=(np.pi, 0.0))).recording, "mounting", "", "other way"),
    "drift": (lambda r: recorded(Fault(drift=0.5)).recording, "drift", "joint_1", "changes"),
    "tool": (lambda r: recorded(Fault(tool=0.5)).recording, "tool change", "", "from 8"),
    "contact": (lambda r: recorded(Fault(push=20.0)).recording, "contact", "joint_2", "from 5.6"),
    "stop": (lambda r: recorded(Fault(stop=(1, 0.8))).recording, "stop", "joint_2", "highest"),
}


@pytest.mark.parametrize("name", CASES)
def test_each_cause_is_named_first(name: str, network: jc.CSLC, clean: jc.Recording) -> None:
    change, kind, joint, text = CASES[name]
    first = jc.check(network, change(clean)).findings[0]
    assert first.kind == kind
    assert joint in first.joint
    assert text in first.evidence


def test_times_count_from_the_start_of_a_long_recording(
    network: jc.CSLC, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only the window with the most motion of it is looked at; times are since 1970."""
    monkeypatch.setattr(_evidence, "_MOST_SAMPLES", 7000)
    pushed = record(ARM, Conditions(duration=30.0), SEED, Fault(push=20.0)).recording
    assert Evidence.of(network, pushed).recording.time[0] > 1.0
    since_1970 = dataclasses.replace(pushed, time=1.7e9 + pushed.time)
    first = jc.check(network, since_1970).findings[0]
    assert first.kind == "contact"
    # From 12 s to 16 s, in blocks of 1.4 s; those beside them count as well.
    start, end = map(float, re.findall(r"([\d.]+) s", first.evidence)[:2])
    assert 12.0 - 2.8 < start < 12.0 and 16.0 < end < 16.0 + 2.8


def test_torques_that_wrong_positions_do_not_explain_are_not_clipped() -> None:
    """Friction holds the torque of a slow joint, and the sign of another joint is wrong."""
    network, case = arm("Panda").network, spoilt("Panda", "sign of one position", 1, 0)
    kinds = [found.kind for found in jc.check(network, case.recordings).findings]
    assert kinds == ["sign"]


def test_gravity_that_was_taken_out(network: jc.CSLC, run: Run) -> None:
    recording = dataclasses.replace(run.recording, torque=run.recording.torque - run.gravity)
    assert jc.check(network, recording).findings[0].kind == "gravity compensation"


def test_torques_without_their_signs(network: jc.CSLC, clean: jc.Recording) -> None:
    """A torque that friction reverses is named; one that comes near zero without is not."""
    torque = clean.torque.copy()
    torque[:, 3] = np.abs(torque[:, 3])
    first = jc.check(network, dataclasses.replace(clean, torque=torque)).findings[0]
    assert (first.kind, first.joint) == ("unsigned torque", "j2s6s200_joint_4")
    shifted = clean.torque - np.min(clean.torque, axis=0)
    found = jc.check(network, dataclasses.replace(clean, torque=shifted)).findings
    assert "unsigned torque" not in {one.kind for one in found}


@pytest.mark.parametrize("joint", [0, 2])
def test_signs_are_found_where_friction_hides_zeros(
    joint: int, network: jc.CSLC, clean: jc.Recording
) -> None:
    """Dry friction makes torques jump over zero: what is recorded does not come near it."""
    torque = clean.torque.copy()
    torque[:, joint] = np.abs(torque[:, joint])
    first = jc.check(network, dataclasses.replace(clean, torque=torque)).findings[0]
    assert (first.kind, first.joint) == ("unsigned torque", f"j2s6s200_joint_{joint + 1}")


@pytest.mark.parametrize(("name", "seed"), [("Gen2", 1013), ("UR3", 1018)])
def test_slow_motion_of_coarse_encoders_is_no_fault(name: str, seed: int) -> None:
    """Friction at a standstill is no clipping, and a zero far off is no fault of first order."""
    recording = record(name, clean_conditions(seed), seed).recording
    assert not jc.check(arm(name).network, recording).findings


def test_a_short_recording_is_no_other_robot() -> None:
    """Of tame motion, held-out errors are large whatever the robot is."""
    machine = sim.puma_a()
    trajectory = sim.training(samples=1500, robot=machine.robot)
    recording, _ = sim.simulate(machine, trajectory, seed=1)
    network = jc.derive(machine.robot)
    kinds = {found.kind for found in jc.check(network, recording).findings}
    assert not kinds & {"wrong robot", "stop"}


def test_torques_at_the_end_of_a_sensor(network: jc.CSLC, run: Run) -> None:
    torque = run.recording.torque - run.noise
    torque[:, 1] = np.clip(torque[:, 1], -10.0, 10.0)
    limited = dataclasses.replace(run.recording, torque=torque + run.noise)
    first = jc.check(network, limited).findings[0]
    assert (first.kind, first.joint) == ("clipping", "j2s6s200_joint_2")


def test_a_common_factor_is_seen_by_the_file_s_masses(
    network: jc.CSLC, clean: jc.Recording
) -> None:
    doubled = dataclasses.replace(clean, torque=2.0 * clean.torque)
    first = jc.check(network, doubled).findings[0]
    assert (first.kind, first.joint) == ("torque scale", "")
    assert not jc.check(network, clean).findings


def test_remedies_that_leave_the_evidence_are_none() -> None:
    before, noise = np.array([0.5, 0.01]), np.full(2, 0.005)
    assert not removes(before, np.array([0.45, 0.01]), noise)
    assert removes(before, np.array([0.1, 0.02]), noise)


class TestChannels:
    """Angles that wrap, signs that are lost, and rows that are missing unnoticed."""

    time = np.arange(4000) * 0.004
    motion = np.stack([2.0 * np.sin(time), np.cos(2.0 * time)], axis=1)
    torque = np.stack([np.cos(3.0 * time) + 0.1, 5.0 + np.sin(time)], axis=1)

    def kinds(self, position: np.ndarray, torque: np.ndarray) -> list[tuple[str, str]]:
        recording = jc.Recording(self.time[: len(position)], position, torque)
        found = Channels.of(recording, ("a", "b"), "RR").findings
        return [(one.kind, one.joint) for one in found]

    def test_nothing(self) -> None:
        assert self.kinds(self.motion, self.torque) == []

    def test_wrapped(self) -> None:
        shifted = self.motion + np.array([3.0, 0.0])
        wrapped = (shifted + np.pi) % (2.0 * np.pi) - np.pi
        recording = jc.Recording(self.time, wrapped, self.torque)
        channels = Channels.of(recording, ("a", "b"), "RR")
        assert [one.joint for one in channels.findings] == ["a"]
        np.testing.assert_allclose(channels.recording.position, shifted, atol=1e-12)

    def test_lost_rows(self) -> None:
        kept = np.r_[0:1500, 1600:4000]
        assert self.kinds(self.motion[kept], self.torque[kept]) == [("jump", "")]

    def test_stop(self) -> None:
        stopped = np.minimum(self.motion, np.array([1.2, 9.0]))
        assert self.kinds(stopped, self.torque) == [("stop", "a")]

    def test_friction_that_ends_motion_is_no_stop(self) -> None:
        """It decelerates by as much as before, however fast the joint was 30 ms ago."""
        s = np.clip(np.abs(self.time % 2.0 - 1.0) - 0.25, 0.0, 0.5)  # there, held, back, held
        swing = 10.0 * np.where(s < 0.25, s**2, 0.125 - (0.5 - s) ** 2)
        noise = np.random.default_rng(0).normal(scale=5e-5, size=self.motion.shape)
        swinging = np.stack([swing, self.motion[:, 1]], axis=1) + noise
        assert self.kinds(swinging, self.torque) == []

    def test_samples_in_microseconds(self) -> None:
        few = slice(0, 300)  # of a clock in seconds that was taken for milliseconds
        time = 1e-5 * np.arange(300)
        recording = jc.Recording(time, self.motion[few], self.torque[few])
        assert not Channels.of(recording, ("a", "b"), "RR").findings


def test_an_estimate_and_its_error_are_those_of_the_rows(evidence: Evidence) -> None:
    """Against NumPy's weighted least squares with the column, and its residual by blocks."""
    first = FirstOrder.of(evidence)
    value, error = first.estimate(first.gains(1))
    sizes = first.sizes(first.gains(1))
    np.testing.assert_allclose(value, sizes[0], rtol=1e-6)
    assert 0.0 < error < 0.05
    # The zero of a vertical first axis adds nothing.
    assert first.estimate(first.group("zero", 0)) == (0.0, np.inf)


@pytest.mark.parametrize("factor", [1.05, 0.94])
def test_a_clock_is_named_by_its_size(network: jc.CSLC, clean: jc.Recording, factor: float) -> None:
    spoilt = dataclasses.replace(clean, time=factor * clean.time)
    found = jc.check(network, spoilt).findings[0]
    assert found.kind == "clock"
    named = float(found.remedy.removeprefix("divide the times by ").split(",")[0])
    # Friction that no model has pretends some of a clock.
    np.testing.assert_allclose(named, factor, atol=0.025)


def test_torques_beyond_the_limits_of_the_file_are_named(
    network: jc.CSLC, clean: jc.Recording, tmp_path: Path
) -> None:
    tops = np.quantile(np.abs(clean.torque), 0.999, axis=0)
    joint = int(np.argmax(tops))
    text = re.sub(
        'effort="[^"]*"',
        f'effort="{tops[joint] / 1.2}"',
        FILES[ARM].path.read_text(encoding="utf-8"),
    )
    weak = tmp_path / "weak.urdf"
    weak.write_text(text, encoding="utf-8")
    limited = jc.derive(jc.load_robot(weak), lengths="numeric")
    (found,) = jc.check(limited, clean).findings
    assert (found.kind, found.joint) == ("torque limit", network.output_names[joint])


def test_torques_of_a_controllers_model_are_named(network: jc.CSLC, run: Run) -> None:
    torque = run.gravity + run.motion
    (found,) = jc.check(network, dataclasses.replace(run.recording, torque=torque)).findings
    assert found.kind == "model torque"
    exact = torque + run.friction
    assert not jc.check(network, dataclasses.replace(run.recording, torque=exact)).findings
