"""Legs of a quadruped in the air, hung by its base, in MuJoCo: drives with known gains.

Four legs of three joints, of a Go2's size and masses. Drives apply
`torque = GAIN (command - position) - DAMPING velocity` at 200 Hz. The base is held by springs, or
swings on a rope.
"""

import tempfile
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc.servo import ServoRecording


GAIN, DAMPING = 20.0, 1.5  # N m/rad, N m s/rad
# MuJoCo takes damping at the end of a step, which adds half a step times DAMPING to inertias.
RATE, STEP = 200.0, 0.0001  # Hz, s
TICK = 2.0 * np.pi / 16384
AT_REST = 1.0  # s, before a recording
BASE = 7.0  # kg
_MOMENTS = np.array([0.1, 0.25, 0.3])  # of the base [kg m²]
TOTAL = BASE + 4 * (0.68 + 1.15 + 0.24)  # kg
# Frequency and damping ratio of the base's motion: a stand of aluminium profiles, and a rope of
# half a metre.
BASES = {"stand": (10.0, 0.05), "rope": (0.7, 0.02)}


@dataclass(frozen=True)
class Drives:
    """True parameters, one per joint, in SI units."""

    armature: Float[np.ndarray, " joints"]
    coulomb: Float[np.ndarray, " joints"]
    viscous: Float[np.ndarray, " joints"]
    offset: Float[np.ndarray, " joints"]
    delay: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "Drives":
        """Draw drives like those of small legged robots."""
        return cls(
            rng.uniform(0.005, 0.015, 12),
            rng.uniform(0.1, 0.3, 12),
            rng.uniform(0.01, 0.05, 12),
            rng.normal(0.0, 0.02, 12),
            1e-3 * round(rng.uniform(2.0, 8.0)),
        )


def legs_xml(drives: Drives | None = None, base: str | None = None) -> str:
    """Return the robot as MuJoCo's XML: its links alone, or with drives and a base that moves."""
    bodies = ""
    for leg, (x, y) in enumerate([(1, 1), (1, -1), (-1, 1), (-1, -1)]):
        joints: list[str] = []
        for k, axis in enumerate(("1 0 0", "0 1 0", "0 1 0")):
            own = ""
            if drives is not None:
                i = 3 * leg + k
                own = (
                    f' armature="{drives.armature[i]}" frictionloss="{drives.coulomb[i]}"'
                    f' damping="{DAMPING + drives.viscous[i]}"'
                    f' solreffriction="{2.0 * STEP} 1" solimpfriction="0.999 0.9999 0.001"'
                )
            joints.append(f'<joint name="{["hip", "thigh", "calf"][k]}{leg}" axis="{axis}"{own}/>')
        bodies += (
            f'<body pos="{0.193 * x} {0.0465 * y} 0">{joints[0]}'
            '<inertial mass="0.68" pos="0 0 0" diaginertia="4.8e-4 8.8e-4 6e-4"/>'
            f'<body pos="0 {0.0955 * y} 0">{joints[1]}'
            f'<inertial mass="1.15" pos="-0.004 {-0.022 * y} -0.033"'
            ' diaginertia="5.8e-3 5.6e-3 1.0e-3"/>'
            f'<body pos="0 0 -0.213">{joints[2]}'
            '<inertial mass="0.24" pos="0.005 0 -0.13" diaginertia="1.6e-3 1.6e-3 4e-5"/>'
            "</body></body></body>"
        )
    held = ""
    if base is not None:
        frequency, ratio = BASES[base]
        for kind, inertias in (("slide", [TOTAL] * 3), ("hinge", 2.0 * _MOMENTS)):
            for axis, inertia in zip(("1 0 0", "0 1 0", "0 0 1"), inertias, strict=True):
                pace = 2.0 * np.pi * frequency
                held += (
                    f'<joint type="{kind}" axis="{axis}" stiffness="{inertia * pace**2}"'
                    f' damping="{2.0 * ratio * pace * inertia}"/>'
                )
    moments = " ".join(map(str, _MOMENTS))
    return (
        f'<mujoco><compiler angle="radian"/><option timestep="{STEP}" integrator="implicitfast"/>'
        f'<worldbody><body name="base">{held}<inertial mass="{BASE}" pos="0 0 0"'
        f' diaginertia="{moments}"/>{bodies}</body></worldbody></mujoco>'
    )


def robot() -> jc.Manipulator:
    """Return the robot with a fixed base, as `jaxcslc` reads it from its file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "legs.xml"
        path.write_text(legs_xml(), "utf-8")
        return jc.load_robot(path)


def command_of(duration: float, rng: np.random.Generator) -> Float[np.ndarray, "samples joints"]:
    """Return sines of all joints about a pose with bent knees, 0.2 to 3 Hz."""
    time = np.arange(round(duration * RATE)) / RATE
    pose = np.tile([0.0, 0.8, -1.5], 4)
    size = np.array([0.25, 0.1, 0.04])[:, None]
    pace = rng.uniform([[1.3], [5.0], [12.0]], [[2.5], [9.0], [19.0]], (3, 12))
    phase = rng.uniform(0.0, 2.0 * np.pi, (3, 12))
    waves = size[None] * np.sin(time[:, None, None] * pace + phase)
    ramp = np.minimum(time / 0.5, 1.0)[:, None]
    return pose + ramp * np.sum(waves, axis=1)


def recorded(
    drives: Drives, command: Float[np.ndarray, "samples joints"], base: str | None
) -> ServoRecording:
    """Move the legs by commands, and return what the encoders read."""
    model = mujoco.MjModel.from_xml_string(legs_xml(drives, base))
    data = mujoco.MjData(model)
    free = model.nv - 12
    data.qpos[free:] = command[0] - drives.offset
    per_sample, late = round(1.0 / RATE / STEP), round(drives.delay / STEP)
    readings: list[np.ndarray] = []
    for n in range(-round(AT_REST / STEP), per_sample * (len(command) - 1) + 1):
        reading = data.qpos[free:] + drives.offset
        if n >= 0 and n % per_sample == 0:
            readings.append(reading)
        sent = command[max(n - late, 0) // per_sample]
        data.qfrc_applied[free:] = GAIN * (sent - reading)
        mujoco.mj_step(model, data)
    time = np.arange(len(command)) / RATE
    return ServoRecording(time, TICK * np.round(np.array(readings) / TICK), command)
