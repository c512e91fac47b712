"""Identification without a smoothing, against regression and against its own bound.

A simulated PUMA 560 with static friction (Eqn 2.5-4) and encoders is identified from a training
recording, and judged on a comparison recording by ε on the links' true motion where a joint moves.

- **regression**: no static friction in the model, the thesis's masks, averaged splines, regressor
  and torque low-passed alike at 15 Hz.
- **maximum likelihood**: positions, coefficients, slopes, reversals and noise levels estimated
  together (`jaxcslc.MaximumLikelihood`); it starts from the defaults of `jaxcslc.Settings`.
- **floor**: what the true coefficients leave without static friction.

The second table holds, for each group of coefficients, the root mean square of errors over the
bound of independent errors (1 for an efficient estimator) and over the standard errors that are
reported by default, and the share of reported 95 % intervals that cover the truth. The third is of
static friction, joint by joint, with the median of the reported standard errors.

Rows of finished seeds are kept in `rows.jsonl`; an interrupted run goes on from there.
"""

import argparse
import dataclasses
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import jaxcslc as jc
import sim
from jaxcslc._text_table import text_table
from jaxcslc.report import write_csv
from jaxcslc.uncertainty import uncertainty_interval
from scripts.studies import command
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store
from scripts.studies.truth import epsilon, moving_patterns, true_coefficients


jc.enable_x64()

WITHIN = 1.96  # standard errors of a 95 % interval
GROUPS = ("rigid_body", "viscous", "dry", "static")


def row_of(machine: sim.Machine, samples: int, seed: int) -> dict[str, Any]:
    """Return everything of one seed: two recordings, two fits."""
    # Two numbers a seed: the encoders of the two recordings start elsewhere.
    trained, performed = (
        sim.simulate(machine, trajectory, seed=2 * seed + i)
        for i, trajectory in enumerate((sim.training(samples=samples), sim.comparison()))
    )
    patterns = moving_patterns(performed)
    without = jc.derive(machine.robot)
    network = jc.derive(machine.robot.with_friction("viscous", "dry", "static"))
    preparation = jc.Preparation(torque_alignment="mean", threshold_fraction=0.01)
    settings = jc.Settings(preparation, jc.LeastSquares(cutoff=15.0))
    regression = settings.fit(without, settings.patterns(trained.recording))
    started = time.perf_counter()
    result = jc.MaximumLikelihood().fit(network, trained.recording)
    seconds = time.perf_counter() - started
    static = np.array(machine.static) - np.array(machine.dry)
    slopes = 1.0 / np.array(machine.static_velocity)
    true = np.asarray(true_coefficients(network, machine, static=static))
    error = np.asarray(result.k) - true
    bound = error / np.sqrt(np.diag(np.asarray(result.fit.independent_covariance)))
    reported = error / np.asarray(result.fit.standard_error)
    low, high = uncertainty_interval(result.fit, None, 0.95).T
    slope = (result.slopes - slopes) / result.slope_error
    layout = network.layout

    def grouped(values: np.ndarray) -> dict[str, list[Any]]:
        return {kind: values[layout.term_slice(kind)].tolist() for kind in GROUPS}

    return {
        "regression": epsilon(without, np.asarray(regression.k), patterns),
        "likelihood": epsilon(result.network, np.asarray(result.k), patterns),
        "floor": epsilon(without, np.asarray(true_coefficients(without, machine)), patterns),
        "seconds": seconds,
        "steps": result.steps,
        "converged": result.converged,
        "bound": grouped(bound),
        "reported": grouped(reported) | {"slopes": slope.tolist()},
        "inside": grouped((low <= true) & (true <= high))
        | {"slopes": (np.abs(slope) <= WITHIN).tolist()},
        "static": (np.asarray(result.k)[layout.term_slice("static")] / static).tolist(),
        "static error": (
            np.asarray(result.fit.standard_error)[layout.term_slice("static")] / static
        ).tolist(),
        "slope": (result.slopes / slopes).tolist(),
        "slope error": (result.slope_error / slopes).tolist(),
    }


WAYS = {
    "regression": "regression, masks, averaged splines, 15 Hz filter",
    "likelihood": "maximum likelihood",
    "floor": "true coefficients without static friction",
}


