"""Three arms of the study, and recordings of them: a PUMA 560, a geared 7-joint arm, a 6-joint one.

The PUMA 560 is MuJoCo's, by `sim`. The others are URDF files written here, whose torques Pinocchio
computes; friction, gears and encoders are added to them.
"""

import dataclasses
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pinocchio
from jaxtyping import Float

import jaxcslc as jc
import sim
from jaxcslc.manipulator import LinkParameters


@dataclasses.dataclass(frozen=True)
class ArmJoint:
    """A revolute joint of a URDF and the link that it moves.

    - `origin`, `angles`: of the joint in the frame before [m, rad].
    - `mass`, `centre`, `radius`: of the link, a ball for its inertia [kg, m].
    - `motor`: inertia of the motor, seen at the joint [kg m²].
    - `limits`: lower, upper, speed, torque [rad, rad/s, N m].
    - `friction`: viscous and dry [N m s/rad, N m].
    """

    origin: tuple[float, float, float]
    angles: tuple[float, float, float]
    mass: float
    centre: tuple[float, float, float]
    radius: float
    motor: float
    limits: tuple[float, float, float, float]
    friction: tuple[float, float]


_R = np.pi / 2
GEARED = (
    ArmJoint(
        (0, 0, 0.333),
        (0, 0, 0),
        4.5,
        (0.0, -0.03, -0.07),
        0.11,
        0.6,
        (-2.8, 2.8, 2.2, 87),
        (3.0, 2.5),
    ),
    ArmJoint(
        (0, 0, 0),
        (-_R, 0, 0),
        4.2,
        (-0.003, -0.07, 0.03),
        0.11,
        0.6,
        (-1.7, 1.7, 2.2, 87),
        (3.0, 2.5),
    ),
    ArmJoint(
        (0, -0.316, 0),
        (_R, 0, 0),
        3.4,
        (0.04, 0.025, -0.04),
        0.1,
        0.5,
        (-2.8, 2.8, 2.2, 87),
        (2.0, 1.8),
    ),
    ArmJoint(
        (0.0825, 0, 0),
        (_R, 0, 0),
        3.2,
        (-0.04, 0.04, 0.025),
        0.1,
        0.5,
        (-3.0, 0.0, 2.2, 87),
        (2.0, 1.8),
    ),
    ArmJoint(
        (-0.0825, 0.384, 0),
        (-_R, 0, 0),
        3.0,
        (0.0, 0.04, -0.11),
        0.1,
        0.25,
        (-2.8, 2.8, 2.6, 12),
        (1.0, 1.0),
    ),
    ArmJoint(
        (0, 0, 0),
        (_R, 0, 0),
        1.8,
        (0.055, 0.008, -0.01),
        0.07,
        0.25,
        (0.0, 3.7, 2.6, 12),
        (0.9, 0.9),
    ),
    ArmJoint(
        (0.088, 0, 0),
        (_R, 0, 0),
        1.2,
        (0.012, 0.008, 0.085),
        0.06,
        0.2,
        (-2.8, 2.8, 2.6, 12),
        (0.7, 0.6),
    ),
)
"""A geared 7-joint arm, with the lengths of a Franka Panda."""

SIX = (
    ArmJoint(
        (0, 0, 0.1625),
        (0, 0, 0),
        3.8,
        (0.0, -0.02, 0.0),
        0.08,
        0.9,
        (-6.2, 6.2, 3.1, 150),
        (8.0, 7.0),
    ),
    ArmJoint(
        (0, 0, 0), (_R, 0, 0), 8.4, (-0.21, 0.0, 0.11), 0.12, 0.9, (-6.2, 6.2, 3.1, 150), (8.0, 8.0)
    ),
    ArmJoint(
        (-0.425, 0, 0),
        (0, 0, 0),
        2.3,
        (-0.27, 0.0, 0.01),
        0.09,
        0.5,
        (-3.1, 3.1, 3.1, 150),
        (5.0, 5.0),
    ),
    ArmJoint(
        (-0.3922, 0, 0.1333),
        (0, 0, 0),
        1.2,
        (0.0, -0.015, 0.02),
        0.06,
        0.12,
        (-6.2, 6.2, 3.1, 28),
        (1.5, 1.6),
    ),
    ArmJoint(
        (0, -0.0997, 0),
        (_R, 0, 0),
        1.2,
        (0.0, 0.015, 0.02),
        0.06,
        0.12,
        (-6.2, 6.2, 3.1, 28),
        (1.5, 1.5),
    ),
    ArmJoint(
        (0, 0.0996, 0),
        (_R, np.pi, np.pi),
        0.4,
        (0.0, 0.01, -0.03),
        0.05,
        0.12,
        (-6.2, 6.2, 3.1, 28),
        (1.2, 1.2),
    ),
)
"""A 6-joint arm, with the lengths of a Universal Robots UR5e."""


