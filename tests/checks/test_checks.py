"""Checks of recordings: each way to spoil one is named, a clean one is left alone."""

import dataclasses
import re
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jaxcslc as jc
import sim
from jaxcslc.checks import estimate_torque_lag, small_torque_lag, without_outliers
from jaxcslc.checks._sample_findings import (
    LEAST_DISTANCE,
    Outliers,
    clipping,
    clock_findings,
    mark_outliers,
    sample_findings,
    time_unit,
)
from tests import arms
from tests.conftest import run


INTERVAL, SAMPLES = 0.004, 4000
# Offset of a held-out fit: a tenth of a sample, the accuracy that is asked of a lag.
TENTH = 0.1 * INTERVAL


@pytest.fixture(scope="session")
def arm() -> jc.CSLC:
    """Three joints, the first upright, with masses that the recording's differ from."""
    robot = jc.Manipulator.from_modified_dh(
        [(0, 0, 0.3, 0), ("-pi/2", 0.1, 0, 0), (0, 0.4, 0, 0)], motor_inertia=False
    )
    centres = ([0.02, 0.03, 0.1], [0.2, 0.02, 0.05], [0.15, -0.01, 0.02])
    links = tuple(
        jc.LinkParameters(mass, np.array(centre), 0.02 * mass * np.eye(3))
        for mass, centre in zip((6.0, 4.0, 2.0), centres, strict=True)
    )
    return jc.derive(dataclasses.replace(robot, links=links), lengths="numeric")


