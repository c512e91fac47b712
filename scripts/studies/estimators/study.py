"""Estimators beside each other on the same recordings: error, bias, coverage, seconds.

A simulated PUMA 560 follows one exciting motion under PID control, and is recorded with encoders,
with all disturbances of the thesis, and with Gaussian noise, each with other noise for each seed.
Settings are chosen once a recording, by cross-validation, and are the same for all estimators; but
where a method is said to have hardly smoothed: splines of three samples, without a filter.

- **torque error**: ε on the comparison trajectory, where a joint moves; median over seeds.
- **bias**: mean over seeds of a coefficient's error, over its standard deviation over seeds; root
  mean square over coefficients. About one over the root of the seeds without bias.
- **intervals**: the share of 95 % intervals that cover the truth.
- **seconds**: of the processor, median; compiling included in the first seed of a process.
- **biased**: how often the Durbin-Wu-Hausman test says at 5 % that least squares is.

Finished rows are kept in `rows.jsonl`; an interrupted run goes on from there.
"""

import argparse
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import jaxcslc as jc
import sim
from jaxcslc._text_table import text_table
from jaxcslc.report import write_csv
from scripts.studies import command
from scripts.studies.estimators.methods import NAMES, ROUGH, estimates
from scripts.studies.estimators.recordings import KINDS, experiment
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store
from scripts.studies.truth import epsilon, moving_patterns, true_coefficients


jc.enable_x64()

REJECTED = 0.05


def rows_of(
    kind: str, samples: int, time_step: float, seed: int, methods: Collection[str]
) -> Iterator[dict[str, Any]]:
    """A row a method, of one recording."""
    made = experiment(kind, samples, time_step, 2 * seed)
    network = jc.derive(made.machine.robot)
    true = np.asarray(true_coefficients(network, made.machine))
    judged = moving_patterns(sim.simulate(made.machine, sim.comparison(), seed=2 * seed + 1))
    for estimate in estimates(network, made, methods):
        low, high = estimate.interval.T
        yield {
            "kind": kind,
            "seed": seed,
            "method": estimate.method,
            "epsilon": epsilon(network, estimate.k, judged),
            "error": (estimate.k - true).tolist(),
            "inside": float(np.mean((low <= true) & (true <= high))),
            "seconds": estimate.seconds,
            "p_value": estimate.p_value,
        }


def tables_of(kind: str, rows: Sequence[Mapping[str, Any]]) -> dict[str, list[list[str]]]:
    """Return the tables of one kind of recording, a line per method, the head first."""
    head = [kind, "ε [N m]", "bias", "95 % intervals that hold", "processor [s]", "biased"]
    tables: dict[str, list[list[str]]] = {}
    for name in (name for name in NAMES if any(row["method"] == name for row in rows)):
        method, rough, _ = name.partition(ROUGH)
        line = [method, *list(summary(rows, name).values())[1:]]
        tables.setdefault(kind + rough, [head]).append(line)
    return tables


def summary(rows: Sequence[Mapping[str, Any]], method: str) -> dict[str, str]:
    """Return what a table has of a method, over its seeds."""
    of_method = [row for row in rows if row["method"] == method]
    error = np.array([row["error"] for row in of_method])
    spread = np.std(error, axis=0, ddof=1) if len(error) > 1 else np.full(error.shape[1], np.nan)
    bias = np.sqrt(np.mean((np.mean(error, axis=0) / np.where(spread > 0, spread, np.nan)) ** 2))
    rejected = [row["p_value"] < REJECTED for row in of_method if row["p_value"] is not None]
    return {
        "method": method,
        "epsilon": f"{np.median([row['epsilon'] for row in of_method]):.4f}",
        "bias": f"{bias:.2f}" if np.isfinite(bias) else "",
        "inside": f"{100 * np.mean([row['inside'] for row in of_method]):.0f} %",
        "seconds": f"{np.median([row['seconds'] for row in of_method]):.1f}",
        "biased": f"{100 * np.mean(rejected):.0f} %" if rejected else "",
    }


def study(options: argparse.Namespace) -> int:
    """Makes what is missing, prints the tables and writes the rows."""
    folder = Path(__file__).parent
    digest = made_of(
        {"samples": options.samples, "time_step": options.time_step},
        [folder / name for name in ("study.py", "methods.py", "recordings.py")],
    )
    finished = Rows(options.output / "rows.jsonl", ("kind", "seed", "method"), digest)
    seeds = command.seeds_of(options)
    todo = [(seed, kind) for seed in seeds for kind in options.kinds]
    for seed, kind in command.progress(todo, desc="recordings", unit="recording"):
        missing = [name for name in options.methods if (kind, seed, name) not in finished]
        if not missing:
            continue
        for row in rows_of(kind, options.samples, options.time_step, seed, missing):
            finished.add(row)
            line = f"{kind}, seed {seed}, {row['method']}: {row['epsilon']:.4f} N m"
            tqdm.write(line, sys.stderr)
    rows = [row for row in finished.all() if row["seed"] in seeds]
    tables: dict[str, list[list[str]]] = {}
    for kind in options.kinds:
        tables |= tables_of(kind, [row for row in rows if row["kind"] == kind])
    for head, *lines in tables.values():
        print(text_table(head, lines), end="\n\n")
    store(options, "estimators", f"seeds {seeds[0]} to {seeds[-1]}", tables)
    write_csv(
        options.output / "estimators.csv",
        [{name: value for name, value in row.items() if name != "error"} for row in rows],
    )
    print(f"wrote {options.output / 'estimators.csv'}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "estimators")
    command.add_seeds(parser, 16)
    parser.add_argument("--samples", type=int, default=3300, help="of excitation, 2 ms apart")
    parser.add_argument("--time-step", type=float, default=2e-4, help="of the simulator [s]")
    parser.add_argument(
        "--kinds", nargs="+", default=list(KINDS), metavar="KIND", help=", ".join(KINDS)
    )
    parser.add_argument(
        "--methods", nargs="+", default=list(NAMES), metavar="METHOD", help="; ".join(NAMES)
    )
    command.add_store(parser)
    options = command.parse(
        parser, argv, seeds=1, samples=1000, time_step=5e-4, kinds=["Gaussian noise"]
    )
    command.require_least(parser, options, seeds=1, first=0, samples=500)
    command.require_some_of(parser, "recording", options.kinds, tuple(KINDS))
    command.require_some_of(parser, "method", options.methods, NAMES)
    if not options.time_step > 0.0:
        parser.error(f"--time-step is {options.time_step}; expected more than 0")
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=20.0 + options.seeds * len(options.kinds) * 40.0 * options.samples / 3300,
    )


if __name__ == "__main__":
    raise SystemExit(main())