SEVEN = (
    ArmJoint(
        (0, 0, 0.1575),
        (0, 0, 0),
        4.0,
        (0.0, -0.03, 0.12),
        0.1,
        0.7,
        (-2.9, 2.9, 1.7, 170),
        (3.0, 2.5),
    ),
    ArmJoint(
        (0, 0, 0.2025),
        (_R, 0, np.pi),
        4.0,
        (0.0, 0.06, 0.04),
        0.1,
        0.7,
        (-2.0, 2.0, 1.7, 170),
        (3.0, 2.5),
    ),
    ArmJoint(
        (0, 0.2045, 0),
        (_R, 0, np.pi),
        3.0,
        (0.0, 0.03, 0.13),
        0.09,
        0.5,
        (-2.9, 2.9, 1.7, 110),
        (2.0, 2.0),
    ),
    ArmJoint(
        (0, 0, 0.2155),
        (_R, 0, 0),
        2.7,
        (0.0, 0.067, 0.034),
        0.09,
        0.5,
        (-2.0, 2.0, 2.2, 110),
        (2.0, 2.0),
    ),
    ArmJoint(
        (0, 0.1845, 0),
        (-_R, np.pi, 0),
        1.7,
        (0.0, 0.02, 0.076),
        0.08,
        0.3,
        (-2.9, 2.9, 2.2, 110),
        (1.0, 1.0),
    ),
    ArmJoint(
        (0, 0, 0.2155),
        (_R, 0, 0),
        1.8,
        (0.0, 0.0, 0.0),
        0.07,
        0.2,
        (-2.0, 2.0, 3.1, 40),
        (0.8, 0.8),
    ),
    ArmJoint(
        (0, 0.081, 0),
        (-_R, np.pi, 0),
        0.3,
        (0.0, 0.0, 0.02),
        0.04,
        0.2,
        (-3.0, 3.0, 3.1, 40),
        (0.5, 0.5),
    ),
)
"""Another 7-joint arm, with the lengths of a KUKA iiwa: the wrong robot for the geared one."""

URDFS = {"geared": GEARED, "six": SIX, "seven": SEVEN}


def urdf(name: str, joints: tuple[ArmJoint, ...]) -> str:
    """The arm as a URDF."""
    lines = [f'<robot name="{name}">', '  <link name="base"/>']
    for number, joint in enumerate(joints, 1):
        moment = 0.4 * joint.mass * joint.radius**2
        lower, upper, speed, torque = joint.limits
        lines += [
            f'  <link name="link_{number}"><inertial>',
            f'    <origin xyz="{_text(joint.centre)}"/><mass value="{joint.mass}"/>',
            f'    <inertia ixx="{moment:.6g}" iyy="{moment:.6g}" izz="{moment:.6g}"'
            ' ixy="0" ixz="0" iyz="0"/>',
            "  </inertial></link>",
            f'  <joint name="joint_{number}" type="revolute">',
            f'    <origin xyz="{_text(joint.origin)}" rpy="{_text(joint.angles)}"/>',
            f'    <parent link="{"base" if number == 1 else f"link_{number - 1}"}"/>'
            f'<child link="link_{number}"/><axis xyz="0 0 1"/>',
            f'    <limit lower="{lower}" upper="{upper}" velocity="{speed}" effort="{torque}"/>',
            "  </joint>",
        ]
    return "\n".join([*lines, "</robot>", ""])


def _text(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:.12g}" for value in values)


@dataclasses.dataclass(frozen=True)
class Conditions:
    """How a recording is made.

    - `duration`, `rate`: of the recording [s, Hz].
    - `noise`: of the torque, as part of each joint's RMS.
    - `counts`: of the encoders a turn.
    - `friction`: factor of friction; `stribeck`: an excess at low speed that no model has, as
      part of dry friction.
    - `speed`: greatest speeds as part of the limits.
    - `velocity`: record velocities as well.
    - `payload`: mass that the last link carries [kg].
    - `masses`: how far masses and inertias are from those of the file, as a part of them: the
      standard deviation, from link to link.
    """

    duration: float = 20.0
    rate: float = 500.0
    noise: float = 0.01
    counts: float = 2.0**18
    friction: float = 1.0
    stribeck: float = 0.1
    speed: float = 0.5
    velocity: bool = False
    payload: float = 0.0
    masses: float = 0.15


CENTRE_OF_PAYLOAD = (0.02, 0.0, 0.08)


def record(arm: str, conditions: Conditions, seed: int) -> jc.Recording:
    """A recording of an arm, `"PUMA 560"`, `"geared"` or `"six"`."""
    if arm == "PUMA 560":
        return _record_puma(conditions, seed)
    return _record_urdf(URDFS[arm], conditions, seed)


@cache
def robot(arm: str) -> jc.Manipulator:
    """The arm as its file describes it."""
    if arm == "PUMA 560":
        return jc.puma560()
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"{arm}.urdf"
        path.write_text(urdf(arm, URDFS[arm]), encoding="utf-8")
        return jc.load_robot(path)


@cache
def network(arm: str) -> jc.CSLC:
    return jc.derive(robot(arm), lengths="numeric")


ARMS = ("PUMA 560", "geared", "six")