def errors_table(rows: Sequence[dict[str, Any]]) -> list[list[str]]:
    """ε of each way, over seeds; the head first."""
    lines = []
    for name, label in WAYS.items():
        values = np.array([row[name] for row in rows])
        lines.append(
            [label, *(f"{x:.4f}" for x in (np.median(values), np.min(values), np.max(values)))]
        )
    return [["ε [N m]", "median", "least", "greatest"], *lines]


def deviations_table(rows: Sequence[dict[str, Any]]) -> list[list[str]]:
    """Errors over the bound and over standard errors, group by group; no bound of slopes."""
    lines = []
    for kind in rows[0]["reported"]:
        line = [kind.replace("_", " ")]
        for name in ("bound", "reported"):
            values = np.array([row[name].get(kind, [np.nan]) for row in rows])
            line.append(f"{np.sqrt(np.mean(values**2)):.2f}")
        inside = np.mean([row["inside"][kind] for row in rows])
        lines.append([*line, f"{100 * inside:.1f} %"])
    return [["coefficients", "error over bound", "error over reported", "coverage"], *lines]


def static_table(rows: Sequence[dict[str, Any]]) -> list[list[str]]:
    """Static friction over the true one, joint by joint: median and standard error."""
    lines = []
    for joint in range(len(rows[0]["static"])):
        line = [str(joint + 1)]
        for name in ("static", "slope"):
            values = np.array([row[name][joint] for row in rows])
            bound = np.median([row[f"{name} error"][joint] for row in rows])
            off = np.median(np.abs(values - 1.0))
            line += [f"{np.median(values):.3f}", f"{100 * off:.1f} %", f"{100 * bound:.1f} %"]
        lines.append(line)
    errors = ["error", "standard error"]
    return [["joint", "magnitude", *errors, "slope", *errors], *lines]


def study(options: argparse.Namespace) -> int:
    """Makes what is missing, prints the tables and writes the rows."""
    machine = sim.disturbed(sim.puma560(), "static friction", "quantisation")
    machine = dataclasses.replace(machine, time_step=options.time_step)
    digest = made_of({"samples": options.samples, "time_step": options.time_step}, [Path(__file__)])
    finished = Rows(options.output / "rows.jsonl", ("seed",), digest)
    seeds = command.seeds_of(options)
    for seed in command.progress(seeds, desc="seeds", unit="seed"):
        if (seed,) in finished:
            continue
        row = row_of(machine, options.samples, seed)
        finished.add({"seed": seed, **row})
        tqdm.write(
            f"seed {seed}: epsilon {row['likelihood']:.4f} N m, regression"
            f" {row['regression']:.4f}, {row['steps']} steps, {row['seconds']:.0f} s",
            sys.stderr,
        )
    rows = [finished[(seed,)] for seed in seeds]
    tables = {
        "torque": errors_table(rows),
        "bound": deviations_table(rows),
        "static": static_table(rows),
    }
    for head, *lines in tables.values():
        print(text_table(head, lines), end="\n\n")
    store(options, "likelihood", f"seeds {seeds[0]} to {seeds[-1]}", tables)
    nested = ("bound", "reported", "inside", "static", "static error", "slope", "slope error")
    write_csv(
        options.output / "seeds.csv",
        [{name: value for name, value in row.items() if name not in nested} for row in rows],
    )
    print(f"wrote {options.output / 'seeds.csv'}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "likelihood")
    command.add_seeds(parser, 20)
    parser.add_argument("--samples", type=int, default=3300, help="of training, 2 ms apart")
    parser.add_argument("--time-step", type=float, default=1e-4, help="of the simulator [s]")
    command.add_store(parser)
    options = command.parse(parser, argv, seeds=1, samples=1000, time_step=5e-4)
    command.require_least(parser, options, seeds=1, first=0, samples=300)
    if not options.time_step > 0.0:
        parser.error(f"--time-step is {options.time_step}; expected more than 0")
    simulation = 1e-3 / options.time_step
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=30.0 + options.seeds * (simulation + 20.0) * options.samples / 3300,
    )


if __name__ == "__main__":
    raise SystemExit(main())
