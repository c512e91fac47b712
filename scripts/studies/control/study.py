"""The effect of identified coefficients on control (2.7): controllers times coefficients.

Simulated PUMA 560s with every disturbance of Section 7.2, each another specimen (`sim.specimen`),
follow a go-to, from one pose to another that is drawn for each, and a circle of 0.1 m radius in an
inclined plane, traced by the flange. Both motions have a slow, a middle and a quick version. All
machines run side by side.

- **Controllers.** PID; PID with the abbreviated gravity compensation of joints 2 and 3 (7.4.2);
  computed torque (Eqn. 2.7-1), whole and without friction, without the velocity term, and with
  gravity alone.
- **Coefficients.** Those of the machine (truth); CSLC, identified from a training recording of the
  same machine by settings selected once; Armstrong's with regressed friction (Ar+Rg) and with that
  of Leahy and Saridis (Ar+LS); and the truth with every coefficient times 0.7 or 1.3 by a coin.
- **Gains.** Every computed torque has the natural frequency and damping of the options, whatever
  its coefficients. Friction is that of the reference velocity: quantised encoders hardly determine
  the sign of a slow velocity. "PID" has gains for the same frequency and damping by the diagonal of
  Armstrong's M at the start, and the largest integral gain that leaves a double integrator's poles
  real, 4/27 ω³ M (for ζ = 1). "PID, thesis" and PID with gravity have the gains of the thesis's
  comparison trajectory, which correspond to some 30 rad/s.
- **Figures.** Errors of the links, not of the encoders: root mean square and largest, of each joint
  and of the flange. Effort is of the torque demanded.

`--ideal` prints the errors of a perfect model without disturbances beside the response that the
gains prescribe. `--stability N` performs N random motions a controller instead of the study, many
of them faster than the drives can follow, with `JointLimitAvoidance`. Rows of finished
machines are kept in `rows.jsonl` and coefficients in `coefficients.npz`; an interrupted run goes on
from there.
"""

import argparse
import functools
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import jaxcslc as jc
import sim
from jaxcslc.report import write_csv
from scripts.studies import command
from scripts.studies.control.checks import ideal_rows, stability_rows
from scripts.studies.control.coefficients import SETS, machine_of, stored_coefficient_sets
from scripts.studies.control.loops import CONTROLLERS, START, WITHOUT_MODEL, LoopDesign, stacked
from scripts.studies.control.motions import CENTRE, MOTIONS, NORMAL, performed
from scripts.studies.control.results import (
    CASE,
    PARTIAL,
    TRACKING,
    draw,
    page_table,
    ratio_rows,
    summary_rows,
)
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store
from scripts.studies.tables import rows_table
from scripts.studies.truth import published_coefficients


jc.enable_x64()

DURATIONS = (3.0, 2.0, 1.25)  # s
STABILITY_CASES = [
    *[("computed torque", name) for name in ("truth", "CSLC", "30 % wrong")],
    *[(name, "CSLC") for name in ("PID", "PID, thesis", "PID + gravity")],
]


def finished_seeds(rows: Rows, motion: str, duration: float, controller: str) -> set[int]:
    """Seeds that have rows of every coefficient set."""
    sets = ["none"] if controller in WITHOUT_MODEL else SETS
    of_set = [
        {key[-1] for key in rows.by_key if key[:-1] == (motion, duration, controller, name)}
        for name in sets
    ]
    return set[int].intersection(*of_set)


def study(options: argparse.Namespace, design: LoopDesign) -> int:
    """Every controller with every coefficient set on every motion."""
    folder: Path = options.output
    files = ("coefficients.py", "loops.py", "motions.py")
    names = ("frequency", "damping", "corner", "samples")
    digest = made_of(
        {name: getattr(options, name) for name in names},
        [Path(__file__).with_name(name) for name in files],
    )
    rows = Rows(folder / "rows.jsonl", (*CASE, "seed"), digest)
    wanted = set(range(options.seeds))
    missing = [
        (motion, duration, controller, sorted(wanted - finished))
        for controller in options.controllers
        for motion in MOTIONS
        for duration in options.durations
        if not wanted <= (finished := finished_seeds(rows, motion, duration, controller))
    ]
    if missing:
        vectors = stored_coefficient_sets(
            design.network, options.seeds, options.samples, folder / "coefficients.npz"
        )
        for motion, duration, controller, seeds in command.progress(
            missing, desc="cases", unit="case"
        ):
            rows.add(*performed(design, vectors, motion, duration, controller, seeds))
    return report(options, [
        row for row in rows.all()
        if row["seed"] < options.seeds and row["duration"] in options.durations
        and row["controller"] in options.controllers
    ])  # fmt: skip


