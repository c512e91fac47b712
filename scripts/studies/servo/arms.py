"""Servo arms in MuJoCo: links, motors behind gears with play, and servos, apart from `jaxcslc`.

Each axis is two hinges in series. The first is the motor's, with armature, damping and friction.
The second has the play as its range. The encoder reads their sum. Delay, dead zone, Stribeck
friction and friction that depends on the load are computed here between MuJoCo's steps.
"""

import dataclasses
import tempfile
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc.servo import ServoDrive, ServoRecording


TICK = 2.0 * np.pi / 4096
# Positions then are within 0.04 mrad of those of a step of half the length, except for joints
# that no load holds on a flank of their gear. Steps of 0.5 ms err by 0.15 mrad, a
# third of the encoder's rounding, which falsifies what is taken as true: offsets, plays and
# dampings by several errors.
STEP = 0.0002  # s
RATE = 50.0  # Hz
AT_REST = 1.0  # s
_STIFF = f"{2.0 * STEP} 1"  # of constraints: as stiff as the step allows
# Likewise: with MuJoCo's default of 0.9, joints that friction holds creep by 0.3 mrad/s.
_HARD = "0.999 0.9999 0.001"
_MOTOR, _MOMENTS = 1e-6, "1e-6 1e-6 1e-6"  # kg, kg m²: least of a body that only turns

# Axis, place on the link before [m], mass [kg], centre [m], moments of inertia [kg m²].
_Link = tuple[str, str, float, str, str]
LINKS: dict[str, tuple[_Link, ...]] = {
    "so101": (
        ("0 0 1", "0 0 0.05", 0.10, "0.02 0 0.03", "8e-5 8e-5 3e-5"),
        ("0 1 0", "0.03 0 0.05", 0.12, "0.09 0 0.01", "4e-5 1.5e-4 1.5e-4"),
        ("0 1 0", "0.113 0 0.028", 0.11, "0.10 0 0", "3e-5 1.6e-4 1.5e-4"),
        ("0 1 0", "0.135 0 0", 0.09, "0.04 0 0.01", "4e-5 3e-5 2e-5"),
        ("1 0 0", "0.06 0 0", 0.12, "0.04 0.01 0", "3e-5 5e-5 4e-5"),
    ),
    "koch": (
        ("0 0 1", "0 0 0.041", 0.050, "0.012 0 0.013", "1.4e-5 1.2e-5 8e-6"),
        ("0 1 0", "0 0 0.015", 0.050, "0.001 0 0.072", "3.7e-5 3.4e-5 8e-6"),
        ("0 1 0", "0.015 0 0.108", 0.064, "0.055 0.008 0.003", "7e-6 2.2e-5 2.5e-5"),
        ("0 1 0", "0.100 0 0.003", 0.020, "0.027 0 0", "1.1e-6 2.9e-6 3e-6"),
        ("1 0 0", "0.045 0 0", 0.042, "0.027 0.004 0.003", "6e-6 1.4e-5 1.5e-5"),
    ),
    "seven": (
        ("0 0 1", "0 0 0.1", 0.25, "0 0 0.05", "4e-4 4e-4 2e-4"),
        ("0 1 0", "0 0 0.1", 0.25, "0.01 0 0.08", "6e-4 6e-4 2e-4"),
        ("0 0 1", "0 0 0.14", 0.20, "0.01 0 0.05", "3e-4 3e-4 1e-4"),
        ("0 1 0", "0 0 0.1", 0.18, "0.01 0 0.07", "3e-4 3e-4 1e-4"),
        ("0 0 1", "0 0 0.12", 0.12, "0.01 0 0.03", "1e-4 1e-4 5e-5"),
        ("0 1 0", "0 0 0.06", 0.10, "0.01 0 0.04", "1e-4 1e-4 5e-5"),
        ("1 0 0", "0 0 0.05", 0.10, "0.02 0.02 0.02", "5e-5 5e-5 5e-5"),
    ),
}
"""Links of the arms by name. Those of `koch` are as in MuJoCo Menagerie's `low_cost_robot_arm`."""

