"""Inertia of a motor at the joint that it drives, by rotor and gear (Eqn. 2.5-5)."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

import jaxcslc as jc
from jaxcslc.manipulator import RobotError, motor_inertia


ROTOR, RATIO = 2.5e-4, 62.5  # kg m²; turns of the motor per turn of the joint
LINK = 0.08  # kg m², about the joint
# A soft constraint couples joint and rotor in MuJoCo: it yields by this part.
COUPLING = 1e-3

MODEL = f"""
<mujoco>
  <option gravity="0 0 0" timestep="1e-4"/>
  <worldbody>
    <body>
      <joint name="joint" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="1" diaginertia="0.05 0.05 {LINK}"/>
    </body>
    <body pos="1 0 0">
      <joint name="motor" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="0.1" diaginertia="{ROTOR} {ROTOR} {ROTOR}"/>
    </body>
  </worldbody>
  <equality>
    <joint joint1="motor" joint2="joint" polycoef="0 {RATIO} 0 0 0"
           solref="2e-4 1" solimp="0.9999 0.9999 0.001"/>
  </equality>
</mujoco>
"""

FILE = """
    gravity = [0, 0, 0]
    friction = []
    [[joint]]
    alpha = 0
    a = 0
    d = 0
    [joint.link]
    mass = 1.0
    centre_of_gravity = [0, 0, 0]
    inertia_tensor = [0.05, 0.05, 0.08]
    rotor_inertia = 2.5e-4
    gear_ratio = 62.5
"""


def test_a_rotor_behind_a_gear_in_mujoco() -> None:
    """A rotor that turns N times as fast as the joint, as a body of its own."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    torque = 0.7
    data.qfrc_applied[0] = torque
    mujoco.mj_forward(model, data)
    assert data.qacc[1] == pytest.approx(RATIO * data.qacc[0], rel=COUPLING)
    inertia = LINK + motor_inertia(ROTOR, RATIO)
    assert data.qacc[0] == pytest.approx(torque / inertia, rel=COUPLING)


def test_thesis_convention() -> None:
    """I / r² with r the joint's speed over the motor's, below one for all gears of a PUMA 560."""
    r = 1.0 / RATIO
    assert motor_inertia(ROTOR, RATIO) == pytest.approx(ROTOR / r**2, rel=1e-15)
    assert motor_inertia(ROTOR, -RATIO) == motor_inertia(ROTOR, RATIO) > ROTOR


def test_robot_file(tmp_path: Path) -> None:
    path = tmp_path / "arm.toml"
    path.write_text(FILE, encoding="utf-8")
    robot = jc.load_robot(path)
    assert robot.links is not None
    assert robot.links[0].motor_inertia == motor_inertia(ROTOR, RATIO)
    network = jc.derive(robot, lengths="numeric")
    k = network.coefficients_from(robot.links)
    torque = network.torque(k, np.zeros(1), np.zeros(1), np.ones(1))
    assert float(torque[0]) == pytest.approx(LINK + ROTOR * RATIO**2, rel=1e-14)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("gear_ratio = 62.5", "", "expected motor_inertia, or rotor_inertia and gear_ratio"),
        ("rotor_inertia = 2.5e-4", "motor_inertia = 1.0", "expected motor_inertia, or rotor"),
        ("62.5", "62.5\nmotor_inertia = 1.0", "expected motor_inertia, or rotor_inertia and"),
        ("62.5", "0.0", r"joint 1, link, gear_ratio: expected a finite number other than 0"),
        ("2.5e-4", "-1.0", r"joint 1, link, rotor_inertia: expected 0 or more"),
        ("62.5", "'high'", "gear_ratio: expected a finite number, got 'high'"),
        ("62.5", "62.5\nmotor = false", "motor_inertia: expected none"),
    ],
)
def test_mistakes_in_a_file(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "arm.toml"
    path.write_text(FILE.replace(old, new), encoding="utf-8")
    with pytest.raises(RobotError, match=message):
        jc.load_robot(path)


@pytest.mark.parametrize(
    ("rotor", "ratio"), [(-1.0, 2.0), (np.nan, 2.0), (np.inf, 2.0), (1.0, 0.0), (1.0, np.nan)]
)
def test_what_no_motor_has(rotor: float, ratio: float) -> None:
    with pytest.raises(RobotError, match="expected"):
        motor_inertia(rotor, ratio)