def report(options: argparse.Namespace, rows: list[dict[str, object]]) -> int:
    """Prints and writes tables and pictures."""
    folder: Path = options.output
    for row in rows:
        if "failed" in row:
            print(f"seed {row['seed']}, {row['coefficients']}: {row['failed']}")
    summary, ratios = summary_rows(rows), ratio_rows(rows)
    if not summary:
        print(f"all {len(rows)} motions failed; nothing to summarise")
        return 1
    print(
        f"{options.seeds} machines, natural frequency {options.frequency:g} rad/s, medians over"
        " seeds:"
    )
    columns = ["motion", "duration", "controller", "coefficients", "hand rms, median [mm]",
               "hand rms, 5 % [mm]", "hand rms, 95 % [mm]", "hand largest [mm]",
               "torque rms [N m]", "saturated"]  # fmt: skip
    print(rows_table(summary, columns, digits=3))
    if ratios:
        print("\nerror of the flange with CSLC coefficients, over that with others:")
        print(rows_table(ratios, digits=3))
        write_csv(folder / "ratios.csv", ratios)
    good = [row for row in rows if "failed" not in row]
    without_traces = [
        {name: value for name, value in row.items() if name != "trace"} for row in good
    ]
    write_csv(folder / "seeds.csv", without_traces)
    write_csv(folder / "summary.csv", summary)
    tables = {"tracking": page_table(good, TRACKING), "partial": page_table(good, PARTIAL)}
    store(options, "control", f"{options.seeds} machines", tables)
    draw(good, folder, options.controllers, SETS, CENTRE, NORMAL)
    print(f"wrote tables and pictures into {folder}")
    return 0


def check_ideal_case(options: argparse.Namespace, design: LoopDesign) -> int:
    """A perfect model without disturbances."""
    rows = ideal_rows(design.network, options.frequency, options.damping)
    print("a perfect model without disturbances, beside the response of the gains:")
    print(rows_table(rows, digits=3))
    write_csv(options.output / "ideal.csv", rows)
    return 0


def check_stability(options: argparse.Namespace, design: LoopDesign) -> int:
    """Random motions under several controllers."""
    seeds = min(options.seeds, options.stability)
    vectors = stored_coefficient_sets(
        design.network, seeds, options.samples, options.output / "coefficients.npz"
    )
    machines = [machine_of(seed) for seed in range(seeds)]
    cases = {
        f"{controller}, {name}": functools.partial(
            lambda controller, k, i: design.loop_within_range(controller, k[i], machines[i]),
            controller, vectors[name],
        )
        for controller, name in STABILITY_CASES
        if controller in options.controllers
    }  # fmt: skip
    rows = stability_rows(cases, machines, options.stability, START, stacked)
    print(rows_table(rows, digits=3))
    write_csv(options.output / "stability.csv", rows)
    return 0


def run(options: argparse.Namespace) -> int:
    """The study or one of its checks."""
    network = jc.derive(jc.puma560())
    design = LoopDesign(
        network, np.array(sim.puma560().maximum_torque), options.frequency, options.damping,
        options.corner, np.asarray(published_coefficients(network)),
    )  # fmt: skip
    design.loop("computed torque", design.published, START)  # checks the gains
    options.output.mkdir(parents=True, exist_ok=True)
    if options.ideal:
        return check_ideal_case(options, design)
    if options.stability is not None:
        return check_stability(options, design)
    return study(options, design)


def seconds(options: argparse.Namespace) -> float:
    """Return how long the study, or its check, takes on two cores."""
    if options.ideal:
        return 60.0
    if options.stability is not None:
        return 60.0 + 0.1 * options.stability * len(options.controllers)
    cases = len(options.controllers) * len(MOTIONS) * len(options.durations)
    return 20.0 + 1.5 * options.seeds + cases * (4.0 + 0.2 * options.seeds)


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "control_study")
    parser.add_argument("--seeds", type=int, default=20, help="how many machines")
    parser.add_argument("--durations", type=float, nargs="+", default=list(DURATIONS),
                        metavar="S", help="of a motion, each as a speed [s]")  # fmt: skip
    parser.add_argument("--controllers", nargs="+", default=list(CONTROLLERS), metavar="NAME",
                        help=f"some of: {', '.join(map(repr, CONTROLLERS))}")  # fmt: skip
    parser.add_argument("--frequency", type=float, default=20.0, help="natural, of errors [rad/s]")
    parser.add_argument("--damping", type=float, default=1.0, help="ratio, of errors")
    parser.add_argument("--corner", type=float, default=60.0, help="of the rates' filter [Hz]")
    parser.add_argument("--samples", type=int, default=3300, help="of training, 2 ms apart")
    parser.add_argument("--ideal", action="store_true", help="the ideal case instead of the study")
    parser.add_argument("--stability", type=int, nargs="?", const=1000, metavar="N",
                        help="N random motions a controller instead of the study")  # fmt: skip
    command.add_store(parser)
    options = command.parse(
        parser, argv, seeds=2, samples=1000, durations=[0.8],
        controllers=["PID", "computed torque"],
    )  # fmt: skip
    command.require_least(parser, options, seeds=1)
    if min(options.durations) < 0.1:
        parser.error(f"--durations: {min(options.durations):g} s is too short; expected 0.1 s")
    command.require_some_of(parser, "controller", options.controllers, tuple(CONTROLLERS))
    if options.stability is not None:
        command.require_least(parser, options, stability=1)
    return command.run(
        parser, lambda: run(options), options.output / "rows.jsonl", seconds=seconds(options)
    )


if __name__ == "__main__":
    raise SystemExit(main())