# Torques and inertias of servos over those of an SO-101's, one per joint: a Koch has two kinds of
# smaller servos. These factors are assumed.
_SIZES = {"koch": (0.5, 0.5, 0.2, 0.2, 0.2)}
PAYLOADS = {"so101": 0.2, "koch": 0.1, "seven": 0.2}
"""Mass of the payload of each arm [kg]."""


@dataclass(frozen=True)
class Servos:
    """True parameters of the servos of an arm, one per joint, in SI units."""

    gain: Float[np.ndarray, " joints"]
    damping: Float[np.ndarray, " joints"]
    delay: Float[np.ndarray, " joints"]
    offset: Float[np.ndarray, " joints"]
    armature: Float[np.ndarray, " joints"]
    coulomb: Float[np.ndarray, " joints"]
    static: Float[np.ndarray, " joints"]
    stribeck: Float[np.ndarray, " joints"]
    load_friction: Float[np.ndarray, " joints"]
    dead_zone: Float[np.ndarray, " joints"]
    play: Float[np.ndarray, " joints"]

    @classmethod
    def drawn(cls, joints: int, rng: np.random.Generator, arm: str | None = None) -> "Servos":
        """Draw servos like those of small arms, or of an arm of `LINKS`."""
        size = np.array(_SIZES.get(arm or "", (1.0,) * joints))

        def between(low: float, high: float) -> np.ndarray:
            return rng.uniform(low, high, joints)

        return cls(
            gain=size * between(9.0, 15.0),
            damping=size * between(0.6, 1.1),
            delay=STEP * np.round(between(0.02, 0.06) / STEP),
            offset=rng.normal(0.0, 0.05, joints),
            armature=size * between(0.01, 0.025),
            coulomb=size * between(0.05, 0.12),
            static=size * between(0.03, 0.06),
            stribeck=between(0.05, 0.15),
            load_friction=between(0.1, 0.3),
            dead_zone=np.full(joints, 1.5 * TICK),
            play=np.full(joints, np.deg2rad(1.0)),
        )

    def drives(self) -> tuple[ServoDrive, ...]:
        """Return the servos as `jaxcslc` describes them."""
        columns = dataclasses.asdict(self)
        return tuple(
            ServoDrive(**{name: float(x[i]) for name, x in columns.items()})
            for i in range(len(self.gain))
        )

    def without(self, *names: str) -> "Servos":
        """Return the servos with some parameters at zero."""
        return dataclasses.replace(self, **{x: np.zeros_like(self.gain) for x in names})


def arm_xml(
    links: tuple[_Link, ...],
    servos: Servos | None = None,
    payload: float = 0.0,
    masses: float = 1.0,
) -> str:
    """Return the arm as MuJoCo's XML: with servos' motors and gears, or of its links alone.

    - `payload`: mass of a point at the end of the last link's centre [kg].
    - `masses`: times all links' masses.
    """
    opened = closed = ""
    for i, (axis, place, mass, centre, moments) in enumerate(links):
        scaled = " ".join(f"{masses * float(x):.9g}" for x in moments.split())
        body = f'<inertial mass="{masses * mass:.9g}" pos="{centre}" diaginertia="{scaled}"/>'
        if i == len(links) - 1 and payload > 0.0:
            body += f'<body pos="{centre}"><inertial mass="{payload}" pos="0 0 0" '
            body += 'diaginertia="1e-8 1e-8 1e-8"/></body>'
        joint = f'type="hinge" axis="{axis}"'
        if servos is not None:
            opened += (
                f'<body pos="{place}"><joint name="motor{i}" {joint} damping="{servos.damping[i]}"'
                f' armature="{servos.armature[i]}" frictionloss="1" solreffriction="{_STIFF}"'
                f' solimpfriction="{_HARD}"/>'
            )
            closed += "</body>"
            half = 0.5 * servos.play[i]
            if half == 0.0:
                opened += body
                continue
            opened += f'<inertial mass="{_MOTOR}" pos="0 0 0" diaginertia="{_MOMENTS}"/>'
            place = "0 0 0"
            joint += f' limited="true" range="{-half} {half}" solreflimit="{_STIFF}"'
            joint += f' solimplimit="{_HARD}"'
        opened += f'<body pos="{place}"><joint name="joint{i}" {joint}/>{body}'
        closed += "</body>"
    return (
        f'<mujoco><compiler angle="radian"/><option timestep="{STEP}" integrator="implicitfast"/>'
        f"<worldbody>{opened}{closed}</worldbody></mujoco>"
    )