def motion(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Three sines for each joint, of frequencies that no other has, and derivatives."""
    hertz = np.array([[0.11, 0.31, 0.83], [0.13, 0.37, 0.71], [0.17, 0.43, 0.97]])
    amplitude = np.array([0.8, 0.35, 0.12])
    omega = 2 * np.pi * hertz
    angle = omega * time[:, None, None] + np.arange(3)
    q = np.sin(angle) @ amplitude
    qd = (omega * np.cos(angle)) @ amplitude
    return q, qd, -(omega**2 * np.sin(angle)) @ amplitude


@pytest.fixture(scope="session")
def clean(arm: jc.CSLC) -> jc.Recording:
    return recorded(arm)


def recorded(arm: jc.CSLC, lag: float = 0.0, payload: float = 0.0, seed: int = 0) -> jc.Recording:
    """Encoder counts and noisy torques of 16 s, the torques so much late [s]."""
    rng = np.random.default_rng(seed)
    assert arm.robot.links is not None
    *links, last = arm.robot.links
    mass = float(last.mass)
    tip = jc.LinkParameters(
        1.1 * mass + payload,
        np.asarray(last.centre_of_gravity) + np.array([0.1 * payload, 0.0, 0.0]),
        np.asarray(last.inertia) + 0.02 * payload * np.eye(3),
    )
    k = np.asarray(
        arm.coefficients_from((*links, tip), viscous=(2.0, 2.0, 1.0), dry=(2.0, 3.0, 1.0))
    )
    time = INTERVAL * np.arange(SAMPLES)
    torque = np.asarray(arm.torque(k, *motion(time - lag)))
    torque = torque + 0.01 * np.std(torque, axis=0) * rng.standard_normal(torque.shape)
    q, _, _ = motion(time)
    return jc.Recording(time, 1e-4 * np.floor(q / 1e-4 + rng.random(3)), torque)


def changed(recording: jc.Recording, **arrays: Any) -> jc.Recording:
    return dataclasses.replace(recording, **arrays)


def with_column(recording: jc.Recording, name: str, joint: int, factor: float) -> jc.Recording:
    values = np.array(getattr(recording, name))
    values[:, joint] *= factor
    return changed(recording, **{name: values})


def with_spikes(recording: jc.Recording) -> jc.Recording:
    torque = np.array(recording.torque)
    hit = np.random.default_rng(1).random(torque.shape) < 0.002
    torque[hit] += 1000.0
    return changed(recording, torque=torque)


def held(recording: jc.Recording, every: int) -> jc.Recording:
    rows = np.arange(recording.samples) // every * every
    return changed(recording, position=recording.position[rows])


def stale(recording: jc.Recording) -> jc.Recording:
    fresh = np.random.default_rng(2).random(recording.samples) > 0.05
    rows = np.maximum.accumulate(np.where(fresh, np.arange(recording.samples), 0))
    return changed(recording, position=recording.position[rows], torque=recording.torque[rows])


def jittered(recording: jc.Recording) -> jc.Recording:
    late = np.random.default_rng(3).uniform(0.0, 0.6 * INTERVAL, recording.samples)
    return changed(recording, time=recording.time + late)


def clipped(recording: jc.Recording) -> jc.Recording:
    torque = np.array(recording.torque)
    limit = np.quantile(np.abs(torque[:, 1]), 0.9)
    torque[:, 1] = np.clip(torque[:, 1], -limit, limit)
    return changed(recording, torque=torque)


def swapped(recording: jc.Recording) -> jc.Recording:
    order = [0, 2, 1]
    return changed(
        recording, position=recording.position[:, order], torque=recording.torque[:, order]
    )


SPOILT: dict[str, tuple[Callable[[jc.Recording], jc.Recording], str, str, str]] = {
    # what is done, kind of the finding, its joint, and a part of the text
    "milliseconds": (lambda r: changed(r, time=1e3 * r.time), "time unit", "", 'unit = "ms"'),
    "degrees": (
        lambda r: changed(r, position=np.degrees(r.position)),
        "angle unit",
        "",
        '[position] unit = "deg"',
    ),
    "millinewtons": (lambda r: changed(r, torque=1e3 * r.torque), "torque unit", "", "mN m"),
    "currents": (
        lambda r: changed(r, torque=r.torque / [11.0, 12.0, 5.0]),
        "torque unit",
        "",
        "motor currents",
    ),
    "position's sign": (lambda r: with_column(r, "position", 1, -1.0), "sign", "joint 2", "-1"),
    "torque's sign": (lambda r: with_column(r, "torque", 2, -1.0), "sign", "joint 3", "-1"),
    "all torques' signs": (
        lambda r: changed(r, torque=-r.torque),
        "sign",
        "",
        "[torque] sign = [-1, -1, -1]",
    ),
    "swapped": (swapped, "swapped joints", "joint 2, joint 3", "joints ="),
    "swapped positions": (
        lambda r: changed(r, position=r.position[:, [0, 2, 1]]),
        "swapped joints",
        "joint 2, joint 3",
        "[position] columns in the robot's order",
    ),
}

ROWS: dict[str, tuple[Callable[[jc.Recording], jc.Recording], str, str, str]] = {
    "gap": (
        lambda r: r.rows((r.time < 5.0) | (r.time > 8.0)),
        "gap",
        "",
        "no samples from 4.996 s to 8.004 s",
    ),
    "spikes": (with_spikes, "outliers", "joint 1, joint 2, joint 3", "--loss huber"),
    "stale": (stale, "stale rows", "", "--drop-stale"),
    "slow source": (lambda r: held(r, 3), "rate", "", "--decimate 3"),
    "jitter": (jittered, "jitter", "", "--period 0.004"),
    "clipping": (clipped, "clipping", "joint 2", "exactly"),
    "locked": (
        lambda r: with_column(r, "position", 0, 0.0),
        "motionless joint",
        "joint 1",
        "locked",
    ),
}


def test_a_clean_recording_is_left_alone(arm: jc.CSLC, clean: jc.Recording) -> None:
    page = jc.check(arm, clean)
    assert page.findings == ()
    assert "nothing looks wrong" in str(page) and "joint 3" in str(page)
    (summary,) = page.recordings
    assert summary.rate == pytest.approx(1 / INTERVAL)
    assert [joint.resolution for joint in summary.joints] == pytest.approx([1e-4] * 3)
    top = np.max(np.abs(motion(clean.time)[1]), axis=0)
    assert [joint.speed for joint in summary.joints] == pytest.approx(top, rel=0.05)


@pytest.mark.parametrize("name", SPOILT)
def test_the_cause_is_named_first(arm: jc.CSLC, clean: jc.Recording, name: str) -> None:
    spoil, kind, joint, part = SPOILT[name]
    first = jc.check(arm, spoil(clean)).findings[0]
    assert (first.kind, first.joint) == (kind, joint)
    assert part in str(first)


@pytest.mark.parametrize("name", ROWS)
def test_what_is_wrong_with_rows_is_named(arm: jc.CSLC, clean: jc.Recording, name: str) -> None:
    spoil, kind, joint, part = ROWS[name]
    spoilt, names = spoil(clean), arm.robot.joint_names
    first, *others = [
        *clock_findings(spoilt),
        *Outliers.of(spoilt).findings(spoilt, names),
        *sample_findings(spoilt, names),
    ]
    assert (first.kind, first.joint, others) == (kind, joint, [])
    assert part in str(first)


def test_recordings_of_one_arm_with_and_without_payload(arm: jc.CSLC, clean: jc.Recording) -> None:
    same, loaded = recorded(arm, seed=5), recorded(arm, payload=1.0, seed=6)
    assert jc.check(arm, [clean, same]).findings == ()
    (finding,) = jc.check(arm, [clean, loaded], ["a.csv", "b.csv"]).findings
    assert (finding.kind, finding.recording) == ("payload", "b.csv")
    thinned = same.rows(slice(None, None, 3))
    (finding,) = jc.check(arm, [clean, thinned], ["a.csv", "b.csv"]).findings
    assert finding.kind == "rate" and "--decimate 3" in finding.remedy


@pytest.mark.parametrize("lag", [-0.013, 0.0, 0.0203])
def test_a_lag_is_estimated_to_a_tenth_of_a_sample(arm: jc.CSLC, lag: float) -> None:
    estimate = estimate_torque_lag(arm, recorded(arm, lag, seed=8))
    assert estimate.lag == pytest.approx(lag, abs=TENTH)
    assert estimate.high - estimate.low < 10 * TENTH
    findings = jc.check(arm, recorded(arm, lag, seed=8)).findings
    assert [finding.kind for finding in findings] == ["torque lag"] * (lag != 0.0)


def test_a_lag_does_not_depend_on_where_its_search_starts(arm: jc.CSLC) -> None:
    """Once from zero, once from the best lag of a grid."""
    late = recorded(arm, 0.0203, seed=8)
    from_zero, estimate = small_torque_lag(arm, late), estimate_torque_lag(arm, late)
    half = 0.5 * (estimate.high - estimate.low)
    assert from_zero.lag == pytest.approx(estimate.lag, abs=0.05 * half)
    assert from_zero.high - from_zero.low == pytest.approx(2 * half, rel=0.05)


def test_a_mended_recording_passes(arm: jc.CSLC, clean: jc.Recording) -> None:
    mended = without_outliers(with_spikes(clean))
    assert jc.check(arm, mended).findings == ()
    far = np.abs(mended.torque - clean.torque) > 0.5 * np.std(clean.torque, axis=0)
    assert not far.any()


def test_units_of_time_follow_the_interval(clean: jc.Recording) -> None:
    for factor in (1e3, 1e6, 1e9):
        scale, finding = time_unit(changed(clean, time=1.7e9 + factor * clean.time))
        assert scale == pytest.approx(1.0 / factor) and finding is not None
    assert time_unit(changed(clean, time=1.7e9 + clean.time)) == (1.0, None)  # since 1970


def test_outliers_are_neither_steps_nor_peaks(rng: np.random.Generator) -> None:
    time = np.arange(3000) * 0.002
    wave = np.stack(
        [np.sin(9 * time), np.sign(np.sin(5 * time + 0.1)), np.round(20 * np.cos(time))], 1
    )
    assert not mark_outliers(wave, 0.5).any()
    # Nor the ends and peaks of a fast motion that few samples show.
    assert not mark_outliers(np.sin(0.12 * np.arange(1, 500))[:, None], 0.02).any()
    assert not mark_outliers(wave + 0.01 * rng.standard_normal(wave.shape), 0.5).any()
    wave[[100, 700, 2990], [0, 1, 2]] += 40.0
    assert np.argwhere(mark_outliers(wave, 0.5)).tolist() == [[100, 0], [700, 1], [2990, 2]]


def test_motion_that_goes_on_in_a_gap_is_no_outlier() -> None:
    """At a turning point, the sample before the gap is an extreme of all around it."""
    time = np.arange(3000) * 0.004
    wave = np.sin(5 * time)[:, None]
    recording = jc.Recording(time, wave, wave).rows((time < 0.3) | (time > 1.2))
    assert mark_outliers(recording.position, LEAST_DISTANCE["position"]).any()
    assert not any(marked.any() for marked in Outliers.of(recording).marked.values())
    np.testing.assert_array_equal(without_outliers(recording).position, recording.position)


def test_a_mass_that_no_torque_shows_is_not_named() -> None:
    """Of an upright axis: a body is felt, and not what it weighs."""
    network = arms.turntable()
    t = np.arange(3000)[:, None] * 0.004
    phase = 3 * t + np.sin(7 * t)
    q, qd = np.sin(phase), (3 + 7 * np.cos(7 * t)) * np.cos(phase)
    qdd = -49 * np.sin(7 * t) * np.cos(phase) - (3 + 7 * np.cos(7 * t)) ** 2 * np.sin(phase)
    recordings = [
        jc.Recording(t[:, 0], q, np.asarray(network.torque(np.array(k), q, qd, qdd)))
        for k in ([0.5, 0.2, 0.1], [0.8, 0.2, 0.1])
    ]
    (finding,) = jc.check(network, recordings, ["a", "b"]).findings
    assert finding.kind == "payload" and " kg" not in finding.evidence


def test_clipping_is_no_plateau_of_rounding() -> None:
    wave = np.sin(np.arange(4000) / 90)[:, None]
    assert not clipping(np.round(wave / 0.01) * 0.01).any()
    limited = np.minimum(np.round(wave / 0.01) * 0.01, 0.8)
    assert np.array_equal(clipping(limited), limited == limited.max())


def test_joints_that_stand_still_are_one_finding(clean: jc.Recording) -> None:
    """A gripper's: with the option that leaves them out, if the robot's file allows for it."""
    still = np.array([1.0, 0.0, 0.0])
    recording = changed(clean, position=clean.position * still, torque=clean.torque * still)
    names = ("arm", "finger", "thumb")
    (finding,) = sample_findings(recording, names, fixable=True)
    assert (finding.kind, finding.joint) == ("motionless joint", "finger, thumb")
    assert "--fix finger,thumb" in finding.remedy and "no torque" in finding.evidence
    (finding,) = sample_findings(recording, names)
    assert "--fix" not in finding.remedy


def test_a_joint_that_moves_though_it_is_fixed(arm: jc.CSLC, clean: jc.Recording) -> None:
    moving = (("finger", 0.02), ("thumb", 0.001))
    (finding,) = jc.check(arm, changed(clean, fixed_motion=moving)).findings
    assert (finding.kind, finding.joint) == ("fixed joint", "finger")
    assert "moves by 0.02" in finding.evidence


def test_a_cause_explains_the_warnings_of_a_fit(arm: jc.CSLC, clean: jc.Recording) -> None:
    """Degrees: one warning names them, and none the torque errors that they bring about."""
    degrees = changed(clean, position=np.degrees(clean.position))
    report = jc.identify(arm, degrees, settings=jc.Settings(), systematic=False)
    (warning,) = [sentence for sentence in report.warnings if "omitted" in sentence]
    assert "positions are in degrees" in warning and "fix that first" in warning
    assert not any("variance" in sentence for sentence in report.warnings)
    unchecked = jc.identify(arm, degrees, settings=jc.Settings(), systematic=False, checks=False)
    assert any("variance" in sentence for sentence in unchecked.warnings)


def test_too_little_motion_is_said(arm: jc.CSLC, clean: jc.Recording) -> None:
    assert jc.check(arm, clean.rows(slice(0, 12))).findings[-1].kind == "motion"
    kinds = {finding.kind for finding in jc.check(arm, clean.rows(slice(0, 300))).findings}
    assert "tame motion" in kinds


def test_joints_that_move_alike_have_no_wrong_sign(puma: jc.CSLC) -> None:
    """Friction of joints with the same velocity is shared out by chance: it proves nothing."""
    recording, _ = sim.simulate(sim.puma560(), sim.comparison(), seed=2)
    static = dataclasses.replace(puma.robot, friction=("viscous", "dry", "static"))
    page = jc.check(jc.derive(static), recording)
    assert {finding.kind for finding in page.findings} <= {"tame motion"}
    assert "36 of 36" in page.recordings[0].excitation  # lengths are known


def test_wrong_arguments(arm: jc.CSLC, clean: jc.Recording) -> None:
    two = jc.Recording(clean.time, clean.position[:, :2], clean.torque[:, :2])
    with pytest.raises(ValueError, match="recording 1: has 2 joints, 'robot' has 3"):
        jc.check(arm, two)
    with pytest.raises(ValueError, match="2 names for 1 recordings; expected one each"):
        jc.check(arm, clean, ["a", "b"])


URDF = """<robot name="bar"> <link name="floor"/> <link name="arm"> <inertial>
  <origin xyz="0.5 0 0"/> <mass value="2"/>
  <inertia ixx="0.1" iyy="0.2" izz="0.2" ixy="0" ixz="0" iyz="0"/> </inertial> </link>
<joint name="shoulder" type="revolute"> <parent link="floor"/> <child link="arm"/>
  <axis xyz="0 1 0"/> <limit lower="-1" upper="1.5" velocity="2.5" effort="30"/> </joint>
</robot>"""


def test_the_command_and_limits_of_a_urdf(tmp_path: Path) -> None:
    robot, log = tmp_path / "bar.urdf", tmp_path / "log.csv"
    robot.write_text(URDF)
    network = jc.derive(jc.load_robot(robot), lengths="numeric")
    (limits,) = network.robot.joint_limits
    assert (limits.low, limits.high, limits.speed, limits.torque) == (-1.0, 1.5, 2.5, 30.0)
    time = 0.004 * np.arange(2000)
    q, qd, qdd = (values[:, :1] for values in motion(time))
    k = np.asarray(network.coefficients_from(network.robot.links or (), viscous=[1.0], dry=[1.0]))
    torque = np.asarray(network.torque(k, q, qd, qdd))
    torque = torque + 0.02 * np.random.default_rng(0).standard_normal(torque.shape)
    jc.save_recording(jc.Recording(1e3 * time, q, torque), log)
    result = run("check", robot, log)
    assert result.exit_code == 1, result.output
    assert "shoulder" in result.output and "2.5" in result.output
    assert "positions in rad, speeds in rad/s, torques in N m\n" in result.output
    assert "time is in milliseconds" in result.output
    assert run("check", robot, log, "--between", "one").exit_code == 2

    jc.save_recording(jc.Recording(time, q, torque), log)
    for option, setting in (("--between", "50,60"), ("--decimate", "1000"), ("--period", "5")):
        left = run("check", robot, log, option, setting)
        assert left.exit_code == 2
        assert f"{log}, {option} {setting} of 2000 samples in 7.996 s: " in left.stderr
        assert "expected" in left.stderr
    clean = run("check", robot, log)
    assert clean.exit_code == 0, clean.output
    assert "nothing looks wrong" in clean.output

    jc.save_recording(jc.Recording(time, q, np.roll(torque, 10, axis=0)), log)
    late = run("identify", robot, log, "-o", tmp_path / "out", "--no-systematic")
    assert late.exit_code == 0, f"{late.output} {late.exception}"
    assert "torques fit the motion best 40" in late.output
    mended = run(
        "identify", robot, log, "-o", tmp_path / "out", "--no-systematic", "--torque-lag", "0.04"
    )
    assert "torque lag 40 ms" in mended.output and "torques fit" not in mended.output


def test_one_wrong_time_stamp_takes_no_memory(arm: jc.CSLC, clean: jc.Recording) -> None:
    """Nothing is filled in between the epoch and today; the longest part is checked instead."""
    epoch = 1.7e9 + clean.time
    epoch[0] = 0.0
    tracemalloc.start()
    findings = jc.check(arm, changed(clean, time=epoch)).findings
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert [finding.kind for finding in findings] == ["gap"]
    start, end = (float(x) for x in re.findall(r"--between (\S+),(\S+) ", findings[0].remedy)[0])
    assert start <= epoch[1] < epoch[-1] - 1e-3 < end
    assert peak < 1e8


@pytest.mark.parametrize("samples", [30, 100, 150])
def test_too_few_samples_are_called_that_and_nothing_else(
    arm: jc.CSLC, clean: jc.Recording, samples: int
) -> None:
    findings = jc.check(arm, clean.rows(slice(samples))).findings
    assert [finding.kind for finding in findings] == ["motion"]
    assert "too short" in findings[0].cause


def test_a_short_recording_has_no_lag(tmp_path: Path) -> None:
    """The log of an example is on time; coefficients of 2.4 s of it follow any shift."""
    assert run("example", "ur5", "-o", str(tmp_path / "arm")).exit_code == 0
    robot = jc.load_robot(tmp_path / "arm" / "ur5.urdf")
    log = jc.load_recording(tmp_path / "arm" / "train.csv")
    found = jc.check(jc.derive(robot, lengths="numeric"), log.rows(slice(300))).findings
    assert "torque lag" not in {one.kind for one in found}


def test_a_short_recording_has_no_cause_but_too_little_motion(tmp_path: Path) -> None:
    """Its held-out errors are large, and any change of a sign makes them others by chance."""
    made = jc.examples.write_example("ur5", tmp_path / "arm")
    robot = jc.load_robot(made.robot)
    log = jc.load_recording(made.train, robot.joint_names)
    found = jc.check(jc.derive(robot, lengths="numeric"), log.rows(slice(375))).findings
    assert [one.kind for one in found] == ["tame motion"]


def test_a_mass_that_no_body_has_is_named(tmp_path: Path) -> None:
    made = jc.examples.write_example("ur5", tmp_path / "arm")
    text = made.robot.read_text("utf-8").replace('mass value="', 'mass value="-')
    made.robot.write_text(text, "utf-8")
    result = run("check", str(made.robot), str(made.train))
    assert result.exit_code == 1
    assert "warning: robot file: " in result.output and "note: " not in result.output
    assert "expected a mass of zero or more" in result.output


def test_one_absurd_torque_is_named_however_long_the_recording(
    arm: jc.CSLC, clean: jc.Recording
) -> None:
    torque = np.array(clean.torque)
    rows = slice(2000, 2001)
    torque[rows, 1] = 1e5
    twice = changed(
        clean,
        time=INTERVAL * np.arange(2 * SAMPLES),
        position=np.concatenate([clean.position, clean.position[::-1]]),
        torque=np.concatenate([torque, clean.torque[::-1]]),
    )
    found = list(Outliers.of(twice).findings(twice, arm.output_names))
    assert [(one.kind, one.joint) for one in found] == [("outliers", "joint 2")]
    mended = changed(twice, torque=np.concatenate([clean.torque, clean.torque[::-1]]))
    assert not list(Outliers.of(mended).findings(mended, arm.output_names))


def test_a_torque_that_was_not_recorded_is_no_other_robot(
    arm: jc.CSLC, clean: jc.Recording
) -> None:
    findings = jc.check(arm, with_column(clean, "torque", 2, 0.0)).findings
    assert (findings[0].kind, findings[0].joint) == ("constant torque", "joint 3")
    assert findings[0].cause == "the torque of joint 3 was not recorded"
    assert {one.kind for one in findings} <= {"constant torque", "tame motion"}


NAMED_ARM = """[links]
motor_inertia = false
[[joint]]
name = "waist"
d = 0.3
[[joint]]
name = "arm"
alpha = "-pi/2"
a = 0.1
[[joint]]
name = "fore arm"
a = 0.4
"""


@pytest.mark.parametrize("header", ["names", "numbers"])
def test_the_remedy_of_swapped_joints_mends_them(
    clean: jc.Recording, header: str, tmp_path: Path
) -> None:
    """Return whether the log names its joints."""
    file = tmp_path / "arm.toml"
    file.write_text(NAMED_ARM)
    robot = jc.load_robot(file)
    names = robot.joint_names
    order = [0, 2, 1]
    columns = names if header == "names" else ("1", "2", "3")
    stems = ("q_", "tau_") if header == "names" else ("position_", "torque_")
    titles = ["time", *(stem + name for stem in stems for name in columns)]
    table = np.c_[clean.time, clean.position[:, order], clean.torque[:, order]]
    log = tmp_path / "log.csv"
    np.savetxt(log, table, delimiter=",", header=",".join(titles), comments="")
    network = jc.derive(robot, lengths="numeric")
    swap = jc.check(network, jc.load_recording(log, robot.joint_names)).findings[0]
    assert swap.kind == "swapped joints"
    mapping = tmp_path / "mapping.toml"
    mapping.write_text(swap.remedy.removesuffix(" in a mapping file (--columns)"))
    mended = jc.load_recording(log, robot.joint_names, columns=mapping)
    np.testing.assert_allclose(mended.torque, clean.torque)
    np.testing.assert_allclose(mended.position, clean.position)
