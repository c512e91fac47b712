"""The study of real arms: rows of a small arm, the page, resumption, and what is missing."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from mujoco import sysid

import jaxcslc as jc
from scripts.studies import stored
from scripts.studies.real_robots import (
    arms,
    hysteresis,
    intervals,
    load_friction,
    pre_sliding,
    rests,
    simulation_fit,
    spacings,
    study,
)
from scripts.studies.real_robots.methods import Model
from scripts.studies.real_robots.tables import tables


def pendulum(folder: Path) -> arms.Arm:
    """Exact motion of a pendulum, at 200 Hz."""
    del folder
    robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    network = jc.derive(robot, lengths="numeric")
    t = 0.005 * np.arange(600)[:, None]
    q, qd, qdd = np.sin(3 * t), 3 * np.cos(3 * t), -9 * np.sin(3 * t)
    torque = np.asarray(network.torque(np.array([0.5, 0.3, -0.1, 0.2, 0.1]), q, qd, qdd))
    recording = jc.Recording(t[:, 0], q, torque)
    return arms.Arm(robot, recording, {"again": recording}, "a pendulum", "all is fitted")


def test_rows_page_and_resumption(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    calls: list[Path] = []

    def read(folder: Path) -> arms.Arm:
        calls.append(folder)
        return pendulum(folder)

    monkeypatch.setitem(arms.READERS, "pendulum", ("pendulum", read))  # type: ignore[arg-type]
    (tmp_path / "pendulum").mkdir()
    monkeypatch.setitem(study.SECONDS, "pendulum", 1.0)
    monkeypatch.setattr(stored, "RESULTS", tmp_path)
    arguments = ["--data", str(tmp_path), "--arms", "pendulum", "--methods", "usual"]
    arguments += ["-o", str(tmp_path / "out"), "--store"]
    assert study.main(arguments) == study.main(arguments) == 0
    assert len(calls) == 1
    assert "usual pipeline, 20 Hz, OLS" in capsys.readouterr().out
    rows = stored.table("real_robots/pendulum, again")
    (row,) = (row for row in rows if row[0] == "usual pipeline, 20 Hz, WLS")
    error = float(row[1].split("/")[0].strip(" *"))
    assert 0.0 < error < 5.0  # the ends of the filter, and a 20 Hz low pass of 3 rad/s


def test_the_least_error_is_bold() -> None:
    row: dict[str, Any] = {"recording": "B", "seconds": 1.0, "note": "", "share": [50.0, 60.0]}
    rows = [
        row | {"method": "first", "all": [10.0, 3.0], "judged": [5.0, 2.0]},
        row | {"method": "second", "all": [9.0, 3.02], "judged": [6.0, 2.0]},
    ]
    _, first, second, _ = tables([{"arm": "arm", "rows": rows}])["arm, B"]
    assert first == ["first", "10.0 / 5.0", "**3.0** / 2.0", "6.5 / 3.5", "1"]
    assert second[:3] == ["second", "**9.0** / 6.0", "**3.0** / 2.0"]


def test_errors_are_parts_of_the_raw_torque() -> None:
    arm = pendulum(Path())
    network = jc.derive(arm.robot, lengths="numeric")
    settings = jc.Settings()
    model = Model("zero", network, np.zeros(network.size), settings, 0.0, "")
    errors = study.errors_of(model, settings, arm.training)
    np.testing.assert_allclose(errors["all"], 100.0)
    np.testing.assert_allclose(errors["judged"], 100.0)


def test_friction_of_a_joint_that_stands_still() -> None:
    """The pendulum swings twice and stops: of its dry friction 60 % stay, half is nearest."""
    arm = pendulum(Path())
    t = 0.005 * np.arange(800)[:, None]
    # Quintic from -1 to 1 in a second, back, and there again.
    whole = np.minimum(np.floor(t), 2.0)
    s, sign = np.minimum(t - whole, 1.0), 1.0 - 2.0 * (whole % 2)
    q = sign * (2.0 * s**3 * (10.0 - 15.0 * s + 6.0 * s**2) - 1.0)
    qd = sign * 60.0 * s**2 * (1.0 - s) ** 2
    qdd = sign * 120.0 * s * (1.0 - s) * (1.0 - 2.0 * s)
    network = jc.derive(arm.robot, lengths="numeric")
    torque = np.asarray(network.torque(np.array([0.5, 0.3, -0.1, 0.2, 0.4]), q, qd, qdd))
    torque = torque + np.where(t > 3.0, 0.6 * 0.4, 0.0)
    recording = jc.Recording(t[:, 0], q, torque)
    arm = arm._replace(training=recording, tests={"again": recording})
    rows = {row[2]: float(row[3]) for row in rests.lines_of("pendulum", arm)}
    assert 20.0 < rows["at rest [%]"] < 30.0
    others = {*rows} - {"at rest [%]", "mean of before and after"}
    assert rows["mean of before and after"] < min(rows[name] for name in others)


def test_spacings_of_exact_motion_leave_nothing() -> None:
    rows = spacings.rows_of("pendulum", pendulum(Path()))
    assert [row[2] for row in rows][1:] == [*(f"every {n}" for n in (1, 2, 3, 6)), "every auto (1)"]
    assert all(float(row[3]) == float(row[-1]) < 1.0 for row in rows)


def test_the_usual_pipeline_is_judged_as_it_is_best() -> None:
    """Friction at rest by the sign of velocity too, where that is nearer."""
    arm = pendulum(Path())
    network = jc.derive(arm.robot, lengths="numeric")
    settings = jc.Settings()
    k = np.array([0.5, 0.3, -0.1, 0.2, 0.1])
    errors = [
        study.judged(Model(method, network, k, settings, 0.0, ""), settings, arm.training)["all"][0]
        for method in ("usual pipeline, 20 Hz, OLS", "least-squares")
    ]
    assert errors[0] <= errors[1]


def test_missing_recordings_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--data", str(tmp_path), "--arms", "KUKA KR300", "-o", str(tmp_path / "out")]
    with pytest.raises(SystemExit):
        study.main(arguments)
    assert "no such folder; expected the recordings of a KUKA KR300" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        study.main(["--arms", "R2D2"])


@pytest.fixture
def loaded() -> arms.Arm:
    """The pendulum with 20 % more friction for each newton metre of load, and noise."""
    arm = pendulum(Path())
    rng = np.random.default_rng(0)

    def with_load(recording: jc.Recording) -> jc.Recording:
        q = np.asarray(recording.position)
        speed = np.sign(np.cos(3 * np.asarray(recording.time)))[:, None]
        rigid = np.asarray(recording.torque) - 0.2 * np.gradient(q, 0.005, axis=0) - 0.1 * speed
        torque = np.asarray(recording.torque) + 0.2 * speed * np.abs(rigid)
        return jc.Recording(recording.time, q, torque + 0.01 * rng.normal(size=q.shape))

    parts = {"again": with_load(arm.training), "once more": with_load(arm.training)}
    return arm._replace(training=with_load(arm.training), tests=parts)


def test_load_dependent_friction_is_seen(loaded: arms.Arm) -> None:
    held_out, again, _, coefficient = load_friction.lines_of("pendulum", loaded, None)
    assert float(held_out[2]) < -20 and float(again[2]) < -20
    assert abs(float(coefficient[2].split(" ± ")[0]) - 0.2) < 0.02


def test_torque_hysteresis_is_seen() -> None:
    """The pendulum loses torque to a state that its rigid torque drives; and noise."""
    arm = pendulum(Path())
    rng = np.random.default_rng(2)

    def with_loss(recording: jc.Recording) -> jc.Recording:
        q = np.asarray(recording.position)
        sign = np.sign(np.cos(3 * np.asarray(recording.time)))[:, None]
        rigid = np.asarray(recording.torque) - 0.2 * np.gradient(q, 0.005, axis=0) - 0.1 * sign
        state = np.asarray(
            jc.friction.contact_states(rigid, 0.1 * np.ptp(rigid, axis=0), np.zeros(1))
        )
        torque = np.asarray(recording.torque) + 0.3 * state
        return jc.Recording(recording.time, q, torque + 0.01 * rng.normal(size=q.shape))

    arm = arm._replace(training=with_loss(arm.training), tests={"again": with_loss(arm.training)})
    held_out, again, width = hysteresis.lines_of("pendulum", arm)
    assert float(held_out[2]) < -20 and float(again[2]) < -20
    assert width[2] == "0.1"


def test_friction_that_yields_is_seen() -> None:
    """The pendulum's dry friction of 0.1 N m in place of its sign, over 0.1 rad; and noise."""
    arm = pendulum(Path())
    time, q = np.asarray(arm.training.time), np.asarray(arm.training.position)
    sign = np.sign(np.cos(3 * time))[:, None]
    w = np.asarray(jc.friction.contact_states(q, np.array([0.1]), np.zeros(1)))
    noise = 0.005 * np.random.default_rng(0).normal(size=q.shape)
    torque = np.asarray(arm.training.torque) + 0.1 * (w - sign) + noise
    recording = jc.Recording(time, q, torque)
    arm = arm._replace(training=recording, tests={"again": recording})
    held_out, again, length = pre_sliding.lines_of("pendulum", arm)
    assert held_out[2].startswith("-") and float(again[2]) < -20
    assert 60 < float(length[2]) < 130  # the low pass blurs reversals


