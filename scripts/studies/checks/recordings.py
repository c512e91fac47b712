"""Recordings of the study's arms.

MuJoCo simulates the PUMA 560, by `sim`. Torques of the other arms are Pinocchio's; friction, gears
and encoders are added to them.
"""

import dataclasses

import numpy as np
import pinocchio
from jaxtyping import Float

import jaxcslc as jc
import sim
from jaxcslc.manipulator import LinkParameters
from scripts.studies.checks.arms import URDFS, ArmJoint, urdf


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
