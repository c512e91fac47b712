"""Specimens of the payload study: identified without a payload, then performing the task."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from tqdm import tqdm

import jaxcslc as jc
import sim
from jaxcslc.control import ComputedTorque
from jaxcslc.payload import PayloadCompensation, PayloadEstimator, torque_noise
from scripts.studies.payload.bound import equations, mass_bound
from scripts.studies.payload.errors import (
    CURVE_STEP,
    estimate_curve,
    estimate_figures,
    hand_error,
    hand_figures,
    observed_estimates,
    offline_figures,
)
from scripts.studies.payload.loops import KnownPayloadLoop, LoopBatch
from scripts.studies.payload.task import CASES, INTERVAL, START, Task, rehearsal
from scripts.studies.thresholds import Refinement, refine_thresholds


METHODS = LEARNT, NOT_LEARNT, KNOWN = "learnt", "not learnt", "known"


# Of a trial run, which selects nothing.
FIXED = jc.Settings(jc.Preparation(jc.AveragedSplines(17), torque_alignment="mean"))


@dataclasses.dataclass(frozen=True)
class Arm:
    """A specimen, and what was identified before it carries anything."""

    machine: sim.Machine
    settings: jc.Settings
    fit: jc.Identification
    estimator: PayloadEstimator
    controller: ComputedTorque
    rehearsal: jc.Recording


class Arms:
    """The specimens of one case after another, and their runs of the task.

    **Attributes**

    - `select`: whether settings are selected by cross-validation, and estimates compared with
      off-line fits and bounds; of a trial run, settings are fixed, and the rehearsal is short.
    """

    def __init__(self, seeds: int, frequency: float, training: int, *, select: bool = True) -> None:
        self.network = jc.derive(jc.puma560())
        self.with_payload = self.network.with_payload()
        self.seeds, self.frequency, self.training = seeds, frequency, training
        self.select = select
        self.of_case = functools.lru_cache(maxsize=1)(self._identified)

    def _identified(self, disturbances: tuple[str, ...]) -> list[Arm]:
        """Every seed's specimen, identified from a training recording and a rehearsal."""
        machines = [
            sim.disturbed(sim.specimen(sim.puma560(), seed), *disturbances)
            for seed in range(self.seeds)
        ]
        numbers = [3 * seed for seed in range(self.seeds)]
        trained = successes(sim.close_loop(machines, sim.training(samples=self.training), numbers))
        backlash = machines[0].backlash[0] > 0
        base = FIXED.with_options(backlash=backlash)
        if self.select:
            choice = jc.choose_settings(self.network, trained[0].recording, backlash=backlash)
            base = choice.settings
        refinements = [
            refine_thresholds(self.network, run.recording, base)
            for run in tqdm(trained, desc="identification", disable=None, leave=False)
        ]
        controllers = [
            ComputedTorque(
                self.network,
                refined.fit.k,
                self.frequency,
                friction_at="reference",
                friction_width=0.02,
                torque_limit=np.array(machine.maximum_torque),
            )
            for machine, refined in zip(machines, refinements, strict=True)
        ]
        loops = LoopBatch.of([self.known_payload(controller, None) for controller in controllers])
        unloaded = sim.Trajectory(
            "rehearsal", START, loops, samples=5500 if self.select else 2500, path=rehearsal()
        )
        rehearsed = successes(
            sim.close_loop(machines, unloaded, [number + 1 for number in numbers])
        )
        return [
            Arm(
                machine,
                *self._estimator(refined, run.recording),
                controller,
                run.recording,
            )
            for machine, refined, run, controller in zip(
                machines, refinements, rehearsed, controllers, strict=True
            )
        ]

    def _estimator(
        self, refined: Refinement, rehearsed: jc.Recording
    ) -> tuple[jc.Settings, jc.Identification, PayloadEstimator]:
        """An arm's settings, fit and payload estimator."""
        top = np.abs(np.asarray(refined.patterns.qd)).max(axis=0)
        # A threshold that leaves hardly any motion would leave hardly any payload to be seen.
        slowest = np.clip(refined.rounds[-1], 0.1 * top, 0.2 * top)
        settings = refined.settings.with_options(thresholds=tuple(slowest.tolist()))
        # On-line, pairs in backlash are not left out: their errors count.
        patterns = settings.with_options(backlash=False).patterns(rehearsed)
        noise = torque_noise(self.network, refined.fit.k, patterns)
        estimator = PayloadEstimator(
            self.with_payload, refined.fit, noise, velocity_threshold=slowest
        )
        return settings, refined.fit, estimator

    def known_payload(self, controller: ComputedTorque, task: Task | None) -> KnownPayloadLoop:
        """Computed torque with the true payload of a task, or with none."""
        if task is None:
            return KnownPayloadLoop.of(controller, self.with_payload)
        return KnownPayloadLoop.of(
            controller, self.with_payload, task.body, task.picked, task.placed
        )

    def run(self, task: Task, arms: Sequence[Arm], method: str) -> list[sim.ClosedLoop]:
        """The task performed by every specimen with one method."""
        if method == LEARNT:
            loops = [PayloadCompensation(arm.controller, arm.estimator) for arm in arms]
        else:
            task_of_loop = task if method == KNOWN else None
            loops = [self.known_payload(arm.controller, task_of_loop) for arm in arms]
        return successes(
            sim.close_loop(
                [arm.machine for arm in arms],
                task.trajectory(LoopBatch.of(loops)),
                [3 * seed + 2 for seed in range(len(arms))],
                observe=observed_estimates if method == LEARNT else None,
            )
        )

    def results(self, case: str, mass: float) -> dict[str, Any]:
        """Rows of every seed, and curves, of one case and mass."""
        task, arms = Task(mass, CASES[case].last_leg), self.of_case(CASES[case].disturbances)
        # Without a payload all methods are the same.
        runs = {method: self.run(task, arms, method) for method in (METHODS if mass else (LEARNT,))}
        off = {
            method: np.array(
                [hand_error(task, arm.machine, run) for arm, run in zip(arms, some, strict=True)]
            )
            for method, some in runs.items()
        }
        rows: list[dict[str, Any]] = []
        for seed, (arm, run) in enumerate(zip(arms, runs[LEARNT], strict=True)):
            row = {"case": case, "mass": mass, "seed": seed} | estimate_figures(task, run)
            if mass and self.select:
                carried = run.recording.rows(task.carried)
                without, loaded = equations(arm.estimator, arm.rehearsal, carried)
                interval = INTERVAL * arm.estimator.update_every
                row["mass bound [kg]"] = mass_bound(without, loaded, interval)
                row |= offline_figures(self.with_payload, arm.fit, arm.settings, task, run)
            for method, errors in off.items():
                figures = hand_figures(task, errors[seed])
                row |= {f"{name}, {method}": mm for name, mm in figures.items()}
            rows.append(row)
        quantiles = {
            method: np.quantile(errors, [0.1, 0.5, 0.9], axis=0)[:, ::CURVE_STEP].tolist()
            for method, errors in off.items()
        }
        curve = estimate_curve(task, runs[LEARNT][0])
        return {"rows": rows, "curve": curve, "away": quantiles}


def successes(results: Sequence[sim.ClosedLoop | sim.SimulationError]) -> list[sim.ClosedLoop]:
    """Return all results. **Raises** the first error among them."""
    for result in results:
        if isinstance(result, sim.SimulationError):
            raise result
    return [result for result in results if isinstance(result, sim.ClosedLoop)]
