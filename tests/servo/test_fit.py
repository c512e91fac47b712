"""Fits of servo drives: to motion of MuJoCo's position actuators, and to our own simulation."""

import dataclasses
import math
from pathlib import Path

import mujoco
import numpy as np
import pytest
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc.manipulator import LinkParameters
from jaxcslc.servo import (
    ServoDrive,
    ServoFit,
    ServoRecording,
    identify_servo,
    simulate,
)
from tests.servo.arms import arm, arm_xml, held_sines


TIME = np.arange(0.0, 30.0, 0.02)
TICK = 2.0 * np.pi / 4096
WITHOUT_STRIBECK = ("gain", "damping", "delay", "offset", "armature", "coulomb")
TRUE = ServoDrive(
    12.0, 0.8, delay=0.03, offset=0.08, armature=0.02, coulomb=0.1, load_friction=0.15
)


def rounded(position: Float[np.ndarray, "samples joints"]) -> Float[np.ndarray, "samples joints"]:
    return TICK * np.round(position / TICK)


def commands(joints: int, time: Float[np.ndarray, " samples"] = TIME) -> np.ndarray:
    """Return slow large motion with faster motion on top, which separates delay and damping."""
    rates = 1.0 + 0.37 * np.arange(joints)
    fast = 7.0 + 2.1 * np.arange(joints)
    return held_sines(time, joints, 0.6) + 0.08 * np.sin(time[:, None] * fast * rates**0.2)


def recorded(
    robot: jc.Manipulator, drives: list[ServoDrive], command: Float[np.ndarray, "samples joints"]
) -> ServoRecording:
    position = simulate(robot, drives, TIME, command, command[0], longest_step=0.001)
    return ServoRecording(TIME, rounded(position), command)


def error(fit: ServoFit, joint: int, name: str, true: float) -> float:
    """Return the error of an estimate in its standard errors."""
    parameter = fit.parameter(joint, name)
    assert parameter.is_determined, name
    return abs(parameter.value - true) / parameter.error