def _record_puma(conditions: Conditions, seed: int) -> jc.Recording:
    rng = np.random.default_rng(seed)
    machine = sim.puma560()
    machine = dataclasses.replace(
        machine,
        encoder_resolution=(2 * np.pi / conditions.counts,) * 6,
        **{
            name: tuple(conditions.friction * value for value in getattr(machine, name))
            for name in ("viscous", "dry", "static")
        },
    )
    if conditions.masses:
        machine = sim.specimen(machine, 1, links=conditions.masses)
    if conditions.payload:
        body = LinkParameters(conditions.payload, np.array(CENTRE_OF_PAYLOAD), np.zeros((3, 3)))
        machine = sim.carrying(machine, body)
    amplitude = np.array([25.0, 13.0, 14.0, 8.0, 10.0, 14.0]) * rng.uniform(0.8, 1.05, 6)
    while True:
        trajectory = sim.training(
            samples=int(500 * conditions.duration),
            amplitude=tuple(amplitude.tolist()),
            robot=machine.robot,
        )
        try:
            recording, _ = sim.simulate(machine, trajectory, seed=seed)
            break
        except sim.SimulationError:  # out of a joint's range: less motion of the wrist
            amplitude[3:] *= 0.85
    step = max(1, round(500 / conditions.rate))
    recording = recording.rows(slice(None, None, step))
    return _measured(rng, conditions, recording)


def _record_urdf(joints: tuple[ArmJoint, ...], conditions: Conditions, seed: int) -> jc.Recording:
    rng = np.random.default_rng(seed)
    time, q, qd, qdd = _motion(rng, joints, conditions)
    model = pinocchio.buildModelFromXML(urdf("arm", joints))
    # One arm, whatever its recording's seed.
    specimen = np.random.default_rng(1)
    for body in list(model.inertias)[1:]:
        factor = np.exp(conditions.masses * specimen.standard_normal())
        body.mass, body.inertia = factor * body.mass, factor * body.inertia
    if conditions.payload:
        body = pinocchio.Inertia(conditions.payload, np.array(CENTRE_OF_PAYLOAD), 1e-4 * np.eye(3))
        model.appendBodyToJoint(len(joints), body, pinocchio.SE3.Identity())
    data = model.createData()
    rigid = np.stack(
        [pinocchio.rnea(model, data, *state) for state in zip(q, qd, qdd, strict=True)]
    )
    motor = np.array([joint.motor for joint in joints])
    viscous, dry = conditions.friction * np.array([joint.friction for joint in joints]).T
    excess = 1.0 + conditions.stribeck * np.exp(-np.abs(qd) / 0.05)
    friction = viscous * qd + dry * excess * np.tanh(qd / 0.005)
    count = 2 * np.pi / conditions.counts
    position = count * np.floor(q / count + rng.uniform(size=len(joints)))
    velocity = None
    if conditions.velocity:
        velocity = qd + 0.002 * rng.standard_normal(qd.shape)
    recording = jc.Recording(time, position, rigid + motor * qdd + friction, velocity)
    return _measured(rng, conditions, recording)


def _measured(
    rng: np.random.Generator, conditions: Conditions, recording: jc.Recording
) -> jc.Recording:
    size = np.sqrt(np.mean(recording.torque**2, axis=0))
    noise = conditions.noise * size * rng.standard_normal(recording.torque.shape)
    return jc.Recording(
        recording.time, recording.position, recording.torque + noise, recording.velocity
    )


def _motion(
    rng: np.random.Generator, joints: tuple[ArmJoint, ...], conditions: Conditions
) -> tuple[Float[np.ndarray, "..."], ...]:
    """Times, positions and derivatives: five harmonics of each joint, from rest."""
    time = np.arange(int(conditions.duration * conditions.rate)) / conditions.rate
    base = 2 * np.pi * 0.1
    order = np.arange(1, 6)
    columns: list[np.ndarray] = []
    for joint in joints:
        amplitude = rng.standard_normal(5) / order
        phase = rng.uniform(0, 2 * np.pi, 5)
        angle = base * order * time[:, None] + phase
        wave = np.stack(
            [
                np.sin(angle) @ amplitude,
                np.cos(angle) @ (amplitude * base * order),
                -np.sin(angle) @ (amplitude * (base * order) ** 2),
            ]
        )
        lower, upper, speed, _ = joint.limits
        middle, half = 0.5 * (lower + upper), 0.45 * min(upper - lower, 4.0)
        scale = min(
            half / np.max(np.abs(wave[0])), conditions.speed * speed / np.max(np.abs(wave[1]))
        )
        # From rest: an envelope that rises within a second.
        s = np.clip(time, 0.0, 1.0)
        envelope = (
            s**3 * (10 - 15 * s + 6 * s**2),
            30 * s**2 * (1 - s) ** 2,
            60 * s * (1 - s) * (1 - 2 * s),
        )
        x, v, a = scale * wave
        e, ed, edd = envelope
        columns.append(np.stack([middle + e * x, ed * x + e * v, edd * x + 2 * ed * v + e * a]))
    q, qd, qdd = np.stack(columns, axis=-1)
    return time, q, qd, qdd
