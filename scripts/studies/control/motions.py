"""Motions of the control study: go-to and circle, performed by all machines side by side."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

import sim
from scripts.studies.control.coefficients import SETS, machine_of
from scripts.studies.control.loops import START, WITHOUT_MODEL, LoopDesign, stacked


Rows = list[dict[str, Any]]

INTERVAL = 0.002
REST = 50  # samples after a motion that count as well
MOTIONS = ("go-to", "circle")
CENTRE, RADIUS, NORMAL = (0.6, 0.15, -0.1), 0.1, (1.0, 0.0, 1.0)
_MARGIN = 0.2  # of a joint's range at either end, that targets keep away from
_NEAR = np.array([0.0, -0.5, 2.9, 0.0, 0.8, 0.0])
_TRACE_STEP = 5  # samples


def path_of(motion: str, duration: float, seeds: Sequence[int]) -> tuple[np.ndarray, Any]:
    """Start and path of a motion; in a go-to, each seed has its target pose."""
    machine = sim.puma560()
    if motion == "circle":
        path = sim.circle(
            machine,
            CENTRE,
            RADIUS,
            near=_NEAR,
            duration=duration,
            normal=NORMAL,
            point=(0.0, 0.0, sim.FLANGE),
            interval=INTERVAL,
        )
        return path.start, path
    ends = np.stack([sim.go_to(machine, seed, 1.0, margin=_MARGIN)[1].end for seed in seeds])
    one = np.ones((len(seeds), 1))
    return START, sim.ViaPoints(ends[:, None], duration * one, 0.0 * one)


def performed(
    design: LoopDesign, vectors: Mapping[str, np.ndarray], motion: str, duration: float,
    controller: str, seeds: Sequence[int],
) -> Rows:  # fmt: skip
    """Rows of all coefficient sets of all seeds under one controller, on one motion."""
    sets = ["none"] if controller in WITHOUT_MODEL else list(SETS)
    cases = [(name, seed) for name in sets for seed in seeds]
    start, path = path_of(motion, duration, [seed for _, seed in cases])
    loops = [
        design.loop(controller, vectors["truth" if name == "none" else name][seed], start)
        for name, seed in cases
    ]
    trajectory = sim.Trajectory(
        f"{motion}, {duration:g} s, {controller}", start, stacked(loops),
        round(duration / INTERVAL) + 1 + REST, INTERVAL, path=path, per_machine=True,
    )  # fmt: skip
    machines = [machine_of(seed) for _, seed in cases]
    results = sim.close_loop(machines, trajectory, [seed for _, seed in cases], progress=True)
    rows: Rows = []
    for i, ((name, seed), result) in enumerate(zip(cases, results, strict=True)):
        row: dict[str, Any] = {"motion": motion, "duration": duration, "controller": controller,
                               "coefficients": name, "seed": seed}  # fmt: skip
        if isinstance(result, sim.SimulationError):
            rows.append({**row, "failed": str(result)})
            continue
        if isinstance(path, sim.ViaPoints):
            alone: Any = sim.ViaPoints(path.poses[i], path.durations[i], path.stays[i])
            origin = result.recording.position[0]
        else:
            alone, origin = path, start
        time = result.truth.time
        reference = alone.reference(time[:, None], np.tile(origin, (time.size, 1))).q
        rows.append({**row, **figures(result, reference, design.limit, trace=seed == 0)})
    return rows


def figures(
    result: sim.ClosedLoop, reference: Float[np.ndarray, "samples joints"], limit: np.ndarray, *,
    trace: bool,
) -> dict[str, Any]:  # fmt: skip
    """Errors of the links and the flange, and effort.

    **Arguments**

    - `reference`: joint positions of the path.
    - `trace`: whether the motion itself goes into the row, thinned out.
    """
    hand = sim.Hand.of(sim.puma560().robot, (0.0, 0.0, sim.FLANGE))
    joint = 1e3 * (reference - result.truth.position)
    asked, torque = np.asarray(hand.locate(reference)[0]), result.recording.torque
    off = 1e3 * (np.asarray(hand.locate(result.truth.position)[0]) - asked)
    distance = np.linalg.norm(off, axis=1)
    square = np.mean(torque**2, axis=0)
    row: dict[str, Any] = {
        "hand rms [mm]": rms(distance),
        "hand largest [mm]": float(distance.max()),
        "torque rms [N m]": float(np.sqrt(square.sum())),
        "squared torque [N² m² s]": float(square.sum() * result.truth.time[-1]),
        "saturated": float(np.mean(np.abs(torque) >= 0.999 * limit)),
    }
    for i in range(reference.shape[1]):
        row[f"joint {i + 1} rms [mrad]"] = rms(joint[:, i])
        row[f"joint {i + 1} largest [mrad]"] = float(np.abs(joint[:, i]).max())
        row[f"joint {i + 1} torque rms [N m]"] = float(np.sqrt(square[i]))
    if trace:
        columns = {"time": result.truth.time, "asked": asked, "off": off, "joint": joint}
        row["trace"] = {
            name: values[::_TRACE_STEP].round(6).tolist() for name, values in columns.items()
        }
    return row


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))