def test_finds_the_servos_of_mujoco(tmp_path: Path) -> None:
    """Position actuators of MuJoCo with armature, friction and 40 ms of delay."""
    model = mujoco.MjModel.from_xml_string(arm_xml(coulomb=0.12, armature=0.02, step=0.001))
    data = mujoco.MjData(model)
    command = commands(3)
    data.qpos[:] = command[0]
    position = [data.qpos.copy()]
    for n in range(20 * (len(TIME) - 1)):
        data.ctrl[:] = command[max(0, n - 40) // 20]
        mujoco.mj_step(model, data)
        if (n + 1) % 20 == 0:
            position.append(data.qpos.copy())
    recording = ServoRecording(TIME, rounded(np.array(position)), command)
    fit = identify_servo(arm(tmp_path), recording, estimated=WITHOUT_STRIBECK, mass_error=0.0)
    for drive in fit.drives:
        assert drive.gain == pytest.approx(12.0, rel=0.05)
        assert drive.damping == pytest.approx(0.8, rel=0.05)
        assert drive.armature == pytest.approx(0.02, rel=0.15)
        assert drive.coulomb == pytest.approx(0.12, rel=0.1)
        assert drive.delay == pytest.approx(0.04, abs=0.003)
        assert drive.offset == pytest.approx(0.0, abs=0.03)
    assert fit.position_error([recording]).max() < 3.0
    assert fit.units == "torque"


@pytest.mark.parametrize("is_signed", [True, False])
def test_currents_read_the_torque(tmp_path: Path, is_signed: bool) -> None:
    """Of MuJoCo's actuators, with a gain of 2.5 per N m and an idle current."""
    model = mujoco.MjModel.from_xml_string(arm_xml(coulomb=0.12, armature=0.02, step=0.001))
    data = mujoco.MjData(model)
    command = commands(3)[:600]
    data.qpos[:] = command[0]
    position: list[np.ndarray] = []
    torque: list[np.ndarray] = []
    for row in command:
        data.ctrl[:] = row
        mujoco.mj_forward(model, data)
        position.append(data.qpos.copy())
        torque.append(data.actuator_force.copy())
        mujoco.mj_step(model, data, 20)
    current = 2.5 * np.array(torque)
    current = current if is_signed else 0.1 + np.abs(current)
    recording = ServoRecording(TIME[:600], rounded(np.array(position)), command, current=current)
    known = {"gain": 12.0, "damping": 0.8}
    fit = identify_servo(
        arm(tmp_path), recording, known=known, estimated=("delay", "armature", "coulomb")
    )
    for gain in fit.currents:
        assert gain.is_signed == is_signed
        assert gain.is_reading
        assert gain.value == pytest.approx(2.5, rel=0.1)
        assert gain.explained > 0.8


@pytest.fixture(scope="module")
def two_loads(tmp_path_factory: pytest.TempPathFactory) -> tuple[jc.Manipulator, ServoFit, float]:
    """A robot whose file has 25 % too much mass, with and without a known payload."""
    robot = arm(tmp_path_factory.mktemp("arm"))
    payload = LinkParameters(0.25, np.array([0.1, 0.0, 0.0]), 1e-5 * np.eye(3))
    assert robot.links is not None
    *others, last = robot.links
    loaded = dataclasses.replace(
        robot, links=(*others, jc.manipulator.fixed_together([last, payload]))
    )
    command = commands(3)
    given = [recorded(x, [TRUE] * 3, command) for x in (robot, loaded)]
    heavy = dataclasses.replace(
        robot,
        links=tuple(
            LinkParameters(1.25 * x.mass, x.centre_of_gravity, 1.25 * x.inertia)
            for x in robot.links
        ),
    )
    names = (*WITHOUT_STRIBECK, "load_friction")
    fit = identify_servo(heavy, given, payloads=[None, payload], estimated=names)
    return robot, fit, fit.position_error(given, [None, payload]).max()


def test_a_known_payload_gives_the_unit_of_torque(
    two_loads: tuple[jc.Manipulator, ServoFit, float],
) -> None:
    robot, fit, worst = two_loads
    assert robot.links is not None
    assert fit.robot.links is not None
    assert fit.robot.links[0].mass == pytest.approx(robot.links[0].mass, rel=0.03)
    for joint in range(3):
        for name in ("gain", "damping", "armature", "coulomb"):
            parameter = fit.parameter(joint, name)
            assert parameter.value == pytest.approx(getattr(TRUE, name), rel=0.12), name
            assert error(fit, joint, name, getattr(TRUE, name)) < 4.0
        assert fit.drives[joint].delay == pytest.approx(0.03, abs=0.002)
        assert fit.drives[joint].offset == pytest.approx(0.08, abs=0.02)
        assert fit.drives[joint].load_friction == pytest.approx(0.15, abs=0.05)
    assert worst < 2.0


def test_without_a_known_mass_torques_have_its_error(tmp_path: Path) -> None:
    robot, command = arm(tmp_path), commands(3)
    recording = recorded(robot, [TRUE] * 3, command)
    names = (*WITHOUT_STRIBECK, "load_friction")
    exact = identify_servo(robot, recording, estimated=names, mass_error=0.0)
    vague = identify_servo(robot, recording, estimated=names, mass_error=0.2)
    none = identify_servo(robot, recording, estimated=names, mass_error=math.inf)
    assert exact.parameter(0, "gain").error < 0.05 * TRUE.gain
    assert vague.parameter(0, "gain").error == pytest.approx(
        math.hypot(0.2 * vague.drives[0].gain, exact.parameter(0, "gain").error), rel=1e-6
    )
    assert vague.parameter(0, "delay") == exact.parameter(0, "delay")
    assert none.units == "gain"
    assert not none.parameter(0, "gain").is_determined
    ratio = none.parameter(0, "damping/gain")
    assert ratio.unit == "s"
    assert ratio.value == pytest.approx(TRUE.damping / TRUE.gain, rel=0.03)


def test_a_gain_that_no_load_determines_is_refused() -> None:
    """A joint about a vertical axis, with links much lighter than its motor."""
    robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)])
    link = LinkParameters(0.1, np.array([0.05, 0.0, 0.0]), 1e-5 * np.eye(3))
    robot = dataclasses.replace(robot, links=(link,))
    fit = identify_servo(robot, recorded(robot, [TRUE], commands(1)), estimated=WITHOUT_STRIBECK)
    gain = fit.parameter(0, "gain")
    assert not gain.is_determined
    assert (gain.low, gain.high) == (0.0, math.inf)
    assert fit.units == "gain"
    assert fit.parameter(0, "coulomb/gain").value == pytest.approx(0.1 / 12.0, rel=0.05)
    named = {pair.parameters: pair for pair in fit.confounded}
    assert "known mass" in named[("gain",)].remedy
    assert "zero has no effect" in named[("offset",)].reason


