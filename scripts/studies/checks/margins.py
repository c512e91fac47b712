"""Study of how far right recordings stay from the bounds of `jaxcslc check`.

No theory sets some of these bounds: what a model lacks is no normal noise. For each, the largest
value of what it cuts is shown, of clean recordings of the spoiler study's arms and conditions.
"""

import argparse
from collections.abc import Callable, Sequence

import numpy as np

import jaxcslc as jc
from jaxcslc.checks import _model_findings as model, _motion_findings as motion
from jaxcslc.checks._evidence import LARGEST_ERROR, LEAST_GAIN, SMALLEST_ERROR, Evidence
from jaxcslc.checks._first_order import FirstOrder
from scripts.studies import command
from scripts.studies.checks.robots import ARMS, arm, record
from scripts.studies.checks.spoiler import clean_conditions
from scripts.studies.rows import Rows, made_of
from scripts.studies.tables import rows_table


jc.enable_x64()

Statistic = Callable[[Evidence, FirstOrder], float]


def _beyond_noise(evidence: Evidence, first: FirstOrder) -> float:
    excess = evidence.relative_errors**2 - evidence.noise**2
    return float(np.sqrt(np.maximum(np.max(excess), 0.0)))


def _over_training(evidence: Evidence, first: FirstOrder) -> float:
    training = np.clip(evidence.training_errors, SMALLEST_ERROR, LARGEST_ERROR)
    return evidence.score(evidence.patterns) - float(np.mean(np.log(training)))


def _gain(evidence: Evidence, first: FirstOrder) -> float:
    return max(model.first_order_gains(first, model.possible_causes(first)))


def _significance(evidence: Evidence, first: FirstOrder) -> float:
    return max((fault.significance for fault in model.sized_faults(evidence)), default=0.0)


def _touched(evidence: Evidence, first: FirstOrder) -> float:
    return float(np.max(model.block_ratios(evidence, first)))


def _spread(evidence: Evidence, first: FirstOrder) -> float:
    factors = model.file_factors(evidence)
    if factors is None or factors.joints.size < 2:
        return 0.0
    return float(np.std(np.log(factors.factor)))


STATISTICS: dict[str, tuple[Statistic, float]] = {
    "error beyond noise, part of the torque": (_beyond_noise, motion.UNEXPLAINED),
    "held-out over training error, logarithm": (_over_training, motion.TAME),
    "gain of a cause, of first order": (_gain, LEAST_GAIN),
    "size of a fault, standard errors": (_significance, model.CLEAR),
    "error of a stretch, times the usual": (_touched, model.TOUCHED),
    "spread of the file's factors, logarithm": (_spread, model.SPREAD),
}
"""A statistic of right recordings, and its bound."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the study. **Returns** the exit status."""
    parser = command.new_parser(__doc__, "margins")
    command.add_seeds(parser, 20)
    parser.set_defaults(first=2000)
    options = command.parse(parser, arguments, seeds=2)
    command.require_least(parser, options, seeds=1)
    rows = Rows(options.output / "rows.jsonl", ("arm", "seed"), made_of({}))
    jobs = [(name, seed) for name in ARMS for seed in command.seeds_of(options)]
    missing = [job for job in jobs if job not in rows]
    return command.run(
        parser, lambda: _study(rows, jobs, missing, options), rows.path, seconds=2.0 * len(missing)
    )


def _study(
    rows: Rows,
    jobs: Sequence[tuple[str, int]],
    missing: Sequence[tuple[str, int]],
    options: argparse.Namespace,
) -> int:
    options.output.mkdir(parents=True, exist_ok=True)
    for name, seed in command.progress(missing, desc="recordings"):
        evidence = Evidence.of(
            arm(name).network, record(name, clean_conditions(seed), seed).recording
        )
        first = FirstOrder.of(evidence)
        values = {key: statistic(evidence, first) for key, (statistic, _) in STATISTICS.items()}
        rows.add({"arm": name, "seed": seed, "values": values})
    print(rows_table(list(_table([rows[job]["values"] for job in jobs])), digits=2))
    return 0


def _table(values: Sequence[dict[str, float]]) -> Sequence[dict[str, str | float]]:
    table: list[dict[str, str | float]] = []
    for key, (_, bound) in STATISTICS.items():
        of_key = np.array([row[key] for row in values])
        table.append(
            {
                f"of {len(values)} clean recordings": key,
                "median": float(np.median(of_key)),
                "90 %": float(np.quantile(of_key, 0.9)),
                "largest": float(np.max(of_key)),
                "bound": bound,
                "beyond": f"{np.sum(of_key > bound)}",
            }
        )
    return table


if __name__ == "__main__":
    raise SystemExit(main())
