"""Maximum likelihood of arms with compliant gears, against regression.

PUMA A and PUMA B with every disturbance of Section 7.2 are identified from a training recording,
and judged on a comparison recording as in `make demo`: ε between the demand and the torque that the
coefficients predict for smoothed readings of encoders, which sit on the rotors, where a joint
moves.

- **regression**: settings chosen within the training recording, as `jaxcslc identify` does.
- **maximum likelihood**: with static friction in the model, `jaxcslc.MaximumLikelihood`, equations
  of motion over so many samples (`every`); or as many as it selects (`--selected`).
- **all terms**, of both: complete tensors of inertia, for axes that are tilted, and friction that
  differs between directions: viscous friction of each direction, and an offset. Offsets are
  known beforehand to be no larger than a tenth of the regression's dry friction (a standard
  deviation): motion in a small range, as joint 2's, does not tell an offset from gravity.
- **friction selected** (`--selected`), of both: what `jaxcslc identify --friction auto` selects of
  the training recording for this estimator, beginning with viscous and dry friction.
- **true**: the machine's coefficients, in the model of the regression.

Beside ε, how many 95 % intervals cover the true coefficient, of 43 and of 52, with systematic
errors. Of viscous friction by direction the mean counts.

Rows of finished seeds are kept in `rows.jsonl`; an interrupted run goes on from there.
"""

import argparse
import functools
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Array, Float
from tqdm import tqdm

import jaxcslc as jc
import sim
from jaxcslc._text_table import text_table
from jaxcslc.bodies import Known, Prior
from jaxcslc.report import write_csv
from jaxcslc.uncertainty import SystematicError, systematic_error, uncertainty_interval
from scripts.studies import command
from scripts.studies.puma560.machines import MOVING, machines
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store
from scripts.studies.tables import stacked
from scripts.studies.truth import true_coefficients


jc.enable_x64()

# Samples that equations are over.
_EVERY = 3
# Standard deviation of an offset beforehand, as a part of the joint's dry friction.
_OFFSET = 0.1
LAST = f"likelihood, every {_EVERY}, all terms"


def rows_of(
    machine: sim.Machine, samples: int, seed: int, selected: bool
) -> Iterator[dict[str, Any]]:
    """Return everything of one machine and seed: one row an estimator.

    - `selected`: whether what is selected on the recording has rows.
    """
    # Two numbers a seed: the encoders of the two recordings start elsewhere.
    trained, performed = (
        sim.simulate(machine, trajectory, seed=2 * seed + i).recording
        for i, trajectory in enumerate(
            (sim.training(samples=samples, robot=machine.robot), sim.comparison())
        )
    )
    judged = jc.prepare(
        performed, smoothing=jc.AveragedSplines(17), torque_alignment="mean", thresholds=MOVING
    )
    plain = jc.derive(jc.puma560())
    network = jc.derive(jc.puma560().with_friction("viscous", "dry", "static"))
    truth = np.asarray(true_coefficients(plain, machine))

    def row(
        estimator: str,
        of: jc.CSLC,
        k: Float[Array | np.ndarray, " coefficients"],
        interval: Float[Array | np.ndarray, "coefficients 2"],
        started: float,
        converged: bool = True,
        expected: Float[np.ndarray, " coefficients"] = truth,
    ) -> dict[str, Any]:
        low, high = np.asarray(interval).T
        inside = (low <= expected) & (expected <= high)
        return {
            "estimator": estimator,
            "epsilon": float(np.asarray(jc.compare(of, judged, {"fit": k}).epsilon)[0]),
            "inside": 100 * float(np.mean(inside)),
            "seconds": time.perf_counter() - started,
            "converged": converged,
        }

    started = time.perf_counter()
    yield row("true", plain, truth, np.stack([truth, truth], axis=1), started)
    settings = jc.choose_settings(plain, trained).settings
    fit = settings.fit(plain, settings.patterns(trained))
    interval = uncertainty_interval(fit, systematic_error(plain, trained, settings, fit))
    yield row("regression", plain, fit.k, interval, started)
    estimators = {f"likelihood, every {_EVERY}": jc.MaximumLikelihood(every=_EVERY)}
    if selected:
        estimators["likelihood, every selected"] = jc.MaximumLikelihood()
    for name, estimator in estimators.items():
        started = time.perf_counter()
        result = estimator.fit(network, trained)
        low_high = means_of_directions(plain, result.fit, result.systematic)
        yield row(name, result.network, result.k, low_high, started, result.converged)
    if selected:
        yield from _friction_selected(row, plain, trained)
    started = time.perf_counter()
    tilted = jc.puma560().with_inertia("full")
    reference = jc.derive(tilted, lengths="numeric")
    complete = jc.derive(
        tilted.with_friction("asymmetric_viscous", "dry", "static", "offset"), lengths="numeric"
    )
    dry = np.abs(np.asarray(fit.k)[plain.layout.indices("dry")])
    prior = Prior(
        {f"ko{i}": Known(0.0, _OFFSET * float(value)) for i, value in enumerate(dry, start=1)}
    )
    expected = np.asarray(true_coefficients(reference, machine))
    report = jc.identify(complete, trained, possible="never", checks=False, prior=prior)
    low_high = means_of_directions(reference, report.fit, report.systematic)
    name = "regression, all terms"
    yield row(name, report.network, report.k, low_high, started, expected=expected)
    started = time.perf_counter()
    result = jc.MaximumLikelihood(every=_EVERY, prior=prior).fit(complete, trained)
    low_high = means_of_directions(reference, result.fit, result.systematic)
    yield row(LAST, result.network, result.k, low_high, started, result.converged, expected)


