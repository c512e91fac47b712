"""Errors of payload estimates and of the hand in one run."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

import jaxcslc as jc
import sim
from jaxcslc.bodies import pseudo_inertia
from scripts.studies.payload.task import CENTRE, Task


SIGMAS = 1.96  # standard errors of a 95 % interval
CURVE_STEP = 10  # samples from point to point of a curve
_TOOL = (0.0, 0.0, 0.1)  # the point of the hand whose errors count
_BASIS = np.stack([pseudo_inertia(unit) for unit in np.eye(10)])


def observed_estimates(state: Any) -> Mapping[str, Any]:
    """The estimates in a learning loop's state, recorded after every sample."""
    estimate = state.estimator.estimate
    names = ("body", "mass", "mass_error", "centre", "centre_error", "carrying", "evidence")
    return {name: getattr(estimate, name) for name in (*names, "picked_up", "put_down")}


def estimate_figures(task: Task, run: sim.ClosedLoop) -> dict[str, Any]:
    """Alarms and errors of the estimates of one run.

    Without a payload only false alarms, the greatest evidence and the least eigenvalue of the
    pseudo-inertia.
    """
    observed, mass = run.observed, float(task.body.mass)
    carrying = observed["carrying"]
    least = np.linalg.eigvalsh(np.tensordot(observed["body"], _BASIS, 1))[:, 0].min()
    begins = np.flatnonzero(np.diff(carrying.astype(int)) == 1) + 1
    row: dict[str, Any] = {
        "false alarms": len(begins) - (1 if mass and len(begins) else 0),
        "least eigenvalue": float(least),
    }
    if not mass:
        return row | {"evidence": float(observed["evidence"].max())}
    picked_up, put_down = (float(observed[name][-1]) for name in ("picked_up", "put_down"))
    row["picked up"] = picked_up - task.departed if picked_up > 0 else np.nan
    row["put down"] = put_down - task.left if put_down > 0 else np.nan
    for moment, sample in task.moments.items():
        there = bool(carrying[sample])
        row |= estimate_errors(
            moment,
            mass,
            float(observed["mass"][sample]) if there else np.nan,
            SIGMAS * float(observed["mass_error"][sample]),
            observed["centre"][sample] - CENTRE if there else np.full(3, np.nan),
            SIGMAS * observed["centre_error"][sample],
        )
    return row


def offline_figures(
    network: jc.CSLC, fit: jc.Identification, settings: jc.Settings, task: Task, run: sim.ClosedLoop
) -> dict[str, float]:
    """Errors of `fit_payload` on the recording of one run.

    **Arguments**

    - `network`: with payload.
    - `fit`, `settings`: of the arm without payload.
    """
    recording = run.recording.rows(task.carried)
    payload = jc.fit_payload(
        network, settings.patterns(recording), previous=fit, solver=settings.solver
    )
    interval = payload.physical_interval()
    half = 0.5 * (interval[:, 1] - interval[:, 0])
    value = np.asarray(payload.physical)
    mass = float(task.body.mass)
    return estimate_errors("off-line", mass, value[0], half[0], value[1:4] - CENTRE, half[1:4])


def estimate_errors(
    moment: str,
    mass: float,
    estimate: float,
    half: float,
    off: Float[np.ndarray, "3"],
    half_centre: Float[np.ndarray, "3"],
) -> dict[str, float]:
    """Errors and half intervals of an estimate, in % and mm; NaN without an estimate.

    **Arguments**

    - `mass`: true.
    - `estimate`, `half`: of the mass, and half of its interval [kg].
    - `off`, `half_centre`: error of the centre of gravity, and half of its intervals [m].
    """
    there = np.isfinite(estimate)
    return {
        f"mass error [%], {moment}": 100.0 * (estimate - mass) / mass,
        f"mass interval [%], {moment}": 100.0 * half / mass if there else np.nan,
        f"mass covered, {moment}": float(abs(estimate - mass) <= half) if there else np.nan,
        f"centre error [mm], {moment}": 1e3 * float(np.linalg.norm(off)),
        **{
            f"{axis} error [mm], {moment}": 1e3 * float(e)
            for axis, e in zip("xyz", off, strict=True)
        },
        f"centre interval [mm], {moment}": 1e3 * float(np.max(half_centre)) if there else np.nan,
        f"centre covered, {moment}": float(np.mean(np.abs(off) <= half_centre))
        if there
        else np.nan,
    }


def hand_error(
    task: Task, machine: sim.Machine, run: sim.ClosedLoop
) -> Float[np.ndarray, " samples"]:
    """Distance of the hand from its reference [mm]."""
    hand = sim.Hand.of(machine.robot, _TOOL)
    origin = np.broadcast_to(run.recording.position[0], run.truth.position.shape)
    reference = task.path.reference(run.truth.time[:, None], origin).q
    actual, demanded = (np.asarray(hand.locate(q)[0]) for q in (run.truth.position, reference))
    return 1e3 * np.linalg.norm(actual - demanded, axis=1)


def hand_figures(task: Task, error: Float[np.ndarray, " samples"]) -> dict[str, float]:
    """The hand's errors [mm]: while it carries, on arrival, and at rest at the place."""

    def rms(start: float, stop: float) -> float:
        return float(np.sqrt(np.mean(error[task.sample(start) : task.sample(stop)] ** 2)))

    return {
        "carrying [mm]": rms(task.departed, task.arrived),
        "last leg [mm]": rms(float(task.path.arrivals[2]) + 0.1, task.arrived),
        "arrival [mm]": rms(task.arrived - 0.1, task.arrived),
        "place [mm]": float(error[task.sample(task.placed) - 1]),
    }


def estimate_curve(task: Task, run: sim.ClosedLoop) -> dict[str, Any]:
    """The estimates of one run over time, thinned out."""
    names = ("mass", "mass_error", "centre", "centre_error", "carrying")
    thinned = {name: run.observed[name][::CURVE_STEP].tolist() for name in names}
    times = {name: float(run.observed[name][-1]) for name in ("picked_up", "put_down")}
    return thinned | times | {"picked": task.picked, "placed": task.placed}