def test_coefficients_of_a_simulated_model_are_its_inverse_dynamics() -> None:
    """What MuJoCo's toolbox searches for, as coefficients: torques of the compiled model."""
    arm = pendulum(Path())
    patterns = jc.Settings(jc.Preparation(threshold_fraction=0.0)).patterns(arm.training)
    network = jc.derive(arm.robot, lengths="numeric")
    links = simulation_fit.equal_bodies(arm.robot, 2.0, patterns)
    spec = simulation_fit.arm_model(arm.robot, links, patterns)
    parameters = simulation_fit.start_parameters(spec, spec.compile(), network, patterns)
    assert parameters.size == 13  # ten of the body, motor inertia, viscous and dry friction
    parameters["link_1_inertia"].value[:] += 0.1 * np.arange(10)
    parameters["joint_1 frictionloss"].value[:] = 0.0  # a constraint of the solver
    model = sysid.apply_param_modifiers(parameters, spec)
    k = simulation_fit.coefficients_of(network, model, parameters)
    data = mujoco.MjData(model)
    for state in np.random.default_rng(0).normal(size=(5, 3, 1)):
        data.qpos[:], data.qvel[:], data.qacc[:] = state
        mujoco.mj_inverse(model, data)
        assert np.allclose(network.torque(k, *state), data.qfrc_inverse, rtol=1e-9)


