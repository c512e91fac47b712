"""How often intervals contain the truth where smoothing and missing terms bias the coefficients.

PUMA A and PUMA B perform the training trajectory, with quantised encoders alone and with every
disturbance of Section 7.2, each several times with other encoder phases and starts. Each recording
is identified with settings that cross-validation prefers for prediction (splines of 17 samples,
parallel filter at 8 Hz). Printed: how many of the coefficients' intervals contained the true value,
with standard errors alone and with systematic errors (`jaxcslc.uncertainty.systematic_error`),
what each cause alone would give, how much wider intervals become, and the verdicts on coefficients
whose error is the most standard errors. Percentages are of the true value.

Finished rows are kept in `rows.jsonl`; an interrupted run goes on from there.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import jaxcslc as jc
import sim
from jaxcslc.report import WELL_DETERMINED, all_or_nothing, coefficient_rows, write_csv
from jaxcslc.uncertainty import systematic_error, uncertainty_interval
from scripts.studies import command
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store
from scripts.studies.tables import cells_of, grouped, rows_table
from scripts.studies.truth import (
    ALL_CAUSES,
    STANDARD_ERROR,
    true_coefficients,
    truth_within_intervals,
)


jc.enable_x64()


SETTINGS = jc.Settings(
    jc.Preparation(jc.AveragedSplines(17), torque_alignment="mean", threshold_fraction=0.03),
    jc.LeastSquares(cutoff=8.0),
)
MACHINES = {"PUMA A": sim.puma_a, "PUMA B": sim.puma_b}
CONFIDENT = 0.05  # of the true value
CASES = {"encoders": ("quantisation",), "all disturbances": ()}


def machine_of(name: str, case: str) -> sim.Machine:
    """PUMA A or B with the disturbances of a case."""
    return sim.disturbed(MACHINES[name](), *CASES[case])


def identified(
    network: jc.CSLC, recording: jc.Recording, truth: np.ndarray, level: float
) -> dict[str, Any]:
    """Intervals of one recording's fit beside the truth."""
    fit = SETTINGS.fit(network, SETTINGS.patterns(recording))
    error = systematic_error(network, recording, SETTINGS, fit)
    covered = truth_within_intervals(fit, error, truth, level)
    rows = coefficient_rows(network, fit, systematic=error, level=level)
    plain = coefficient_rows(network, fit, level=level)
    k, deviation = np.asarray(fit.k), np.asarray(fit.standard_error)
    narrow, wide = (np.ptp(uncertainty_interval(fit, e, level), axis=1) for e in (None, error))
    return {
        "covered": {name: within.tolist() for name, within in covered.items()},
        "off": ((k - truth) / deviation).tolist(),
        "relative error": np.abs(k / truth - 1.0).tolist(),
        "systematic": (error.total / np.abs(truth)).tolist(),
        "wider": (wide / narrow).tolist(),
        "half width": (0.5 * wide / np.abs(truth)).tolist(),
        "half width, standard error": (0.5 * narrow / np.abs(truth)).tolist(),
        "verdict": [row["verdict"] for row in rows],
        "verdict, standard error": [row["verdict"] for row in plain],
    }


def summary(rows: Sequence[dict[str, Any]], machine: str, case: str) -> dict[str, Any]:
    """The line of a machine and a case: means over recordings, medians over coefficients."""
    some = [row for row in rows if (row["machine"], row["case"]) == (machine, case)]
    count = {
        name: np.mean([np.sum(row["covered"][name]) for row in some]) for name in some[0]["covered"]
    }
    before, after = "half width, standard error", "half width"
    return {
        "machine": machine,
        "case": case,
        **{f"{name}": float(value) for name, value in count.items()},
        "times as wide": float(np.median([row["wider"] for row in some])),
        f"{before} [%]": 100 * float(np.median([row[before] for row in some])),
        f"{after} [%]": 100 * float(np.median([row[after] for row in some])),
    }


def page_table(table: Sequence[dict[str, Any]]) -> list[list[str]]:
    """The page's table, the head first: `summary` without widths of single errors."""
    causes = list(table[0])[2:-3]
    lines = [
        [
            f"{row['machine']}, {row['case']}",
            *(f"{row[cause]:.3g}" for cause in causes),
            ", ".join(f"{row[width]:.2g}" for width in list(row)[-2:]) + " %",
        ]
        for row in table
    ]
    heads = (
        {STANDARD_ERROR: f"{STANDARD_ERROR} alone", ALL_CAUSES: "all"}.get(x, x) for x in causes
    )
    return [["", *heads, "half width before, after"], *lines]


