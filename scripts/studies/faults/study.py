"""Faults in the loop: how soon each is found and named, and how soon the arm is at rest.

Simulated PUMA 560s, a specimen a seed, with all disturbances of Section 7.2, follow a path under
computed torque with coefficients that are some percent off, watched by `jaxcslc.control.Guard`.
Every kind of fault happens at every joint, at several moments of the motion; and nothing happens at
all, over longer paths. A line a kind:

- **named**: of so many runs, those in which this joint and this fault were found, and nothing else;
- **found after**: from the beginning of the fault [ms];
- **off by**: how far the joint then was from its path [mrad], which for a stuck encoder is what
  counts: a joint that hardly moves, or a drive that hardly pushes, tells nothing;
- **at rest after**: from the beginning of the fault until no joint moves faster than 0.02 rad/s any
  more [s].

Runs that leave a joint's range count as not named.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from tqdm import tqdm

import jaxcslc as jc
import sim
from jaxcslc.control import FAULTS, ComputedTorque, Guard, Loop
from jaxcslc.identification import all_or_nothing, text_table, write_csv


jax.config.update("jax_enable_x64", True)

_START = np.array([0.0, -1.2, 0.6, 0.3, 0.5, 0.2])
_REACH = np.array([0.8, 0.5, 0.5, 0.9, 0.9, 1.2])
_STILL = 0.02  # rad/s
_WATCHED = 1.4  # from a fault on [s]
_MOMENTS = (0.25, 0.5, 0.8, 1.35)  # of faults [s]: on the way to the first pose, and to the second


def path(poses: int, seed: int) -> sim.ViaPoints:
    """From pose to pose, a second each."""
    rng = np.random.default_rng(seed)
    return sim.ViaPoints(
        _START + rng.uniform(-1, 1, (poses, 6)) * _REACH, np.full(poses, 1.0), np.full(poses, 0.1)
    )


def guards(machines: Sequence[sim.Machine], error: float) -> Guard:
    """One a machine, with the coefficients of a fit that is `error` times off at most."""
    network = jc.derive(jc.puma560())
    rng = np.random.default_rng(0)
    known = np.stack(
        [
            np.asarray(
                network.coefficients_from(machine.links, viscous=machine.viscous, dry=machine.dry)
            )
            for machine in machines
        ]
    )
    known = known * (1 + error * rng.uniform(-1, 1, known.shape))
    limit = np.array(machines[0].maximum_torque)

    def one(k: Array) -> Guard:
        controller = ComputedTorque(
            network, k, 20.0, friction_at="reference", friction_width=0.02, torque_limit=limit
        )
        return Guard(Loop(controller), network, k, torque_limit=limit)

    return eqx.filter_vmap(one)(jnp.asarray(known))


def run(
    machines: Sequence[sim.Machine],
    watched: Guard,
    way: sim.ViaPoints,
    samples: int,
    fault: sim.Fault | None,
) -> list[sim.ClosedLoop | sim.SimulationError]:
    trajectory = sim.Trajectory(
        "guarded",
        _START,
        sim.Servo(watched, way, per_machine=True),
        samples,
        faults=() if fault is None else (fault,),
    )

    def seen(state: Any) -> dict[str, Array]:
        return {"fault": state.loop.fault, "found": state.loop.found}

    return sim.close_loop(machines, trajectory, list(range(len(machines))), observe=seen)


def judged(
    result: sim.ClosedLoop | sim.SimulationError, fault: sim.Fault, way: sim.ViaPoints
) -> dict[str, Any]:
    """One run's row."""
    assert fault.joint is not None
    joint = fault.joint - 1
    row: dict[str, Any] = {"fault": fault.kind, "joint": fault.joint, "begins_s": fault.start}
    if isinstance(result, sim.SimulationError):
        return row | {"named": False, "what": str(result)}
    codes, found = result.observed["fault"][-1], result.observed["found"][-1]
    what = ", ".join(f"joint {j + 1}: {FAULTS[c]}" for j, c in enumerate(codes) if c)
    row |= {"named": what == f"joint {fault.joint}: {fault.kind}", "what": what or "nothing"}
    if not row["named"]:
        return row
    when = float(found[joint])
    at = int(np.searchsorted(result.truth.time, when))
    wanted = way.reference(np.array([when]), result.recording.position[0]).q
    off = result.truth.position[at, joint] - wanted[joint]
    fast = np.flatnonzero(np.max(np.abs(result.truth.velocity), axis=1) > _STILL)
    return row | {
        "found_after_ms": 1e3 * (when - fault.start),
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


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=20, help="machines, side by side")
    parser.add_argument("--moments", type=int, default=len(_MOMENTS), help="of each fault")
    parser.add_argument("--healthy", type=int, default=10, help="paths of eight poses, no fault")
    parser.add_argument("--joints", type=int, nargs="+", default=[1, 2, 3, 4, 5, 6])
    parser.add_argument("--error", type=float, default=0.05, help="of coefficients, at most")
    parser.add_argument("-o", "--output", type=Path, default=Path("build/fault_study"))
    options = parser.parse_args(arguments)
    if options.seeds < 1:
        parser.error(f"--seeds is {options.seeds}; expected 1 or more")
    if not 1 <= options.moments <= len(_MOMENTS):
        parser.error(f"--moments is {options.moments}; expected 1 to {len(_MOMENTS)}")
    if not set(options.joints) <= set(range(1, 7)):
        parser.error(f"--joints are {options.joints}; expected some of 1 to 6")
    machines = [sim.disturbed(sim.specimen(sim.puma560(), seed)) for seed in range(options.seeds)]
    watched = guards(machines, options.error)

    alarms = 0
    for seed in tqdm(range(options.healthy), desc="healthy", disable=None):
        for result in run(machines, watched, path(8, 100 + seed), 4400, None):
            ok = isinstance(result, sim.ClosedLoop) and not result.observed["fault"].any()
            alarms += not ok
    cases = [
        sim.Fault(kind, joint, start=moment)
        for kind in FAULTS[1:]
        for joint in options.joints
        for moment in _MOMENTS[: options.moments]
    ]
    rows: list[dict[str, Any]] = []
    for fault in tqdm(cases, desc="faults", disable=None):
        samples = round((fault.start + _WATCHED) / 0.002)
        way = path(4, fault.joint or 0)
        results = run(machines, watched, way, samples, fault)
        rows += [{"seed": i} | judged(result, fault, way) for i, result in enumerate(results)]

    lines: list[list[str]] = []
    for kind in FAULTS[1:]:
        own = [row for row in rows if row["fault"] == kind]
        good = [row for row in own if row["named"]]
        lines.append(
            [
                kind,
                f"{len(good)} of {len(own)}",
                spread([row["found_after_ms"] for row in good], ".0f"),
                spread([row["off_by_mrad"] for row in good], ".1f"),
                spread([row["at_rest_after_s"] for row in good], ".2f"),
            ]
        )
        for row in own:
            if not row["named"]:
                print(f"{kind}, joint {row['joint']}: {row['what']}", file=sys.stderr)
    heads = ["fault", "named", "found after [ms]", "off by [mrad]", "at rest after [s]"]
    print(text_table(heads, lines, left=("fault",)))
    print("median / 95th percentile / worst")
    motions = 8 * options.healthy * options.seeds
    print(
        f"healthy: {alarms} of {options.healthy * options.seeds} runs alarmed ({motions} motions)"
    )
    names = ["seed", "fault", "joint", "begins_s", "named", "what"]
    names += ["found_after_ms", "off_by_mrad", "at_rest_after_s"]
    with all_or_nothing(options.output) as folder:
        write_csv(
            folder / "faults.csv", [{name: row.get(name, "") for name in names} for row in rows]
        )
    print(f"wrote {options.output / 'faults.csv'}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