def test_fits_of_the_same_arm_differ_by_their_errors() -> None:
    arm = pendulum(Path())
    rng = np.random.default_rng(1)
    noisy = [
        jc.Recording(part.time, part.position, part.torque + 0.02 * rng.normal(size=(600, 1)))
        for part in [arm.training] * 3
    ]
    deviations = intervals.deviations_of(
        arm._replace(training=noisy[0], tests={"second": noisy[1], "third": noisy[2]})
    )
    for kind in intervals.KINDS:
        assert deviations[kind].shape == (15,)
        assert np.median(deviations[kind]) < 2.0


def test_gears_of_the_tx40(tmp_path: Path) -> None:
    """Power is the same on both sides; the motor of joint 6 turns with joint 5."""
    motor, torque = np.random.default_rng(0).normal(size=(2, 50, 6))
    for name, table in (("pos_read_data.csv", motor), ("curr_data.csv", torque)):
        np.savetxt(tmp_path / name, table, delimiter=",", header="a,b,c,d,e,f")
    recording = arms.tx40_recording(tmp_path)
    steps = np.diff(recording.position, axis=0)
    assert np.allclose(
        np.sum(recording.torque[1:] * steps, axis=1),
        np.sum(torque[1:] * np.diff(motor, axis=0), axis=1),
    )
    assert np.allclose(np.diff(motor[:, 5]), 32 * (steps[:, 4] + steps[:, 5]))
