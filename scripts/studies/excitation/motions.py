"""The motions that are compared, and how a simulated PUMA 560 performs them."""

import dataclasses
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Float

import jaxcslc as jc
import sim
from jaxcslc.excitation import (
    Design,
    Effort,
    FourierSeries,
    Goal,
    Knowledge,
    Limits,
    Noise,
    Planner,
    Prediction,
    design_motion,
    family_named,
    random_parameters,
)
from scripts.studies.truth import true_coefficients


DURATION = 6.6  # of the thesis's training trajectory [s]
INTERVAL = 0.002
TORQUE_NOISE = (0.5, 0.8, 0.4, 0.1, 0.1, 0.1)  # [N m]
DESIGNED = {
    "overall": "overall",
    "mean error": "error",
    "D-optimal": "D",
    "condition number": "condition",
}
PEERS = ("D", "condition")  # criteria of others, which know of white noise alone
# Names of designs for a model with friction of each direction, which the simulated machine has.
DIRECTIONAL = {
    name: f"{name}, directional" for name in ("overall", "D-optimal", "condition number")
}
DIRECTIONAL_FRICTION = ("asymmetric_viscous", "asymmetric_dry")
TRACKING = {"position_margin": 0.02}  # for what the controller errs by [rad]
# Errors of the model are slow: their bandwidth [Hz], and what of them is constant.
SLOW, CONSTANT = 0.2, 0.5
DESIGNS = 10  # of each, from random starts of their own
THESIS, RANDOM = "thesis", "random Fourier"
MOTIONS = (*DESIGNED, RANDOM, THESIS)

Path = tuple[Float[np.ndarray, "samples joints"], ...]
Designs = dict[str, list[Path]]


@cache
def network(directional: bool = False) -> jc.CSLC:
    """The PUMA 560's, with the thesis's coefficients; or with friction of each direction."""
    robot = jc.puma560()
    return jc.derive(robot.with_friction(*DIRECTIONAL_FRICTION) if directional else robot)


@cache
def noise(estimator: str = "likelihood") -> Noise:
    """Return the noise of the machine's encoders, and of torques."""
    return Noise(TORQUE_NOISE, sim.puma560().encoder_resolution, 1 / INTERVAL, estimator=estimator)


def limits() -> Limits:
    """The arm's, with torques up to where its drives stop being linear (7.2.3)."""
    linear = sim.DISTURBANCES["motor linearity"]["linear_torque"]
    return Limits.of(jc.puma560(), {"torque": list(linear), "torque_margin": 0.05} | TRACKING)


def knowledge(directional: bool = False) -> Knowledge:
    """The machine's coefficients as a prior model; no information about them."""
    machine = sim.puma560()
    if directional:  # friction alike in both directions
        values = (np.stack([x, x], axis=1) for x in (machine.viscous, machine.dry))
        friction = dict(zip(DIRECTIONAL_FRICTION, values, strict=True))
        k = np.asarray(network(directional).coefficients_from(machine.links, **friction))
    else:
        k = np.asarray(true_coefficients(network(), machine))
    return Knowledge(k, None, np.full(len(k), np.inf))


def thesis_coefficients(net: jc.CSLC) -> Float[np.ndarray, "of_thesis coefficients"]:
    """Which of a network's coefficients are the thesis's: friction is the mean of directions."""
    rows = np.zeros((network().size, net.size))
    for row, name in zip(rows, network().names, strict=True):
        directions = (name.replace(name[:2], name[:2] + sign) for sign in "pn")
        parts = (name,) if name in net.names else directions
        for part in parts:
            row[net.names.index(part)] += 1.0 if part == name else 0.5
    return rows


def puma_design(name: str, seed: int, quick: bool = False) -> Design:
    """A designed motion by its name in `DESIGNED`, or among those of `DIRECTIONAL`.

    In ours, errors of the model count, unless the model has friction of each direction: designs
    of such a model against noise so slow had ten times the ε.
    """
    directional = name in DIRECTIONAL.values()
    criterion = DESIGNED[name.removesuffix(", directional")]
    chain = noise() if criterion in PEERS else noise("regression")
    if criterion not in PEERS and not directional:
        offset = tuple(CONSTANT * x for x in TORQUE_NOISE)
        chain = dataclasses.replace(chain, torque_bandwidth=SLOW, offset=offset)
    return design_motion(
        network(directional),
        limits(),
        chain,
        goal=Goal(criterion),
        knowledge=knowledge(directional),
        duration=DURATION,
        effort=Effort(1, 2, 10, seed) if quick else Effort(seed=seed),
    )


def path_of(parameters: Any) -> Path:
    """The motion of a design's parameters."""
    instants = INTERVAL * np.arange(round(DURATION / INTERVAL) + 1)
    return family_named("splines", DURATION).motion(np.asarray(parameters), instants)


@cache
def fourier_planner() -> Planner:
    """Return a planner of random Fourier series."""
    family = FourierSeries(DURATION, 8, periodic=False)
    return Planner.of(network(), limits(), noise(), family, knowledge=knowledge())


def random_motion(seed: int) -> Path:
    """A random Fourier series within all limits."""
    planner = fourier_planner()
    rng = np.random.default_rng(seed)
    parameters = random_parameters(planner.check, planner.rest_pose(rng), rng)
    parameters, _, _ = planner.check.scaled(parameters)
    time = INTERVAL * np.arange(round(DURATION / INTERVAL) + 1)
    return planner.family.motion(parameters, time)


def trajectory(motion: Path) -> sim.Trajectory:
    """A motion that the thesis's PID controller tracks."""
    q, qd, qdd = (np.asarray(x) for x in motion)
    return dataclasses.replace(
        sim.comparison(),
        name="excitation",
        start=q[0],
        samples=len(q),
        path=sim.SampledPath(q, qd, qdd, INTERVAL),
    )


def performed(
    machine: sim.Machine, name: str, designs: Designs, seed: int
) -> sim.SimulatedRecording:
    """A recording of a motion by its name; designs take turns."""
    if name == THESIS:
        return sim.simulate(machine, sim.training(), seed=seed)
    motion = random_motion(seed) if name == RANDOM else designs[name][seed % len(designs[name])]
    return sim.simulate(machine, trajectory(motion), seed=seed)


def predicted_errors(motion: Path, estimator: str) -> Prediction:
    """Return what a performed motion should have said of the coefficients."""
    planner = dataclasses.replace(fourier_planner())
    stride = 5
    information = dataclasses.replace(
        planner.problem.information, noise=noise(estimator), interval=stride * INTERVAL
    )
    problem = dataclasses.replace(planner.problem, information=information)
    planner = dataclasses.replace(planner, problem=problem)
    states: Any = tuple(np.asarray(x)[::stride] for x in motion)
    return planner.prediction(states)
