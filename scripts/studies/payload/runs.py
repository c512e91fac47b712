"""What the payload study does: the task, specimens that are identified, and runs of the task."""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

import jaxcslc as jc
import sim
from jaxcslc.control import ComputedTorque
from jaxcslc.inertia import pseudo_inertia
from jaxcslc.payload import CarryingLoop, PayloadEstimator, torque_noise
from scripts.studies.payload.loops import Team, Told


INTERVAL = 0.002  # s
WAYS = LEARNT, NOT_LEARNT, KNOWN = "learnt", "not learnt", "known"
MOMENTS = (0.5, 1.0, 2.0)  # of motion with the payload [s]
CENTRE, BOX = np.array([0.02, -0.03, 0.10]), 0.12  # of gravity, and how large it is [m]
TOOL = (0.0, 0.0, 0.1)  # the point of the hand that errors are of
START = np.array([0.0, -1.2, 2.6, 0.8, -0.3, -1.0])
PICK = np.array([0.7, -0.35, 2.9, 0.3, 0.6, 0.2])
VIA = np.array([[0.3, -1.0, 2.6, -0.7, 1.1, 1.2], [-0.4, -0.9, 3.1, 0.8, 0.1, -1.0]])
PLACE = np.array([-0.8, -0.45, 2.75, -0.2, 0.8, 0.4])
LEG = 1.1  # s; of the ways on which something is carried
SIGMAS = 1.96  # of a 95 % interval
EVERY = 10  # samples from point to point of a curve


class Case(NamedTuple):
    """What is wrong with the machines, and how long the last way with the payload takes [s]."""

    words: str
    disturbances: tuple[str, ...]
    last: float = LEG


CASES = {
    "encoders": Case("quantised encoders", ("quantisation",)),
    "friction": Case("static friction as well", ("quantisation", "static friction")),
    "slowly": Case("static friction, placed slowly", ("quantisation", "static friction"), 2.5),
    "everything": Case("all disturbances", ()),
}


class Task:
    """Where the arm is to be, and what it carries when."""

    def __init__(self, mass: float, last: float) -> None:
        self.path = sim.ViaPoints(
            np.stack([PICK, *VIA, PLACE, START]),
            np.array([1.2, LEG, LEG, last, 1.2]),
            np.array([0.4, 0.1, 0.1, 0.6, 0.3]),
        )
        there = self.path.arrivals
        self.picked, self.placed = there[0] + 0.2, there[3] + 0.4
        self.arrived, self.left = there[3], there[3] + 0.6  # the place
        self.departed = there[0] + 0.4
        self.samples = round((there[-1] + 0.3) / INTERVAL) + 1
        self.time = INTERVAL * np.arange(self.samples)
        self.body = jc.LinkParameters(mass, CENTRE, mass * BOX**2 / 6 * np.eye(3))
        self.loads = (sim.Load(self.picked, self.body, self.placed),) if mass else ()
        origin = np.broadcast_to(START, (self.samples, len(START)))
        moving = np.any(self.path.reference(self.time[:, None], origin).qd != 0.0, axis=1)
        after = INTERVAL * np.cumsum(moving & (self.time > self.departed))
        before = self.at(self.placed) - 1
        self.moments = {f"{t:g} s": int(np.searchsorted(after, t)) for t in MOMENTS}
        self.moments["end"] = before

    def at(self, time: float) -> int:
        """The sample at a time."""
        return round(time / INTERVAL)

    def trajectory(self, loop: Any) -> sim.Trajectory:
        return sim.Trajectory(
            "task", START, sim.Servo(loop, self.path), self.samples, loads=self.loads
        )


@dataclasses.dataclass(frozen=True)
class Arm:
    """A specimen, and what is known of it before it carries anything."""

    machine: sim.Machine
    settings: jc.Settings
    fit: jc.Identification
    estimator: PayloadEstimator
    controller: ComputedTorque


