"""The recordings that estimators are compared on: one motion of a PUMA 560 under PID control."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

import jaxcslc as jc
import sim
from jaxcslc.control import Reference
from jaxcslc.instruments import ControlledMotion


INTERVAL = 0.002  # s, that of trajectories
# Of one round of the motion, its sinusoids' periods in that, and how long it takes to begin [s].
_DURATION = 6.6
_PERIODS = np.array([1, 2, 3, 5, 7, 9])
_BEGINNING = 0.6
_CENTRE = np.array([0.0, -1.2, 1.2, 0.0, 0.0, 0.0])  # rad
_SPAN = np.array([0.8, 0.5, 0.6, 1.0, 0.8, 1.2])  # greatest distance from it [rad]
_MOTION_SEED = 0
# Of the recording with Gaussian noise: positions [rad], torques as a part of their spread.
POSITION_NOISE, TORQUE_NOISE = 1e-4, 0.01

KINDS = {
    "encoders": "encoders of finite resolution",
    "all disturbances": "all disturbances of the thesis",
    "Gaussian noise": "1e-4 rad on positions, 1 % on torques, of normal distribution",
}


class Experiment(NamedTuple):
    """A recording, and what is true of it.

    - `machine`: whose links and friction are the truth.
    - `recording`: of the excitation.
    - `loop`: controller and reference of the recording.
    """

    machine: sim.Machine
    recording: jc.Recording
    loop: ControlledMotion


def excitation(
    samples: int,
) -> tuple[Float[np.ndarray, "samples joints"], ...]:
    """Sums of sinusoids about a posture, from rest: positions and two derivatives."""
    rng = np.random.default_rng(_MOTION_SEED)
    time = INTERVAL * np.arange(samples)[:, None, None]
    rate = 2 * np.pi / _DURATION * _PERIODS
    amplitude = rng.normal(size=(6, len(rate))) / _PERIODS
    phase = rate * time + rng.uniform(0, 2 * np.pi, (6, len(rate)))
    q, qd, qdd = (
        np.sum(part, axis=-1)
        for part in (
            amplitude * np.sin(phase),
            amplitude * rate * np.cos(phase),
            -amplitude * rate**2 * np.sin(phase),
        )
    )
    scale = _SPAN / np.max(np.abs(q), axis=0)
    s = np.minimum(time[:, :, 0] / _BEGINNING, 1.0)
    size = s**3 * (10 + s * (6 * s - 15))
    growth = 30 * (s * (1 - s)) ** 2 / _BEGINNING
    change = 60 * s * (1 - s) * (1 - 2 * s) / _BEGINNING**2
    q, qd, qdd = scale * q, scale * qd, scale * qdd
    return (
        _CENTRE + size * q,
        growth * q + size * qd,
        change * q + 2 * growth * qd + size * qdd,
    )


def experiment(kind: str, samples: int, time_step: float, seed: int) -> Experiment:
    """A recording of one of `KINDS`."""
    machine = sim.undisturbed(sim.puma560())
    if kind == "encoders":
        machine = sim.disturbed(sim.puma560(), "quantisation")
    elif kind == "all disturbances":
        machine = sim.disturbed(sim.puma560(), *sim.DISTURBANCES)
    machine = dataclasses.replace(machine, time_step=time_step)
    path = excitation(samples)
    controller = sim.comparison().controller
    trajectory = sim.Trajectory(
        "excitation",
        path[0][0],
        controller,
        samples,
        path=sim.SampledPath(*path, interval=INTERVAL),
    )
    recording = sim.simulate(machine, trajectory, seed=seed).recording
    if kind == "Gaussian noise":
        rng = np.random.default_rng(seed)
        q, torque = np.asarray(recording.position), np.asarray(recording.torque)
        recording = jc.Recording(
            recording.time,
            q + POSITION_NOISE * rng.standard_normal(q.shape),
            torque + TORQUE_NOISE * np.std(torque, axis=0) * rng.standard_normal(q.shape),
        )
    return Experiment(machine, recording, ControlledMotion(controller, Reference(*path)))
