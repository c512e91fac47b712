"""Simulated servo arms, against closed solutions and MuJoCo."""

import dataclasses
from pathlib import Path

import mujoco
import numpy as np
import pytest
from jaxtyping import Float
from scipy.linalg import expm

import jaxcslc as jc
from jaxcslc.manipulator import LinkParameters
from jaxcslc.servo import ServoDrive, Table, simulate
from jaxcslc.servo._simulation import drive_rows, inverse_dynamics, joint_loads, simulate_joint
from tests.servo.arms import arm, arm_xml, held_sines


TIME = np.arange(0.0, 4.0, 0.02)
FINE = 2e-4  # s, a step of which first-order time stepping errs by less than:
FIRST_ORDER = 5e-4  # rad, for motions of 0.5 rad
SOFT_FRICTION = 1.5e-3  # rad: MuJoCo's friction creeps at rest, ours does not
DRIVE = ServoDrive(gain=12.0, damping=0.8, armature=0.01)


def pendulum(*, gravity: float = 0.0) -> jc.Manipulator:
    """A rod of 0.5 kg on a horizontal axis, its centre 0.2 m away."""
    robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0.0, -gravity, 0.0))
    link = LinkParameters(0.5, np.array([0.2, 0.0, 0.0]), np.diag([1e-4, 2e-3, 2e-3]))
    return dataclasses.replace(robot, links=(link,))


INERTIA = 2e-3 + 0.5 * 0.2**2