class Study:
    """Specimens of one case after another."""

    def __init__(self, seeds: int, frequency: float, training: int) -> None:
        self.network = jc.derive(jc.puma560())
        self.whole = self.network.with_payload()
        self.seeds, self.frequency, self.training = seeds, frequency, training
        self.arms = functools.lru_cache(maxsize=1)(self._arms)

    def _arms(self, disturbances: tuple[str, ...]) -> list[Arm]:
        seeds = self.seeds
        machines = [
            sim.disturbed(sim.specimen(sim.puma560(), seed), *disturbances) for seed in range(seeds)
        ]
        own = [3 * seed for seed in range(seeds)]
        trained = successes(sim.close_loop(machines, sim.training(samples=self.training), own))
        base = jc.choose_settings(
            self.network, trained[0].recording, backlash=machines[0].backlash[0] > 0
        ).settings
        found = [
            jc.refine_thresholds(self.network, each.recording, base)
            for each in tqdm(trained, desc="identification", disable=None, leave=False)
        ]
        controllers = [
            ComputedTorque(
                self.network,
                each.fit.k,
                self.frequency,
                friction_at="reference",
                friction_width=0.02,
                torque_limit=np.array(machine.maximum_torque),
            )
            for machine, each in zip(machines, found, strict=True)
        ]
        rehearsal = sim.Trajectory(
            "rehearsal",
            START,
            sim.Servo(Team.of([self.told(each, None) for each in controllers]), rehearsed()),
            samples=5500,
        )
        empty = successes(sim.close_loop(machines, rehearsal, [seed + 1 for seed in own]))
        arms: list[Arm] = []
        for machine, each, run, controller in zip(machines, found, empty, controllers, strict=True):
            top = np.abs(np.asarray(each.patterns.qd)).max(axis=0)
            # A threshold that leaves hardly any motion would leave hardly any payload to be seen.
            slowest = np.clip(np.array(each.settings.thresholds), 0.1 * top, 0.2 * top)
            settings = dataclasses.replace(each.settings, thresholds=tuple(slowest.tolist()))
            # On the way gears that are apart are not left out: their errors count.
            open_eyed = dataclasses.replace(settings, backlash=False).patterns(run.recording)
            noise = torque_noise(self.network, each.fit.k, open_eyed)
            estimator = PayloadEstimator(self.whole, each.fit, noise, slowest=slowest)
            arms.append(Arm(machine, settings, each.fit, estimator, controller))
        return arms

    def told(self, controller: ComputedTorque, task: Task | None) -> Told:
        """Computed torque that is told what it carries, or nothing."""
        body = None if task is None else task.body
        return Told.of(controller, self.whole, body, *((task.picked, task.placed) if task else ()))

    def run(self, task: Task, arms: Sequence[Arm], way: str) -> list[sim.ClosedLoop]:
        """The task done by every specimen in one way."""
        if way == LEARNT:
            loops = [CarryingLoop(arm.controller, arm.estimator) for arm in arms]
        else:
            loops = [self.told(arm.controller, task if way == KNOWN else None) for arm in arms]
        return successes(
            sim.close_loop(
                [arm.machine for arm in arms],
                task.trajectory(Team.of(loops)),
                [3 * seed + 2 for seed in range(len(arms))],
                observe=estimates if way == LEARNT else None,
            )
        )

    def unit(self, name: str, mass: float) -> dict[str, Any]:
        """Rows of every seed, and curves, of one case and mass."""
        task, arms = Task(mass, CASES[name].last), self.arms(CASES[name].disturbances)
        # Without a payload there is nothing to know, and nothing that is not learnt.
        runs = {way: self.run(task, arms, way) for way in (WAYS if mass else (LEARNT,))}
        away = {
            way: np.array([hand_error(task, *pair) for pair in zip(arms, each, strict=True)])
            for way, each in runs.items()
        }
        rows: list[dict[str, Any]] = []
        for seed, (arm, run) in enumerate(zip(arms, runs[LEARNT], strict=True)):
            row = {"case": name, "mass": mass, "seed": seed} | self.learnt(task, arm, run)
            for way, each in away.items():
                row |= {f"{key}, {way}": mm for key, mm in summed(task, each[seed]).items()}
            rows.append(row)
        quantiles = {
            way: np.quantile(each, [0.1, 0.5, 0.9], axis=0)[:, ::EVERY].tolist()
            for way, each in away.items()
        }
        return {"rows": rows, "curve": curve(task, runs[LEARNT][0]), "away": quantiles}

    def learnt(self, task: Task, arm: Arm, run: sim.ClosedLoop) -> dict[str, Any]:
        """What the estimate was worth, of one run."""
        seen, mass = run.observed, float(task.body.mass)
        carrying = seen["carrying"]
        least = np.linalg.eigvalsh(np.tensordot(seen["body"], BASIS, 1))[:, 0].min()
        turned_on = np.flatnonzero(np.diff(carrying.astype(int)) == 1) + 1
        row: dict[str, Any] = {
            "false alarms": len(turned_on) - (1 if mass and len(turned_on) else 0),
            "least eigenvalue": float(least),
        }
        if not mass:
            return row
        picked, put = float(seen["picked_up"][-1]), float(seen["put_down"][-1])
        row["picked up"] = picked - task.departed if picked > 0 else np.nan
        row["put down"] = put - task.left if put > 0 else np.nan
        for moment, sample in task.moments.items():
            found = bool(carrying[sample])
            half = SIGMAS * seen["centre_error"][sample]
            off = seen["centre"][sample] - CENTRE
            row |= judged(
                moment,
                mass,
                float(seen["mass"][sample]) if found else np.nan,
                SIGMAS * float(seen["mass_error"][sample]),
                off if found else np.full(3, np.nan),
                half,
            )
        inside = slice(task.at(task.picked), task.at(task.placed))
        record = run.recording
        cut = jc.Recording(record.time[inside], record.position[inside], record.torque[inside])
        fit = jc.fit_payload(
            self.whole, arm.settings.patterns(cut), previous=arm.fit, solver=arm.settings.solver
        )
        interval = fit.physical_interval()
        half = 0.5 * (interval[:, 1] - interval[:, 0])
        value = np.asarray(fit.physical)
        return row | judged("off-line", mass, value[0], half[0], value[1:4] - CENTRE, half[1:4])