def test_known_gains_are_kept(tmp_path: Path) -> None:
    """And then give the scale of the masses, from gravity."""
    robot, command = arm(tmp_path), commands(3)
    recording = recorded(robot, [TRUE] * 3, command)
    assert robot.links is not None
    light = dataclasses.replace(
        robot,
        links=tuple(
            LinkParameters(0.8 * x.mass, x.centre_of_gravity, 0.8 * x.inertia) for x in robot.links
        ),
    )
    names = ("delay", "offset", "armature", "coulomb", "load_friction")
    fit = identify_servo(light, recording, known={"gain": 12.0, "damping": 0.8}, estimated=names)
    assert [drive.gain for drive in fit.drives] == [12.0] * 3
    assert not any({"gain", "damping"} & set(pair.parameters) for pair in fit.confounded)
    assert fit.robot.links is not None
    assert fit.robot.links[0].mass == pytest.approx(robot.links[0].mass, rel=0.03)
    assert fit.drives[0].armature == pytest.approx(0.02, rel=0.1)


def test_finds_an_end_of_travel(tmp_path: Path) -> None:
    robot, command = arm(tmp_path), commands(3)
    stopped = dataclasses.replace(TRUE, high=0.45)
    recording = recorded(robot, [TRUE, stopped, TRUE], command)
    fit = identify_servo(robot, recording, estimated=WITHOUT_STRIBECK)
    assert fit.drives[1].high == pytest.approx(0.45, abs=TICK)
    assert math.isinf(fit.drives[0].high)
    assert [note.split(" at ")[0] for note in fit.notes] == ["elbow leans on an end of travel"]
    assert fit.position_error([recording]).max() < 4.0


def test_slow_motion_confounds_delay_and_damping(tmp_path: Path) -> None:
    robot = arm(tmp_path)
    slow = held_sines(TIME, 3, 0.5)[::4].repeat(4, axis=0) * 0.0
    slow += 0.5 * np.sin(0.4 * TIME[:, None])
    fit = identify_servo(robot, recorded(robot, [TRUE] * 3, slow), estimated=WITHOUT_STRIBECK)
    fast = identify_servo(
        robot, recorded(robot, [TRUE] * 3, commands(3)), estimated=WITHOUT_STRIBECK
    )

    def pairs(of: ServoFit) -> set[tuple[str, ...]]:
        return {pair.parameters for pair in of.confounded if pair.joint == 1}

    assert ("delay", "damping") in pairs(fit)
    assert ("delay", "damping") not in pairs(fast)


@pytest.mark.parametrize("coulomb", [0.01, 0.05])
def test_intervals_hold_whichever_of_dead_zone_and_friction_it_is(coulomb: float) -> None:
    """Small motion of an unloaded joint cannot tell a dead zone from Coulomb friction."""
    upright = dataclasses.replace(
        jc.Manipulator.from_modified_dh([(0, 0, 0, 0)]),
        links=(LinkParameters(0.3, np.array([0.15, 0.0, 0.01]), np.diag([2e-4, 1e-3, 1e-3])),),
    )
    drive = ServoDrive(12.0, 0.8, delay=0.03, armature=0.015, coulomb=coulomb, dead_zone=3 * TICK)
    narrow = (0.05 * np.sin(2.0 * TIME) + 0.01 * np.sin(9.0 * TIME))[:, None]
    names = ("gain", "damping", "delay", "armature", "coulomb", "dead_zone")
    fit = identify_servo(upright, recorded(upright, [drive], narrow), estimated=names)
    assert ("dead_zone", "coulomb") in {pair.parameters for pair in fit.confounded}
    for name, true in (("coulomb/gain", coulomb / 12.0), ("dead_zone", 3 * TICK)):
        parameter = fit.parameter(0, name)
        assert parameter.low <= true <= parameter.high


def test_refuses_what_does_not_belong_together(tmp_path: Path) -> None:
    robot = arm(tmp_path)
    recording = ServoRecording(TIME, np.zeros((TIME.size, 2)), np.zeros((TIME.size, 2)))
    with pytest.raises(ValueError, match="recording 1 has 2 joints; expected 3"):
        identify_servo(robot, recording)
    three = ServoRecording(TIME, np.zeros((TIME.size, 3)), np.zeros((TIME.size, 3)))
    with pytest.raises(ValueError, match="'speed' cannot be estimated"):
        identify_servo(robot, three, estimated=("speed",))
    with pytest.raises(ValueError, match="'speed' is no parameter"):
        identify_servo(robot, three, known={"speed": 1.0})
    with pytest.raises(ValueError, match="gain has 2 values; expected 1 or 3"):
        identify_servo(robot, three, known={"gain": [1.0, 2.0]})
    with pytest.raises(ValueError, match="1 payloads; expected 2"):
        identify_servo(robot, [three, three], payloads=[None])
    with pytest.raises(ValueError, match="no recordings"):
        identify_servo(robot, [])