def confident_errors(rows: Sequence[dict[str, Any]], verdicts: str) -> int:
    """Return how many coefficients are called well determined and wrong by more than `CONFIDENT`.

    - `verdicts`: the field of the rows that holds them.
    """
    return sum(
        verdict in WELL_DETERMINED and error > CONFIDENT
        for row in rows
        for verdict, error in zip(row[verdicts], row["relative error"], strict=True)
    )


def worst_rows(
    names: Sequence[str], rows: Sequence[dict[str, Any]], case: str, count: int = 6
) -> list[dict[str, Any]]:
    """The coefficients that are off by the most standard errors, and the verdicts on them."""
    lines: list[dict[str, Any]] = []
    for machine in MACHINES:
        some = [row for row in rows if (row["machine"], row["case"]) == (machine, case)]
        off = np.mean([row["off"] for row in some], axis=0)
        for index in np.argsort(-np.abs(off))[:count]:
            lines.append(
                {
                    "machine": machine,
                    "coefficient": names[index],
                    "error [standard errors]": float(off[index]),
                    "error [%]": 100 * _mean(some, "relative error", index),
                    "systematic error [%]": 100 * _mean(some, "systematic", index),
                    "verdict, standard error": some[0]["verdict, standard error"][index],
                    "verdict": some[0]["verdict"][index],
                }
            )
    return lines


def _mean(rows: Sequence[dict[str, Any]], name: str, index: int) -> float:
    return float(np.mean([row[name][index] for row in rows]))


def study(options: argparse.Namespace) -> int:
    """Identifies all recordings, prints the tables and writes the files."""
    network = jc.derive(jc.puma560())
    names = network.names
    digest = made_of({"level": options.level}, [Path(__file__)])
    finished = Rows(options.output / "rows.jsonl", ("machine", "case", "seed"), digest)
    seeds = range(options.recordings)
    wanted = [(m, c, s) for m in MACHINES for c in CASES for s in seeds]
    missing = [key for key in wanted if key not in finished]
    for machine, case, seed in command.progress(missing, desc="recordings", unit="recording"):
        simulated = machine_of(machine, case)
        # See `sim.training` for why each compensates its own gravity.
        trajectory = sim.training(robot=simulated.robot)
        (recording, _) = sim.record([sim.Job(simulated, trajectory, seed)])[0]
        truth = np.asarray(true_coefficients(network, simulated))
        row = identified(network, recording, truth, options.level)
        finished.add({"machine": machine, "case": case, "seed": seed, **row})
    rows = [finished[key] for key in wanted]
    table = [summary(rows, machine, case) for machine in MACHINES for case in CASES]
    worst = worst_rows(names, rows, "all disturbances")
    print(
        f"\nof {len(names)} intervals of {100 * options.level:g} %, how many contained the truth"
        f" (mean of {options.recordings} recordings), by what they allow for; median widths\n"
    )
    print(rows_table(table, digits=3))
    print("\nall disturbances: the coefficients that are off by the most standard errors\n")
    print(rows_table(worst, digits=3))
    sample = f"{options.recordings} recordings of each row"
    store(
        options,
        "systematic",
        sample,
        {"causes": page_table(table), "coefficients": grouped(cells_of(worst, digits=3))},
    )
    before, after = (
        confident_errors(rows, name) for name in ("verdict, standard error", "verdict")
    )
    print(
        f"\nof {len(rows) * len(names)} coefficients, well determined and wrong by more than"
        f" {100 * CONFIDENT:g} %: {before} by standard errors alone, {after} with systematic errors"
    )
    with all_or_nothing(options.output) as folder:
        write_csv(folder / "systematic.csv", table)
        write_csv(folder / "worst.csv", worst)
    print(f"\nwrote systematic.csv and worst.csv into {options.output}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "systematic_study")
    parser.add_argument("--recordings", type=int, default=8, help="how many of each kind")
    parser.add_argument("--level", type=float, default=0.95, help="of the intervals")
    command.add_store(parser)
    options = command.parse(parser, argv, recordings=1)
    command.require_least(parser, options, recordings=1)
    command.require_between(parser, options, level=(0.0, 1.0))
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=20 + 20 * options.recordings,
    )


if __name__ == "__main__":
    raise SystemExit(main())