def _friction_selected(
    row: Callable[..., dict[str, Any]], plain: jc.CSLC, trained: jc.Recording
) -> Iterator[dict[str, Any]]:
    """Return both estimators with the friction that the training recording selects.

    - `row`: makes one, from estimator, network, coefficients, intervals and when it was started.
    """
    started = time.perf_counter()
    identify = functools.partial(jc.identify, possible="never", checks=False)
    report = identify(plain, trained, friction="auto", estimator="maximum-likelihood")
    assert report.friction is not None and report.estimators is not None
    low_high = means_of_directions(plain, report.fit, report.systematic)
    converged = report.estimators.likelihood.converged
    selected = row(
        "likelihood, friction and every selected",
        report.network,
        report.k,
        low_high,
        started,
        converged,
    )
    started = time.perf_counter()
    report = identify(plain, trained, friction="auto")
    low_high = means_of_directions(plain, report.fit, report.systematic)
    yield row("regression, friction selected", report.network, report.k, low_high, started)
    yield selected


def means_of_directions(
    plain: jc.CSLC, fit: jc.Identification, systematic: SystematicError | None
) -> Float[np.ndarray, "coefficients 2"]:
    """Intervals of the coefficients of a network whose friction is the same both ways.

    A coefficient that has one value for each direction counts by the mean of the two.
    """
    names = fit.names
    mean = np.zeros((plain.size, len(names)))
    for i, name in enumerate(plain.names):
        for part in (name,) if name in names else (f"kvp{name[2:]}", f"kvn{name[2:]}"):
            mean[i, names.index(part)] = 1.0 if part == name else 0.5
    low, high = np.asarray(fit.confidence_interval()).T
    error = np.asarray(fit.standard_error)
    quantile = np.median(((high - low) / 2)[error > 0] / error[error > 0])
    value = mean @ np.asarray(fit.k)
    variance = np.diag(mean @ np.asarray(fit.covariance) @ mean.T)
    if systematic is not None:
        variance = variance + (mean @ systematic.total) ** 2
    reach = quantile * np.sqrt(variance)
    return np.stack([value - reach, value + reach], axis=1)


def table(rows: Sequence[dict[str, Any]], machine: str) -> list[list[str]]:
    """Return the table of one machine: ε over seeds, beside regression's of the same seeds, and
    intervals.
    """
    lines: list[list[str]] = []
    of_machine = [row for row in rows if row["machine"] == machine]
    regression = {
        row["seed"]: row["epsilon"] for row in of_machine if row["estimator"] == "regression"
    }
    for name in dict.fromkeys(row["estimator"] for row in of_machine):
        part = [row for row in of_machine if row["estimator"] == name]
        epsilon = np.array([row["epsilon"] for row in part])
        ratio = epsilon / np.array([regression[row["seed"]] for row in part])
        values = (np.median(epsilon), epsilon.min(), epsilon.max(), np.median(ratio), ratio.max())
        lines.append(
            [
                name,
                *(f"{value:.4f}" for value in values[:3]),
                *(f"{value:.3f}" for value in values[3:]),
                f"{np.mean([row['inside'] for row in part]):.1f}",
                f"{sum(row['converged'] for row in part)} of {len(part)}",
                f"{np.median([row['seconds'] for row in part]):.1f}",
            ]
        )
    header = [
        machine,
        "ε, median",
        "least",
        "greatest",
        "over regression",
        "greatest",
        "coverage of 95 % intervals, %",
        "converged",
        "s",
    ]
    return [header, *lines]


def study(options: argparse.Namespace) -> int:
    """Makes what is missing, prints the tables and writes the rows."""
    digest = made_of({"samples": options.samples, "selected": options.selected}, [Path(__file__)])
    finished = Rows(options.output / "rows.jsonl", ("machine", "seed", "estimator"), digest)
    both = machines()
    seeds = command.seeds_of(options)
    for seed in command.progress(seeds, desc="seeds", unit="seed"):
        for name, machine in both.items():
            if (name, seed, LAST) in finished:
                continue
            for row in rows_of(machine, options.samples, seed, options.selected):
                finished.add({"machine": name, "seed": seed, **row})
                tqdm.write(
                    f"{name}, seed {seed}, {row['estimator']}: epsilon {row['epsilon']:.4f} N m",
                    sys.stderr,
                )
    rows = [row for row in finished.all() if row["seed"] in seeds]
    tables = {name: table(rows, name) for name in both}
    for head, *lines in tables.values():
        print(text_table(head, lines), end="\n\n")
    store(
        options,
        "transmission",
        f"seeds {seeds[0]} to {seeds[-1]}",
        {"machines": stacked("machine", tables)},
    )
    write_csv(options.output / "seeds.csv", rows)
    print(f"wrote {options.output / 'seeds.csv'}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "transmission")
    command.add_seeds(parser, 10)
    parser.add_argument("--samples", type=int, default=3300, help="of training, 2 ms apart")
    parser.add_argument(
        "--selected",
        action="store_true",
        help="also spacing and friction that are selected: three times as long",
    )
    command.add_store(parser)
    options = command.parse(parser, argv, seeds=1, samples=1000)
    command.require_least(parser, options, seeds=1, first=0, samples=600)
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=30.0
        + options.seeds * (300.0 if options.selected else 90.0) * options.samples / 3300,
    )


if __name__ == "__main__":
    raise SystemExit(main())
