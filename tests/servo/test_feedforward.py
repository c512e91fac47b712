"""Commands for wanted motions in C, against Pinocchio's torques, and in MuJoCo."""

import ctypes
import math
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio
import pytest

import jaxcslc as jc
from jaxcslc.export import write_c
from jaxcslc.manipulator import RobotError
from jaxcslc.servo import (
    ServoDrive,
    ServoRecording,
    replay_in_mujoco,
    servo_feedforward,
    write_servo_mjcf,
)


DRIVES = [
    ServoDrive(20.0, 0.8, armature=0.02, coulomb=0.1, viscous=0.05, offset=0.2, dead_zone=0.01),
    ServoDrive(12.0, 0.3, armature=0.01, coulomb=0.05, load_friction=0.1, offset=-0.1),
]
# Sums of products of numbers about 1.
ROUNDING = 1e-9

Command = Callable[..., np.ndarray]


def compiled(code: jc.CCode, folder: Path) -> Command:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler (cc) on this machine")
    source, _ = write_c(code, folder / f"{code.name}.c")
    library = folder / "library.so"
    strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2"]
    subprocess.run(["cc", *strict, "-shared", "-fPIC", "-o", library, source, "-lm"], check=True)
    function = getattr(ctypes.CDLL(str(library)), f"{code.name}_command")

    def command(*states: np.ndarray) -> np.ndarray:
        output = np.empty_like(states[0])
        arrays = [np.ascontiguousarray(state, float) for state in (*states, output)]
        function(*(array.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for array in arrays))
        return arrays[-1]

    return command


def test_commands_make_the_torques_of_the_motion(
    arm: jc.Manipulator, arm_file: Path, tmp_path: Path, rng: np.random.Generator
) -> None:
    """What the servo makes of the command is the torque of links, armature and friction."""
    command = compiled(servo_feedforward(arm, DRIVES, name="arm"), tmp_path)
    model = pinocchio.buildModelFromUrdf(str(arm_file))
    data = model.createData()
    for _ in range(20):
        reading, qd, qdd = rng.uniform(-2, 2, (3, 2))
        q = reading - [d.offset for d in DRIVES]
        gravity = pinocchio.computeGeneralizedGravity(model, data, q)
        wanted = pinocchio.rnea(model, data, q, qd, qdd)
        for j, (given, drive) in enumerate(zip(command(reading, qd, qdd), DRIVES, strict=True)):
            friction = drive.coulomb + drive.load_friction * abs(gravity[j])
            torque = wanted[j] + drive.armature * qdd[j] + drive.viscous * qd[j]
            torque += friction * math.tanh(qd[j] / 0.02)
            error = given - reading[j]
            servo = drive.gain * math.copysign(max(abs(error) - drive.dead_zone, 0.0), error)
            assert servo - drive.damping * qd[j] == pytest.approx(torque, abs=ROUNDING)


def test_servos_follow_better(arm: jc.Manipulator, tmp_path: Path) -> None:
    """In MuJoCo, a slow sine is followed ten times as closely."""
    drives = [
        ServoDrive(20.0, 0.8, armature=0.02, coulomb=0.2, viscous=0.05, offset=0.2),
        ServoDrive(12.0, 0.3, armature=0.01, coulomb=0.1),
    ]
    command = compiled(servo_feedforward(arm, drives, name="arm"), tmp_path)
    written = write_servo_mjcf(arm, drives, tmp_path / "servos.xml")
    time = np.arange(400) * 0.01
    motion = [0.4 * np.stack([np.sin(2 * time), np.cos(2 * time)], 1)]
    motion.append(0.8 * np.stack([np.cos(2 * time), -np.sin(2 * time)], 1))
    motion.append(-4.0 * motion[0])
    commands = np.array([command(*state) for state in zip(*motion, strict=True)])
    errors = []
    for sent in (motion[0], commands):
        replayed = replay_in_mujoco(written.path, ServoRecording(time, motion[0], sent))
        errors.append(np.sqrt(np.mean((replayed - motion[0])[100:] ** 2, axis=0)))
    assert np.all(errors[1] < 0.1 * errors[0])


def test_wrong_robots(arm: jc.Manipulator) -> None:
    with pytest.raises(RobotError, match="1 drives; expected 2, one per joint"):
        servo_feedforward(arm, DRIVES[:1])
    with pytest.raises(ValueError, match="expected a C identifier, got 'my arm'"):
        servo_feedforward(arm, DRIVES, name="my arm")