BASIS = np.stack([pseudo_inertia(unit) for unit in np.eye(10)])


def judged(
    moment: str, mass: float, found: float, half: float, off: np.ndarray, wide: np.ndarray
) -> dict[str, float]:
    """Errors and intervals of an estimate, in % and mm; NaN of what was not found."""
    known = np.isfinite(found)
    return {
        f"mass error [%], {moment}": 100.0 * (found - mass) / mass,
        f"mass interval [%], {moment}": 100.0 * half / mass if known else np.nan,
        f"mass held, {moment}": float(abs(found - mass) <= half) if known else np.nan,
        f"centre error [mm], {moment}": 1e3 * float(np.linalg.norm(off)),
        **{
            f"{axis} error [mm], {moment}": 1e3 * float(e)
            for axis, e in zip("xyz", off, strict=True)
        },
        f"centre interval [mm], {moment}": 1e3 * float(np.max(wide)) if known else np.nan,
        f"centre held, {moment}": float(np.mean(np.abs(off) <= wide)) if known else np.nan,
    }


def hand_error(task: Task, arm: Arm, run: sim.ClosedLoop) -> np.ndarray:
    """How far the hand is from where it should be, (samples,) [mm]."""
    hand = sim.Hand.of(arm.machine.robot, TOOL)
    origin = np.broadcast_to(run.recording.position[0], run.truth.position.shape)
    wanted = task.path.reference(run.truth.time[:, None], origin).q
    return 1e3 * np.linalg.norm(
        np.asarray(hand.locate(run.truth.position)[0]) - np.asarray(hand.locate(wanted)[0]), axis=1
    )


def summed(task: Task, away: np.ndarray) -> dict[str, float]:
    """Of the hand's errors [mm]: while it carries, on arrival, and at rest at the place."""

    def rms(start: float, stop: float) -> float:
        return float(np.sqrt(np.mean(away[task.at(start) : task.at(stop)] ** 2)))

    return {
        "carrying [mm]": rms(task.departed, task.arrived),
        "last leg [mm]": rms(float(task.path.arrivals[2]) + 0.1, task.arrived),
        "arrival [mm]": rms(task.arrived - 0.1, task.arrived),
        "place [mm]": float(away[task.at(task.placed) - 1]),
    }


def estimates(state: sim.ServoState) -> Mapping[str, Any]:
    """What is seen of the learning loops after every sample."""
    found = state.loop.learning.estimate
    names = (
        "body",
        "mass",
        "mass_error",
        "centre",
        "centre_error",
        "carrying",
        "picked_up",
        "put_down",
    )
    return {name: getattr(found, name) for name in names}


def curve(task: Task, run: sim.ClosedLoop) -> dict[str, Any]:
    """The estimates of one run over time, thinned out."""
    seen = run.observed
    names = ("mass", "mass_error", "centre", "centre_error", "carrying")
    every = {name: seen[name][::EVERY].tolist() for name in names}
    times = {name: float(seen[name][-1]) for name in ("picked_up", "put_down")}
    return every | times | {"picked": task.picked, "placed": task.placed}


def rehearsed() -> sim.ViaPoints:
    """Other motions, unloaded."""
    middle = np.array([0.0, -1.2, 2.6, 0.0, 0.3, 0.0])
    spread = np.array([1.0, 0.6, 0.6, 1.6, 1.2, 1.6])
    poses = middle + np.random.default_rng(5).uniform(-1.0, 1.0, (10, 6)) * spread
    return sim.ViaPoints(poses, np.full(10, 1.0), np.full(10, 0.1))


def successes(results: Sequence[sim.ClosedLoop | sim.SimulationError]) -> list[sim.ClosedLoop]:
    """**Raises** the first error among them."""
    for result in results:
        if isinstance(result, sim.SimulationError):
            raise result
    return [result for result in results if isinstance(result, sim.ClosedLoop)]