def robot(links: tuple[_Link, ...], masses: float = 1.0) -> jc.Manipulator:
    """Return the arm as `jaxcslc` reads it from a file of its links."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.xml"
        path.write_text(arm_xml(links, masses=masses), "utf-8")
        return jc.load_robot(path)


def recorded(
    links: tuple[_Link, ...],
    servos: Servos,
    command: Float[np.ndarray, "samples joints"],
    payload: float = 0.0,
    tick: float = TICK,
) -> ServoRecording:
    """Move an arm by commands at 50 Hz, and return what its encoders read.

    The servos hold the first command for `AT_REST` before the recording begins.

    - `tick`: resolution of the encoders; 0 for exact readings.
    """
    model = mujoco.MjModel.from_xml_string(arm_xml(links, servos, payload))
    data = mujoco.MjData(model)
    joints = len(links)
    motors = np.array([model.joint(f"motor{i}").dofadr[0] for i in range(joints)])
    has_play = bool(np.all(servos.play > 0.0))
    gears = motors + 1 if has_play else motors
    data.qpos[motors] = command[0] - servos.offset
    late = np.round(servos.delay / STEP).astype(int)
    per_sample = round(1.0 / RATE / STEP)
    columns = np.arange(joints)
    readings: list[np.ndarray] = []
    for n in range(-round(AT_REST / STEP), per_sample * (len(command) - 1) + 1):
        if n >= 0 and n % per_sample == 0:
            angle = data.qpos[motors] + (data.qpos[gears] if has_play else 0.0)
            readings.append(angle + servos.offset)
        sent = command[np.maximum(n - late, 0) // per_sample, columns]
        angle = data.qpos[motors] + (data.qpos[gears] if has_play else 0.0)
        error = sent - angle - servos.offset
        acting = np.sign(error) * np.maximum(np.abs(error) - servos.dead_zone, 0.0)
        v, load = data.qvel[motors], np.abs(data.qfrc_bias[motors])
        with np.errstate(divide="ignore", invalid="ignore"):
            excess = np.where(servos.static > 0, np.exp(-np.square(v / servos.stribeck)), 0.0)
        model.dof_frictionloss[motors] = (
            servos.coulomb + servos.load_friction * load + servos.static * excess
        )
        data.qfrc_applied[motors] = servos.gain * acting
        mujoco.mj_step(model, data)
    time = np.arange(len(command)) / RATE
    position = np.array(readings)
    return ServoRecording(time, tick * np.round(position / tick) if tick else position, command)


def training_command(
    joints: int, duration: float, rng: np.random.Generator
) -> Float[np.ndarray, "samples joints"]:
    """Return slow wide motion, faster motion on top in the second half, and rests at the end."""
    time = np.arange(round(duration * RATE)) / RATE
    slow = rng.uniform(0.5, 0.9, joints)
    fast = rng.uniform(5.0, 9.0, joints)
    phase = rng.uniform(0.0, 2.0 * np.pi, (3, joints))
    wide = 0.6 * np.sin(slow * time[:, None] + phase[0])
    wide += 0.25 * np.sin(2.3 * slow * time[:, None] + phase[1])
    quick = 0.08 * np.sin(fast * time[:, None] + phase[2])
    command = wide + np.where(time[:, None] > 0.4 * duration, quick, 0.0)
    rests = np.floor(time / 1.5) * 1.5
    held = np.stack([np.interp(rests, time, column) for column in command.T], axis=1)
    return np.where(time[:, None] > 0.85 * duration, held, command)


def new_command(
    joints: int, duration: float, rng: np.random.Generator
) -> Float[np.ndarray, "samples joints"]:
    """Return motion from point to point with pauses: nothing that the training had."""
    time = np.arange(round(duration * RATE)) / RATE
    points = rng.uniform(-0.7, 0.7, (int(duration / 2.0) + 2, joints))
    part, phase = np.divmod(time, 2.0)
    x = np.clip(phase / 1.2, 0.0, 1.0)[:, None]
    blend = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    index = part.astype(int)
    return points[index] + blend * (points[index + 1] - points[index])
