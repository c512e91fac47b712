"""Which torque belongs to a sample: how often `choose_settings` selects the right one.

PUMA A and PUMA B perform the training trajectory with encoder noise alone, with every disturbance
of Section 7.2, and, as in `make demo`, with every disturbance under a controller that compensates
these very links' gravity. Each recording is identified with its torques recorded in four ways:

- **held**: demands, each applied until the next sample (`"mean"` is right);
- **sampled**: torques measured at the samples (`"sample"`), said to be measured;
- **sampled, not said**: the same in a recording that does not say so;
- **averaged**: torques averaged about the sample (`"sample"`), said to be measured.

Printed: how often the alignment was right, and how often that of the lowest score alone would have
been; the largest error of a viscous coefficient under either; and ε on the comparison trajectory
over that of the right alignment, the largest of all recordings.

Finished rows are kept in `rows.jsonl`; an interrupted run goes on from there.
"""

import argparse
import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import jaxcslc as jc
import sim
from jaxcslc.recordings import TorqueAlignment
from jaxcslc.report import all_or_nothing, write_csv
from jaxcslc.training import half_rms
from scripts.studies import command
from scripts.studies.puma560.machines import machines
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store
from scripts.studies.tables import cells_of, grouped, rows_table
from scripts.studies.truth import true_coefficients


jc.enable_x64()

CASES = ("encoders", "all disturbances", "demo")
RIGHT: dict[str, TorqueAlignment] = {
    "held": "mean",
    "sampled": "sample",
    "sampled, not said": "sample",
    "averaged": "sample",
}
MACHINES = {"PUMA A": sim.puma_a, "PUMA B": sim.puma_b}
ALIGNMENTS: tuple[TorqueAlignment, ...] = ("mean", "sample", "previous")


def conventions(recording: jc.Recording) -> dict[str, jc.Recording]:
    """The recording of demands with its torques recorded in each of the four ways."""
    demand = recording.torque
    acting = 0.5 * (demand + np.concatenate([demand[:1], demand[:-1]]))
    around = np.concatenate([acting[:1], acting, acting[-1:]])
    averaged = 0.25 * (around[:-2] + 2.0 * acting + around[2:])
    return {
        "held": recording,
        "sampled": dataclasses.replace(recording, torque=acting, torque_measured=True),
        "sampled, not said": dataclasses.replace(recording, torque=acting),
        "averaged": dataclasses.replace(recording, torque=averaged, torque_measured=True),
    }


def job_of(name: str, case: str, seed: int) -> tuple[sim.Job, sim.Job]:
    """The training and the comparison recording of a machine."""
    encoders = sim.disturbed(MACHINES[name](), "quantisation")
    machine = encoders if case == "encoders" else machines()[name]
    robot = machine.robot if case == "demo" else None
    trajectory = sim.training() if robot is None else sim.training(robot=robot)
    return sim.Job(machine, trajectory, seed), sim.Job(machine, sim.comparison(), seed + 1)


def row_of(
    network: jc.CSLC,
    recording: jc.Recording,
    right: TorqueAlignment,
    truth: Float[np.ndarray, " coefficients"],
    judged: jc.Patterns,
) -> dict[str, Any]:
    """Return what was selected, what the lowest score alone would select, and what either costs."""
    selection = jc.choose_settings(network, recording)
    settings = selection.settings
    scores = {trial.settings: trial.score for trial in selection.trials}
    by_alignment = {name: settings.with_options(torque_alignment=name) for name in ALIGNMENTS}
    lowest = min(ALIGNMENTS, key=lambda name: scores[by_alignment[name]])
    selected = settings.preparation.torque_alignment
    row: dict[str, Any] = {"selected": selected, "lowest": lowest, "right": right}
    viscous = [name.startswith("kv") for name in network.names]
    for name in sorted({selected, lowest, right}):
        some = by_alignment[name]
        k = np.asarray(some.fit(network, some.patterns(recording)).k)
        errors = judged.torque - network.torque(k, judged.q, judged.qd, judged.qdd)
        epsilon = half_rms(jnp.asarray(errors).T, jnp.asarray(judged.mask, float).T)
        row[name] = {
            "viscous": float(np.max(np.abs(k / truth - 1.0)[viscous])),
            "epsilon": float(epsilon),
        }
    return row


def summary(rows: Sequence[Mapping[str, Any]], case: str, convention: str) -> dict[str, Any]:
    """The line of a case and a convention."""
    some = [row for row in rows if (row["case"], row["convention"]) == (case, convention)]
    line: dict[str, Any] = {"case": case, "torque": convention, "recordings": len(some)}
    for label, choice in (("", "selected"), (", by score alone", "lowest")):
        line[f"right{label}"] = sum(row[choice] == row["right"] for row in some)
        line[f"viscous error{label} [%]"] = 100 * max(row[row[choice]]["viscous"] for row in some)
        line[f"ε over right one's{label}"] = max(
            row[row[choice]]["epsilon"] / row[row["right"]]["epsilon"] for row in some
        )
    return line


def study(options: argparse.Namespace) -> int:
    """Makes what is missing, prints the table and writes it."""
    network = jc.derive(jc.puma560())
    digest = made_of({}, [Path(__file__)])
    keys = ("machine", "case", "seed", "convention")
    finished = Rows(options.output / "rows.jsonl", keys, digest)
    recordings = [
        (machine, case, seed)
        for seed in range(options.recordings)
        for case in options.cases
        for machine in MACHINES
    ]
    for machine, case, seed in command.progress(recordings, desc="recordings", unit="recording"):
        missing = [name for name in RIGHT if (machine, case, seed, name) not in finished]
        if not missing:
            continue
        jobs = job_of(machine, case, seed)
        training, comparison = (result.recording for result in sim.record(jobs))
        truth = np.asarray(true_coefficients(network, jobs[0].machine))
        judged = jc.prepare(
            comparison,
            smoothing=jc.AveragedSplines(17),
            torque_alignment="mean",
            thresholds=0.01,
        )
        ways = conventions(training)
        for name in missing:
            row = row_of(network, ways[name], RIGHT[name], truth, judged)
            finished.add(dict(zip(keys, (machine, case, seed, name), strict=True)) | row)
    rows = [finished[*key, name] for key in recordings for name in RIGHT]
    table = [summary(rows, case, name) for case in options.cases for name in RIGHT]
    print(rows_table(table, digits=3))
    sample = f"{2 * options.recordings} recordings of each row"
    store(options, "alignment", sample, {"machines": grouped(cells_of(table, digits=3))})
    with all_or_nothing(options.output) as folder:
        write_csv(folder / "alignment.csv", table)
    print(f"\nwrote alignment.csv into {options.output}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "alignment_study")
    parser.add_argument("--recordings", type=int, default=8, help="of each machine and case")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES), metavar="CASE",
                        help=f"some of: {', '.join(CASES)}")  # fmt: skip
    command.add_store(parser)
    options = command.parse(parser, argv, recordings=1, cases=["encoders"])
    command.require_least(parser, options, recordings=1)
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=10.0 + 16.0 * options.recordings * len(options.cases),
    )


if __name__ == "__main__":
    raise SystemExit(main())
