"""Ways from an arm's training recording to coefficients: those of this library and of others."""

import dataclasses
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc.bodies import bodies_of, body_map
from scripts.studies.real_robots.arms import Arm


# The low pass of the usual pipeline [Hz]: zero phase, of order 4, on positions and torques.
LOW_PASS = 20.0
PIPELINE = f"usual pipeline, {LOW_PASS:g} Hz"
# How exact a file's masses are, of themselves, for the ridge.
RIDGE = 0.2
USUAL: dict[str, Literal["equal", "residual"]] = {"OLS": "equal", "WLS": "residual"}


class Model(NamedTuple):
    """Coefficients that a method has identified.

    - `method`: its name.
    - `network`: with slopes of static friction, if it has such.
    - `k`: (p,) coefficients.
    - `settings`: by which the method itself prepares motion.
    - `seconds`: of the processor.
    - `note`: what it said about itself.
    - `states`: dry friction that yields before it slides, with coefficients of its own; or None.
    """

    method: str
    network: jc.CSLC
    k: Float[np.ndarray, " coefficients"]
    settings: jc.Settings
    seconds: float
    note: str
    states: jc.friction.PreSlidingFit | None = None


def usual_models(arm: Arm) -> Iterator[Model]:
    """The usual pipeline: Butterworth, central differences, ordinary or weighted least squares.

    What examples of Pinocchio do, with its regressor's columns; friction without the static kind.
    A torque offset of each joint is added where the robot has none: with it, and without. Samples
    count as equally spaced.
    """
    network, recording = without_static(arm), evenly(arm.training)
    preparation = jc.Preparation(
        jc.Butterworth(LOW_PASS), smooth_torque=True, threshold_fraction=0.0
    )
    networks: dict[str, jc.CSLC] = {}
    if (wider := with_offsets(network)) is not network:
        networks[""] = network
    networks[" and offsets"] = network = wider
    for (words, model), (name, weights) in product(networks.items(), USUAL.items()):
        settings = jc.Settings(
            preparation, jc.LeastSquares(joint_weights=weights, errors="independent")
        )
        start = time.process_time()
        fit = settings.fit(model, settings.patterns(recording))
        seconds = time.process_time() - start
        yield Model(f"{PIPELINE}, {name}{words}", model, np.asarray(fit.k), settings, seconds, "")
    if arm.robot.links is not None:
        settings = jc.Settings(preparation)
        start = time.process_time()
        k = with_ridge(network, arm.robot.links, settings.patterns(recording))
        seconds = time.process_time() - start
        yield Model(f"{PIPELINE}, ridge to the file", network, k, settings, seconds, "")


def with_offsets(network: jc.CSLC) -> jc.CSLC:
    """The network with a torque offset of each joint; itself if it has them."""
    laws = network.friction_per_joint
    wider = [kinds if "offset" in kinds else (*kinds, "offset") for kinds in laws]
    return network if wider == [*laws] else network.with_joint_friction(wider)


def evenly(recording: jc.Recording) -> jc.Recording:
    """The same rows, their time equally spaced."""
    first, last = recording.time[[0, -1]]
    time = np.linspace(float(first), float(last), recording.samples)
    return dataclasses.replace(recording, time=time)


def with_ridge(
    network: jc.CSLC, links: Sequence[jc.LinkParameters], patterns: jc.Patterns
) -> Float[np.ndarray, " coefficients"]:
    """Weighted least squares with a ridge towards the bodies of the robot's file.

    A mass is known to `RIDGE` of itself, first moments to that times 0.1 m, inertias to that times
    0.01 m². Motors' inertia and friction are barely known. One sample in twenty counts, since
    their errors are correlated.
    """
    bodies = bodies_of(links)
    of_bodies, of_motors = body_map(network.algebra)
    inertial, free = len(of_bodies), network.size - len(of_bodies)
    masses = np.maximum(bodies[:, -1:], 0.1)
    widths = RIDGE * masses * np.repeat([0.01, 0.1, 1.0], [6, 3, 1])
    spread = (of_bodies * widths).reshape(inertial, -1)
    covariance = np.zeros((network.size, network.size))
    covariance[:inertial, :inertial] = spread @ spread.T + of_motors @ of_motors.T
    covariance[inertial:, inertial:] = 30.0**2 * np.eye(free)
    mean = np.concatenate([np.einsum("cij,ij->c", of_bodies, bodies), np.zeros(free)])
    regressor = np.asarray(network.regressor(patterns.q, patterns.qd, patterns.qdd))
    left = np.asarray(patterns.torque) - regressor @ mean
    noise = np.ones(network.joint_count)
    change = np.zeros(network.size)
    for _ in range(6):
        rows = (regressor / noise[:, None]).reshape(-1, network.size)
        normal = rows.T @ rows / 20.0 + np.linalg.inv(covariance)
        change = np.linalg.solve(normal, rows.T @ (left / noise).ravel() / 20.0)
        noise = np.sqrt(np.mean((left - regressor @ change) ** 2, axis=0))
    return mean + change


COMMANDS: Mapping[str, tuple[str, ...]] = {
    "identify": (),
    "identify, maximum likelihood": ("--estimator", "maximum-likelihood"),
    "identify, friction auto": ("--friction", "auto"),
    "identify, best": ("--quality", "best"),
}
"""What is typed behind `jaxcslc identify ROBOT RECORDING`."""


def command_models(arm: Arm) -> Iterator[Model]:
    """The command as typed, in a process of its own, and what it has saved."""
    for name, options in COMMANDS.items():
        with tempfile.TemporaryDirectory() as folder:
            recording, output = Path(folder) / "training.csv", Path(folder) / "identified"
            jc.save_recording(arm.training, recording)
            words = ["identify", arm.typed, str(recording), *options, "-o", str(output)]
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            subprocess.run([sys.executable, "-m", "jaxcslc", *words, "--quiet"], check=True)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            report = jc.load_report(output)
        seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        yield Model(
            name,
            report.network,
            np.asarray(report.k),
            report.settings,
            seconds,
            _note(report),
            report.pre_sliding,
        )


def _note(report: jc.Report) -> str:
    """What the command chose, as its files say."""
    found = {section.name: section.data for section in report.sections}
    estimator = found.get("estimators", {}).get("estimators", {}).get("used", "least-squares")
    bodies = found.get("possible", {}).get("possible", {}).get("used", False)
    trials = found.get("friction", {}).get("friction_trials", ())
    added = [f"{trial['kind']} at joint {trial['joint']}" for trial in trials if trial["used"]]
    offsets = ["offset" in kinds for kinds in report.network.friction_per_joint]
    if all(offsets) and "file_prior" in found:
        added.insert(0, "offset at all joints")
    return "; ".join(
        (
            f"{estimator}{', physically consistent parameters' if bodies else ''}",
            ", ".join(added) or "no friction term added",
            str(report.settings),
        )
    )


FAMILIES: dict[str, Callable[[Arm], Iterator[Model]]] = {
    "usual": usual_models,
    "command": command_models,
}


def without_static(arm: Arm) -> jc.CSLC:
    """The network of an arm, numeric lengths, without static friction."""
    network = jc.derive(arm.robot, lengths="numeric")
    laws = arm.robot.friction_per_joint
    joints = [joint for joint, kinds in enumerate(laws, start=1) if "static" in kinds]
    return network.without_law("static", joints) if joints else network