def in_mujoco(
    xml: str, command: Float[np.ndarray, "samples joints"], delay: float = 0.0
) -> Float[np.ndarray, "samples joints"]:
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    data.qpos[:] = command[0]
    out = [data.qpos.copy()]
    steps = round((TIME[1] - TIME[0]) / model.opt.timestep)
    late = round(delay / model.opt.timestep)
    for n in range(steps * (len(TIME) - 1)):
        data.ctrl[:] = command[max(0, n - late) // steps]
        mujoco.mj_step(model, data)
        if (n + 1) % steps == 0:
            out.append(data.qpos.copy())
    return np.array(out)


def test_torque_and_mass_matrix_are_those_of_mujoco(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    robot = arm(tmp_path)
    model = mujoco.MjModel.from_xml_string(arm_xml(armature=0.0))
    data = mujoco.MjData(model)
    q, v, a = rng.uniform(-2.0, 2.0, (3, 20, 3))
    torque, mass = inverse_dynamics(robot, q, v, a)
    for n in range(20):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[n], v[n], a[n]
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose(torque[n], data.qfrc_inverse, atol=1e-9)
        column = np.zeros(3)
        for i, unit in enumerate(np.eye(3)):
            mujoco.mj_mulM(model, data, column, unit)
            np.testing.assert_allclose(mass[n, :, i], column, atol=1e-12)


def test_a_linear_servo_responds_to_a_step_as_the_matrix_exponential() -> None:
    drive = dataclasses.replace(DRIVE, viscous=0.1, integral=5.0)
    command = np.full((TIME.size, 1), 0.5)
    got = simulate(pendulum(), [drive], TIME, command, np.zeros(1), longest_step=FINE)[:, 0]
    J = INERTIA + drive.armature
    # Position, velocity and integral of the error; the command is the fourth state.
    A = np.zeros((4, 4))
    A[0, 1] = 1.0
    A[1] = np.array([-drive.gain, -drive.damping - drive.viscous, drive.integral, drive.gain]) / J
    A[2, [0, 3]] = -1.0, 1.0
    want = np.array([(expm(A * t) @ [0.0, 0.0, 0.0, 0.5])[0] for t in TIME])
    np.testing.assert_allclose(got, want, atol=2.0 * FIRST_ORDER)  # after a jump of the command


def test_coulomb_friction_takes_as_much_from_every_half_swing() -> None:
    """An undamped spring with Coulomb friction F loses 2 F / K of amplitude every half period."""
    drive = ServoDrive(gain=12.0, armature=0.01, coulomb=0.12)
    time = np.arange(0.0, 3.0, 0.001)
    got = simulate(pendulum(), [drive], time, np.zeros((time.size, 1)), [0.1], longest_step=5e-5)
    turns = np.abs(got[1:-1, 0][np.diff(np.sign(np.diff(got[:, 0]))) != 0])
    np.testing.assert_allclose(turns[:4], 0.1 - 0.02 * np.arange(1, 5), atol=1e-3)
    at_rest = got[-500:, 0]
    assert np.ptp(at_rest) == 0.0, "friction holds a joint exactly"
    assert abs(at_rest[0]) <= drive.coulomb / drive.gain


@pytest.mark.parametrize("delay", [0.0, 0.03])
def test_moves_as_position_actuators_of_mujoco(tmp_path: Path, delay: float) -> None:
    command = held_sines(TIME, 3)
    want = in_mujoco(arm_xml(step=FINE), command, delay)
    drives = [dataclasses.replace(DRIVE, delay=delay)] * 3
    got = simulate(arm(tmp_path), drives, TIME, command, command[0], longest_step=FINE)
    assert np.ptp(want, axis=0).min() > 0.3
    np.testing.assert_allclose(got, want, atol=FIRST_ORDER)


def test_moves_as_mujoco_with_friction(tmp_path: Path) -> None:
    command = held_sines(TIME, 3)
    want = in_mujoco(arm_xml(coulomb=0.15, step=FINE), command)
    drives = [dataclasses.replace(DRIVE, coulomb=0.15)] * 3
    got = simulate(arm(tmp_path), drives, TIME, command, command[0], longest_step=FINE)
    assert np.sqrt(np.mean((got - want) ** 2)) < SOFT_FRICTION


def test_converges_with_the_step(tmp_path: Path) -> None:
    command = held_sines(TIME, 3)
    robot, drives = arm(tmp_path), [DRIVE] * 3

    def error(step: float) -> float:
        got = simulate(robot, drives, TIME, command, command[0], longest_step=step)
        return float(np.abs(got - finest).max())

    finest = simulate(robot, drives, TIME, command, command[0], longest_step=5e-5)
    assert error(1e-3) < 0.6 * error(2e-3) < 0.6 * 0.6 * error(4e-3)


def test_a_joint_alone_moves_as_in_the_arm(tmp_path: Path) -> None:
    """With the loads of the others' motion, which the arm's simulation gives."""
    fine = np.arange(0.0, 4.0, 0.002)
    command = held_sines(TIME, 3)[np.minimum((fine / 0.02 + 1e-9).astype(int), TIME.size - 1)]
    drives = [dataclasses.replace(DRIVE, offset=0.05, load_friction=0.1, coulomb=0.02)] * 3
    robot = arm(tmp_path)
    whole = simulate(robot, drives, fine, command, command[0], longest_step=FINE)
    q = whole - 0.05
    v = np.gradient(q, fine, axis=0)
    loads = joint_loads(robot, q, v, np.gradient(v, fine, axis=0))
    for i in range(3):
        start = np.array([command[0, i], 0.0])
        one = simulate_joint(
            loads[i],
            drive_rows(drives[i : i + 1]),
            fine,
            np.ascontiguousarray(command[:, i]),
            start,
        )
        assert np.sqrt(np.mean((one[0] - whole[:, i]) ** 2)) < 1e-3


def test_limits_of_torque_and_speed() -> None:
    """A saturated servo accelerates at torque limit / inertia, up to the no-load speed."""
    drive = ServoDrive(gain=1e3, damping=0.0, armature=0.01, torque_limit=0.3)
    command = np.full((TIME.size, 1), 1e3)
    got = simulate(pendulum(), [drive], TIME, command, [0.0], longest_step=FINE)[:, 0]
    np.testing.assert_allclose(got, 0.15 / (INERTIA + 0.01) * TIME**2, rtol=1e-3, atol=1e-3)
    limited = dataclasses.replace(drive, speed_limit=2.0)
    got = simulate(pendulum(), [limited], TIME, command, [0.0], longest_step=FINE)[:, 0]
    constant = 2.0 * (INERTIA + 0.01) / 0.3
    np.testing.assert_allclose(
        got, 2.0 * (TIME - constant * (1.0 - np.exp(-TIME / constant))), rtol=1e-3, atol=1e-3
    )


def test_leans_on_its_end_of_travel_and_in_its_dead_zone() -> None:
    drive = ServoDrive(gain=12.0, damping=0.8, armature=0.01, high=0.3)
    command = np.full((TIME.size, 1), 0.5)
    assert simulate(pendulum(), [drive], TIME, command, [0.0])[-1, 0] == pytest.approx(0.3)
    zone = ServoDrive(gain=12.0, damping=3.0, armature=0.01, dead_zone=0.05)
    reached = simulate(pendulum(), [zone], TIME, command, [0.0])[-1, 0]
    assert reached == pytest.approx(0.45, abs=1e-3)


def test_static_friction_holds_more_than_it_brakes() -> None:
    """At rest up to coulomb + static; in motion, coulomb plus the friction of the load."""
    drive = ServoDrive(gain=10.0, damping=0.8, armature=0.01, coulomb=0.1, static=0.1)
    ramp = 0.05 * TIME[:, None]
    got = simulate(pendulum(), [drive], TIME, ramp, [0.0])[:, 0]
    breakaway = 0.2 / 10.0 / 0.05
    assert np.ptp(got[breakaway >= TIME]) == 0.0
    assert got[np.argmax(breakaway + 0.1 < TIME)] > 1e-4
    torque = 0.5 * 0.2 * 9.81  # of gravity on the level rod
    held = ServoDrive(gain=10.0, damping=2.0, armature=0.01, load_friction=0.2)
    up, down = (
        simulate(pendulum(gravity=9.81), [held], TIME, np.zeros((TIME.size, 1)), [start])[-1, 0]
        for start in (-0.3, 0.3)
    )
    for reached, direction in ((up, 1.0), (down, -1.0)):
        load = torque * np.cos(reached)
        assert -10.0 * reached - load == pytest.approx(direction * 0.2 * load, abs=2e-3)


def test_play_delays_a_reversal_by_its_width() -> None:
    """A slow servo crosses the play with the motor alone before the links follow."""
    drive = ServoDrive(gain=20.0, damping=2.0, armature=0.01, coulomb=0.05, play=0.02)
    time = np.arange(0.0, 8.0, 0.02)
    command = 0.3 * np.sin(time)[:, None]
    robot = pendulum()
    without = simulate(robot, [dataclasses.replace(drive, play=0.0)], time, command, [0.0])
    # The links coast on their flank; viscous friction of theirs would stop them.
    got = simulate(robot, [drive], time, command, [0.0])
    assert 0.0 < np.abs(got - without).max() < 0.03
    with pytest.raises(ValueError, match="joint 1: a gear with play needs an armature"):
        simulate(robot, [dataclasses.replace(drive, armature=0.0)], time, command, [0.0])


@pytest.mark.parametrize(("step", "error"), [(5e-4, 1e-5), (2e-3, 4e-5)])
def test_links_coast_through_the_play_and_take_the_motor_along(step: float, error: float) -> None:
    """A motor that friction brakes, from 1 rad/s: links meet the other flank without a rebound."""
    friction, armature, play, speed = 0.5, 0.01, 0.0175, 1.0
    drive = ServoDrive(gain=1e-9, armature=armature, coulomb=friction, play=play)
    time = np.arange(0.0, 0.2, 0.02)
    got = simulate(
        pendulum(), [drive], time, np.zeros((time.size, 1)), [0.0], [speed], longest_step=step
    )
    meeting = np.sqrt(play * armature / friction)
    both = armature + INERTIA
    after = speed - armature / both * friction / armature * meeting
    want = speed * meeting + after**2 * both / (2.0 * friction)
    assert got[-1, 0] == pytest.approx(want, abs=error)


def test_masses_and_torques_scale_together(tmp_path: Path) -> None:
    robot, command = arm(tmp_path), held_sines(TIME, 3)
    assert robot.links is not None
    drive = dataclasses.replace(DRIVE, coulomb=0.1, torque_limit=2.0, static=0.05)
    heavy = dataclasses.replace(
        robot,
        links=tuple(
            LinkParameters(2.0 * link.mass, link.centre_of_gravity, 2.0 * link.inertia)
            for link in robot.links
        ),
    )
    one = simulate(robot, [drive] * 3, TIME, command, command[0])
    two = simulate(heavy, [drive.scaled(2.0)] * 3, TIME, command, command[0])
    np.testing.assert_allclose(one, two, atol=1e-9)


def test_refuses_what_does_not_belong_together(tmp_path: Path) -> None:
    robot, command = arm(tmp_path), held_sines(TIME, 3)
    with pytest.raises(ValueError, match="2 drives; expected 3"):
        simulate(robot, [DRIVE] * 2, TIME, command, command[0])
    with pytest.raises(ValueError, match="command has shape"):
        simulate(robot, [DRIVE] * 3, TIME, command[:, :2], command[0])
    unknown = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)])
    with pytest.raises(ValueError, match="has no masses"):
        simulate(unknown, [DRIVE], TIME, command[:, :1], [0.0])


