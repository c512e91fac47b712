"""An arm of two joints, as a URDF file."""

from pathlib import Path

import pytest

import jaxcslc as jc


ARM = """<?xml version="1.0"?>
<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial>
    <origin xyz="0.1 0.02 0"/><mass value="0.3"/>
    <inertia ixx="1e-4" iyy="8e-4" izz="9e-4" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="package://nowhere/upper.stl"/></geometry></visual></link>
  <link name="lower"><inertial>
    <origin xyz="0.08 0 0.01"/><mass value="0.2"/>
    <inertia ixx="1e-4" iyy="4e-4" izz="4e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="0" velocity="9"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/>
    <origin xyz="0.2 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="0" velocity="9"/></joint>
</robot>
"""


@pytest.fixture
def arm_file(tmp_path: Path) -> Path:
    path = tmp_path / "arm.urdf"
    path.write_text(ARM)
    return path


@pytest.fixture
def arm(arm_file: Path) -> jc.Manipulator:
    return jc.load_robot(arm_file)
