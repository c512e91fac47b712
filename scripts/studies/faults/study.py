"""Faults in the loop: how soon the guard detects them, and how soon the arm is at rest.

Simulated PUMA 560s, a specimen for each seed, with all disturbances of Section 7.2, follow a path
under computed torque with coefficients that are some percent off, watched by
`jaxcslc.control.FaultMonitor`.
Every kind of fault happens at every joint, at several moments of the motion; longer paths without
a fault show false alarms. A line for each kind:

- **named**: of all runs, those in which this joint and this fault were detected, and nothing else;
- **detected after**: from the beginning of the fault [ms];
- **off by**: distance of the joint from its path at that time [mrad]. It matters most for a stuck
  encoder: a joint that hardly moves, or a drive without torque, shows no fault;
- **at rest after**: from the beginning of the fault until all joints are slower than 0.02 rad/s
  [s].

Runs that leave a joint's range count as not named.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import jaxcslc as jc
import sim
from jaxcslc._text_table import text_table
from jaxcslc.control import FAULTS, ComputedTorque, FaultMonitor, OutputFeedback
from jaxcslc.report import all_or_nothing, write_csv
from scripts.studies import command
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store
from scripts.studies.truth import true_coefficients


jc.enable_x64()

_START = np.array([0.0, -1.2, 0.6, 0.3, 0.5, 0.2])
_REACH = np.array([0.8, 0.5, 0.5, 0.9, 0.9, 1.2])
_STILL = 0.02  # rad/s
_DURATION = 1.4  # from a fault on [s]
KEYS = ("fault", "joint", "moment")
HEALTHY = "healthy"  # in place of a fault, and the number of the path in place of the moment
_MOMENTS = (0.25, 0.5, 0.8, 1.35)  # of faults [s]: on the way to the first pose, and to the second


def path(poses: int, seed: int) -> sim.ViaPoints:
    """Return the path from pose to pose, one second for each."""
    rng = np.random.default_rng(seed)
    return sim.ViaPoints(
        _START + rng.uniform(-1, 1, (poses, 6)) * _REACH, np.full(poses, 1.0), np.full(poses, 0.1)
    )


def guards(machines: Sequence[sim.Machine], error: float) -> FaultMonitor:
    """A guard for each machine, with coefficients that are wrong by a part of `error` at most."""
    network = jc.derive(jc.puma560())
    rng = np.random.default_rng(0)
    true = np.stack([np.asarray(true_coefficients(network, machine)) for machine in machines])
    wrong = true * (1 + error * rng.uniform(-1, 1, true.shape))
    limit = np.array(machines[0].maximum_torque)

    def one(k: Array) -> FaultMonitor:
        controller = ComputedTorque(
            network, k, 20.0, friction_at="reference", friction_width=0.02, torque_limit=limit
        )
        return FaultMonitor(OutputFeedback(controller), network, k, torque_limit=limit)

    return eqx.filter_vmap(one)(jnp.asarray(wrong))


def run(
    machines: Sequence[sim.Machine],
    guard: FaultMonitor,
    along: sim.ViaPoints,
    samples: int,
    fault: sim.Fault | None,
) -> list[sim.ClosedLoop | sim.SimulationError]:
    """Return all machines along a path, side by side."""
    trajectory = sim.Trajectory(
        "guarded",
        _START,
        guard,
        samples,
        faults=() if fault is None else (fault,),
        path=along,
        per_machine=True,
    )

    def alarms(state: Any) -> dict[str, Array]:
        return {"fault": state.fault, "detected": state.detected}

    return sim.close_loop(machines, trajectory, list(range(len(machines))), observe=alarms)


def row_of(
    result: sim.ClosedLoop | sim.SimulationError, fault: sim.Fault, along: sim.ViaPoints
) -> dict[str, Any]:
    """The row of one run."""
    assert fault.joint is not None
    joint = fault.joint - 1
    row: dict[str, Any] = {"fault": fault.kind, "joint": fault.joint, "begins_s": fault.start}
    if isinstance(result, sim.SimulationError):
        return row | {"named": False, "what": str(result)}
    codes, detected = result.observed["fault"][-1], result.observed["detected"][-1]
    what = ", ".join(f"joint {j + 1}: {FAULTS[c]}" for j, c in enumerate(codes) if c)
    row |= {"named": what == f"joint {fault.joint}: {fault.kind}", "what": what or "nothing"}
    if not row["named"]:
        return row
    when = float(detected[joint])
    sample = int(np.searchsorted(result.truth.time, when))
    reference = along.reference(np.array([when]), result.recording.position[0]).q
    off = result.truth.position[sample, joint] - reference[joint]
    fast = np.flatnonzero(np.max(np.abs(result.truth.velocity), axis=1) > _STILL)
    return row | {
        "detected_after_ms": 1e3 * (when - fault.start),
        "off_by_mrad": 1e3 * abs(float(off)),
        "at_rest_after_s": float(result.truth.time[fast[-1]]) - fault.start,
    }


def spread(values: Sequence[float], digits: str) -> str:
    """Median, ninety-fifth percentile and worst."""
    if not values:
        return "-"
    array: Float[np.ndarray, " runs"] = np.array(values)
    return " / ".join(
        format(x, digits) for x in (np.median(array), np.percentile(array, 95), np.max(array))
    )


def make_rows(options: argparse.Namespace, rows: Rows) -> None:
    """Runs all machines on every path, and with every fault, that has no row yet."""
    machines = [sim.disturbed(sim.specimen(sim.puma560(), seed)) for seed in range(options.seeds)]
    paths = [key for key in healthy_keys(options) if key not in rows]
    faults = [key for key in fault_keys(options) if key not in rows]
    if not paths and not faults:
        return
    guard = guards(machines, options.error)
    total = len(healthy_keys(options)) + len(fault_keys(options))
    done = total - len(paths) - len(faults)
    with command.progress(desc="paths and faults", unit="run", total=total, initial=done) as bar:
        for key in paths:
            results = run(machines, guard, path(8, 100 + int(key[2])), 4400, None)
            alarms = sum(
                not isinstance(result, sim.ClosedLoop) or bool(result.observed["fault"].any())
                for result in results
            )
            rows.add(dict(zip(KEYS, key, strict=True)) | {"alarms": alarms})
            bar.update()
        for key in faults:
            kind, joint, moment = key
            fault = sim.Fault(kind, joint, start=moment)
            samples = round((fault.start + _DURATION) / 0.002)
            along = path(4, joint)
            results = run(machines, guard, along, samples, fault)
            machine_rows = [
                {"seed": i} | row_of(result, fault, along) for i, result in enumerate(results)
            ]
            rows.add(dict(zip(KEYS, key, strict=True)) | {"machines": machine_rows})
            bar.update()


def healthy_keys(options: argparse.Namespace) -> list[tuple[str, int, float]]:
    """Return the keys of the paths without a fault, by their number."""
    return [(HEALTHY, 0, float(number)) for number in range(options.healthy)]


def fault_keys(options: argparse.Namespace) -> list[tuple[str, int, float]]:
    """Return the keys of the faults: kind, joint and moment [s]."""
    return [
        (kind, joint, moment)
        for kind in FAULTS[1:]
        for joint in options.joints
        for moment in _MOMENTS[: options.moments]
    ]


def table(rows: Sequence[dict[str, Any]]) -> list[list[str]]:
    """A line for each kind of fault, the head first: median, 95th percentile and worst."""
    lines = [
        [
            "fault",
            "named rightly",
            "detected after [ms], median / 95 % / worst",
            "off by [mrad]",
            "at rest after [s]",
        ]
    ]
    for kind in FAULTS[1:]:
        of_kind = [row for row in rows if row["fault"] == kind]
        named = [row for row in of_kind if row["named"]]
        lines.append(
            [
                kind,
                f"{len(named)} of {len(of_kind)}",
                spread([row["detected_after_ms"] for row in named], ".0f"),
                spread([row["off_by_mrad"] for row in named], ".1f"),
                spread([row["at_rest_after_s"] for row in named], ".2f"),
            ]
        )
    return lines


def study(options: argparse.Namespace) -> int:
    """Runs all machines with and without faults, prints the table and writes the file."""
    digest = made_of({"seeds": options.seeds, "error": options.error}, [Path(__file__)])
    finished = Rows(options.output / "rows.jsonl", KEYS, digest)
    make_rows(options, finished)
    alarms = sum(finished[key]["alarms"] for key in healthy_keys(options))
    rows = [row for key in fault_keys(options) for row in finished[key]["machines"]]
    for row in rows:
        if not row["named"]:
            print(f"{row['fault']}, joint {row['joint']}: {row['what']}", file=sys.stderr)
    head, *lines = table(rows)
    print(text_table(head, lines, left=("fault",)))
    runs = options.healthy * options.seeds
    print(f"healthy: {alarms} of {runs} runs alarmed ({8 * runs} motions)")
    store(
        options,
        "faults",
        f"{options.seeds} machines, {runs} healthy runs",
        {"faults": [head, *lines]},
    )
    names = ["seed", "fault", "joint", "begins_s", "named", "what"]
    names += ["detected_after_ms", "off_by_mrad", "at_rest_after_s"]
    with all_or_nothing(options.output) as folder:
        write_csv(
            folder / "faults.csv", [{name: row.get(name, "") for name in names} for row in rows]
        )
    print(f"wrote {options.output / 'faults.csv'}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "fault_study")
    parser.add_argument("--seeds", type=int, default=20, help="machines, side by side")
    parser.add_argument("--moments", type=int, default=len(_MOMENTS), help="of each fault")
    parser.add_argument("--healthy", type=int, default=10, help="paths of eight poses, no fault")
    parser.add_argument("--joints", type=int, nargs="+", default=[1, 2, 3, 4, 5, 6])
    parser.add_argument("--error", type=float, default=0.05, help="of coefficients, at most")
    command.add_store(parser)
    options = command.parse(parser, argv, seeds=2, moments=1, healthy=1, joints=[2])
    command.require_least(parser, options, seeds=1, healthy=0)
    if not 1 <= options.moments <= len(_MOMENTS):
        parser.error(f"--moments is {options.moments}; expected 1 to {len(_MOMENTS)}")
    if not set(options.joints) <= set(range(1, 7)):
        parser.error(f"--joints are {options.joints}; expected some of 1 to 6")
    runs = options.healthy + len(fault_keys(options))
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=30 + runs * (1.0 + 0.2 * options.seeds),
    )


if __name__ == "__main__":
    raise SystemExit(main())
