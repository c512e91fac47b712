"""From an arm's training recording to coefficients, by ways of this library and of others."""

import time
from collections.abc import Callable, Iterator
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

import jaxcslc as jc
from scripts.studies.real_robots.arms import Arm


# The low pass of the usual pipeline [Hz]: zero phase, of order 4, on positions and torques.
LOW_PASS = 20.0
USUAL: dict[str, Literal["equal", "residual"]] = {"OLS": "equal", "WLS": "residual"}


class Model(NamedTuple):
    """Coefficients that a method has identified.

    - `method`: its name.
    - `network`: with slopes of static friction, if it has such.
    - `k`: (p,) coefficients.
    - `settings`: by which the method itself prepares motion.
    - `seconds`: of the processor; shared by the models of one call.
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
    """
    network = without_static(arm)
    preparation = jc.Preparation(
        jc.Butterworth(LOW_PASS), smooth_torque=True, threshold_fraction=0.0
    )
    for name, weights in USUAL.items():
        settings = jc.Settings(
            preparation, jc.LeastSquares(joint_weights=weights, errors="independent")
        )
        start = time.process_time()
        fit = settings.fit(network, settings.patterns(arm.training))
        seconds = time.process_time() - start
        name = f"usual pipeline, {LOW_PASS:g} Hz, {name}"
        yield Model(name, network, np.asarray(fit.k), settings, seconds, "")


def our_models(arm: Arm) -> Iterator[Model]:
    """`identify` by its defaults: both estimators, each without and with possible bodies."""
    network = jc.derive(arm.robot, lengths="numeric")
    for name in ("least-squares", "maximum-likelihood"):
        start = time.process_time()
        report = jc.identify(
            network, arm.training, estimator=name, possible="always", checks=False, systematic=False
        )
        seconds = time.process_time() - start
        bodies = report.possible
        assert bodies is not None
        note = str(report.settings) if report.estimators is None else _end(report.estimators)
        for k, suffix in ((bodies.free.k, ""), (bodies.parameters.k, ", consistent")):
            yield Model(
                f"{name}{suffix}", report.network, np.asarray(k), report.settings, seconds, note
            )


def friction_models(arm: Arm) -> Iterator[Model]:
    """`identify` with `friction="auto"`, by least squares and by `estimator="auto"`."""
    network = jc.derive(arm.robot, lengths="numeric")
    for name in ("least-squares", "auto"):
        start = time.process_time()
        report = jc.identify(
            network, arm.training, estimator=name, friction="auto", checks=False, systematic=False
        )
        seconds = time.process_time() - start
        assert report.friction is not None
        used = ", ".join(
            f"{trial.kind} at joint {trial.joint}" for trial in report.friction.trials if trial.used
        )
        note = used or "no term beside the robot's"
        if report.estimators is not None:
            note = f"{report.estimators.used}; {note}"
        yield Model(
            f"{name}, friction auto",
            report.network,
            np.asarray(report.k),
            report.settings,
            seconds,
            note,
            report.pre_sliding,
        )


def automatic_models(arm: Arm) -> Iterator[Model]:
    """`identify` with `estimator="auto"`, possible bodies where they pay: judged in training."""
    network = jc.derive(arm.robot, lengths="numeric")
    start = time.process_time()
    report = jc.identify(network, arm.training, estimator="auto", checks=False, systematic=False)
    seconds = time.process_time() - start
    bodies = report.possible is not None and report.possible.used
    estimators = report.estimators
    note = "least-squares" if estimators is None else estimators.used
    note += " with physically consistent parameters" if bodies else ""
    yield Model("auto", report.network, np.asarray(report.k), report.settings, seconds, note)


FAMILIES: dict[str, Callable[[Arm], Iterator[Model]]] = {
    "usual": usual_models,
    "ours": our_models,
    "friction": friction_models,
    "auto": automatic_models,
}


def _end(estimators: jc.likelihood.EstimatorComparison) -> str:
    likelihood = estimators.likelihood
    ended = "converged" if likelihood.converged else "not converged"
    return f"{ended} after {likelihood.steps} steps"


def without_static(arm: Arm) -> jc.CSLC:
    """The network of an arm, numeric lengths, without static friction."""
    network = jc.derive(arm.robot, lengths="numeric")
    laws = arm.robot.friction_per_joint
    joints = [joint for joint, kinds in enumerate(laws, start=1) if "static" in kinds]
    return network.without_law("static", joints) if joints else network
