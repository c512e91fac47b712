"""Machines that cannot exist are refused by the name of what is wrong."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

import sim
from jaxcslc.manipulator import Manipulator, puma560


SIX = (1.0,) * 6


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("viscous", (*SIX[:5], -1.0), "viscous of joint 6 is -1.0; expected zero or more"),
        ("dry", SIX[:4], "dry has 4 values; expected 6, one a joint"),
        ("dry", (math.nan, *SIX[:5]), "dry of joint 1 is nan"),
        ("static", (0.0,) * 6, "static of joint 1 is 0.0; expected no less than its dry, 5.355"),
        ("static_velocity", (*SIX[:2], 0.0, *SIX[:3]), "static_velocity of joint 3 is 0.0"),
        ("encoder_resolution", (-1e-4, *SIX[:5]), "encoder_resolution of joint 1 is -0.0001"),
        ("maximum_torque", (0.0,) * 6, "maximum_torque of joint 1 is 0.0; expected more than zero"),
        ("position_range", ((1.0, -1.0),) * 6, r"position_range of joint 1 is \(1.0, -1.0\)"),
        ("position_range", ((-1.0, 1.0),), "position_range has 1 values; expected 6"),
        ("start_spread", -1.0, "start_spread is -1.0"),
        ("time_step", 0.0, "time_step is 0.0; expected more than zero"),
        ("stiffness", (0.0, *SIX[:5]), "stiffness of joint 1 is 0.0; expected more than zero"),
        ("backlash", (-1e-3,) * 6, "backlash of joint 1 is -0.001; expected zero or more"),
        (
            "backlash",
            (0.0, 9.0, 0.0, 0.0, 0.0, 0.0),
            "backlash of joint 2 is 9; expected no more than its position range, 4.643",
        ),
        ("backlash", (1e-3,) * 6, "backlash of joint 1 is 0.001 and its stiffness infinite"),
        ("transmission_damping", (-1.0,) * 6, "transmission_damping of joint 1 is -1.0"),
        ("link_share", (0.0, 1.5, *SIX[:4]), "link_share of joint 2 is 1.5; expected from 0 to 1"),
        ("asymmetry", SIX, "asymmetry of joint 1 is 1.0; expected more than -1 and less than 1"),
        ("linear_torque", (0.0,) * 6, "linear_torque of joint 1 is 0.0; expected more than zero"),
        ("tilt", (math.nan,) * 6, "tilt of joint 1 is nan"),
        ("timing_jitter", -1.0, "timing_jitter is -1.0; expected zero or more"),
        ("torque_delay", math.inf, "torque_delay is inf; expected zero or more"),
    ],
)
def test_a_machine_that_cannot_exist_is_refused(field: str, value: Any, message: str):
    with pytest.raises(sim.MachineError, match=message):
        dataclasses.replace(sim.puma560(), **{field: value})


def altered(**changes: Any) -> Manipulator:
    """The PUMA 560 with another third link."""
    robot = puma560()
    assert robot.links is not None
    third = dataclasses.replace(robot.links[2], **changes)
    return dataclasses.replace(robot, links=(*robot.links[:2], third, *robot.links[3:]))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"motor_inertia": -0.1}, "motor_inertia of joint 3 is -0.1; expected zero or more"),
        ({"mass": -1.0}, "link 3 has a mass of -1.0 kg; expected zero or more"),
        ({"inertia": np.diag([0.1, 0.1, -0.1])}, "link 3 cannot be a rigid body"),
    ],
)
def test_links_that_cannot_exist_are_refused(changes: dict[str, Any], message: str):
    with pytest.raises(sim.MachineError, match=message):
        dataclasses.replace(sim.puma560(), robot=altered(**changes))


def test_a_rotor_without_inertia_cannot_have_gears_that_give_way():
    with pytest.raises(sim.MachineError, match=r"motor_inertia of joint 3 is 0\.0; expected more"):
        dataclasses.replace(
            sim.puma560(), robot=altered(motor_inertia=0.0), stiffness=(1e4,) * 6, time_step=1e-5
        )


def test_a_drive_that_cannot_hold_the_arm_is_refused_before_anything_runs():
    weak = dataclasses.replace(sim.puma560(), maximum_torque=(97.6, 40.0, 89.4, 24.2, 20.1, 21.3))
    with pytest.raises(
        sim.MachineError, match=r"maximum_torque of joint 2 is 40; expected no less than gravity"
    ):
        sim.simulate(weak, sim.training(samples=2))


def test_a_linear_limit_needs_a_greatest_torque():
    with pytest.raises(sim.MachineError, match="linear_torque of joint 1 is 1 and its maximum_tor"):
        dataclasses.replace(sim.puma560(), linear_torque=SIX, maximum_torque=(math.inf,) * 6)


def test_empty_is_off_for_every_joint():
    machine = sim.puma560()
    assert machine.stiffness == (math.inf,) * 6 and machine.flexible == (False,) * 6
    assert machine.backlash == machine.tilt == machine.asymmetry == (0.0,) * 6
    assert machine.links is machine.robot.links


def test_a_machine_needs_masses():
    robot = Manipulator.from_modified_dh([(0.0, 0.0, 0.0, 0.0)] * 6, name="ghost")
    with pytest.raises(sim.MachineError, match="robot 'ghost' has no link parameters"):
        dataclasses.replace(sim.puma560(), robot=robot)


def test_off_is_allowed():
    none, free = (0.0,) * 6, ((-math.inf, math.inf),) * 6
    machine = dataclasses.replace(
        sim.puma560(),
        viscous=none,
        dry=none,
        static=none,
        encoder_resolution=none,
        maximum_torque=(math.inf,) * 6,
        position_range=free,
        start_spread=0.0,
    )
    assert machine.joint_count == 6


def test_the_puma_is_the_library_s():
    machine, robot = sim.puma560(), puma560()
    assert machine.robot == robot
    assert (machine.viscous, machine.dry) == (robot.viscous, robot.dry)
    assert np.all(np.array(machine.static) == 1.25 * np.array(machine.dry))
    widths = [math.degrees(high - low) for low, high in machine.position_range]
    np.testing.assert_allclose(widths, [320, 266, 284, 280, 200, 532])


def test_machines_are_immutable():
    with pytest.raises(dataclasses.FrozenInstanceError):
        sim.puma560().time_step = 1.0  # pyright: ignore[reportAttributeAccessIssue]