LEVEL, TIP = -0.12, 0.12  # m: of a table, and of the point on the last link that leans on it
SPHERE = 0.001  # m


def on_table(xml: str) -> str:
    """Return the arm of `arm_xml` with a table, and a sphere at the end of its last link."""
    stiff = 'condim="1" solref="0.001 1" solimp="0.99 0.9999 0.001" mass="0"'
    plane = f'<geom type="plane" size="1 1 1" pos="0 0 {LEVEL - SPHERE}" {stiff}/>'
    sphere = f'<geom type="sphere" size="{SPHERE}" pos="{TIP} 0 0" {stiff}/>'
    first, *others = xml.replace("<worldbody>", f"<worldbody>{plane}").rsplit("</body>", 3)
    return f"{first}{sphere}</body></body></body>{others[-1]}"


def test_a_hand_leans_on_a_table_as_in_mujoco(tmp_path: Path) -> None:
    """It is pressed onto the table, slides along, and leaves it again."""
    command = held_sines(TIME, 3)
    robot, drive = arm(tmp_path), ServoDrive(12.0, 0.8, armature=0.01)
    table = Table(2, (TIP, 0.0, 0.0), LEVEL)
    start = command[0]
    got = simulate(robot, [drive] * 3, TIME, command, start, table=table, longest_step=FINE)
    expected = in_mujoco(on_table(arm_xml(step=FINE)), command)
    through = simulate(robot, [drive] * 3, TIME, command, start, longest_step=FINE)
    assert np.max(np.abs(through - expected)) > 100.0 * FIRST_ORDER
    np.testing.assert_allclose(got, expected, atol=8.0 * FIRST_ORDER)


@pytest.mark.parametrize("play", [0.0, 0.02])
def test_a_hand_rests_on_a_table(tmp_path: Path, play: float) -> None:
    """Whatever friction and play: at rest the point is at the table's height."""
    drive = ServoDrive(12.0, 0.8, armature=0.01, coulomb=0.05, static=0.02, stribeck=0.1, play=play)
    command = np.tile(np.minimum(TIME, 1.0)[:, None] * [-0.8, -0.3, -0.2], 1)
    table = Table(2, (TIP, 0.0, 0.0), LEVEL)
    q = simulate(arm(tmp_path), [drive] * 3, TIME, command, np.zeros(3), table=table)
    model = mujoco.MjModel.from_xml_string(on_table(arm_xml()))
    data = mujoco.MjData(model)
    heights: list[float] = []
    for row in q:
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        heights.append(data.geom_xpos[1, 2] - LEVEL)
    assert min(heights) > -2e-4
    np.testing.assert_allclose(heights[-50:], 0.0, atol=5e-5)
    np.testing.assert_allclose(q[-1], q[-50], atol=1e-4)
    assert command[-1] @ [1.0, 1.0, 1.0] < q[-1] @ [1.0, 1.0, 1.0] - 0.1
