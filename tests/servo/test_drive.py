"""The parameters of a drive: which values exist."""

import dataclasses
import math

import pytest

from jaxcslc.servo import DRIVE_UNITS, TORQUES, ServoDrive


def test_every_parameter_has_a_unit() -> None:
    assert list(DRIVE_UNITS) == [field.name for field in dataclasses.fields(ServoDrive)]


def test_scaling_changes_torques_alone() -> None:
    drive = ServoDrive(10.0, 1.0, 0.2, torque_limit=3.0, armature=0.1, coulomb=0.3, play=0.01)
    scaled = drive.scaled(3.0)
    for name in DRIVE_UNITS:
        factor = 3.0 if name in TORQUES else 1.0
        assert getattr(scaled, name) == factor * getattr(drive, name), name


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"gain": 0.0}, "gain: expected more than 0"),
        ({"gain": 1.0, "delay": -0.1}, "delay: expected at least 0"),
        ({"gain": 1.0, "coulomb": math.inf}, "coulomb: expected a finite"),
        ({"gain": 1.0, "stribeck": 0.0}, "stribeck: expected more than 0"),
        ({"gain": 1.0, "low": 1.0, "high": 0.5}, "low: expected less than high"),
        ({"gain": math.nan}, "gain: expected a number"),
    ],
)
def test_refuses_what_no_drive_has(values: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ServoDrive(**values)
