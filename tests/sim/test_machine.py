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
    ],
)
def test_a_machine_that_cannot_exist_is_refused(field: str, value: Any, message: str):
    with pytest.raises(sim.MachineError, match=message):
        dataclasses.replace(sim.puma560(), **{field: value})


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
