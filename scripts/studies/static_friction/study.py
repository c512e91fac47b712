"""Does a recording determine static friction, and does it help to model it? (8.2.1, 7.2.2)

A simulated PUMA 560 with static friction (Eqn 2.5-4), exact positions or encoders, is identified
from a training recording by each of several methods, and judged on a comparison recording by ε on
the links' true motion where a joint moves. The floor is what the true coefficients leave of it
without static friction.

- **masked**: no static friction in the model; pairs slower than a hundredth of a joint's greatest
  speed left out, regressor and torque low-passed alike at 15 Hz.
- **all pairs**: static friction and its slopes in the model (`jaxcslc.fit_slopes`), every pair
  counts.
- **moving pairs**: the same, pairs of a joint at rest left out: friction bears any torque up to its
  break-away value.
- **away from reversals**: the same, and two samples on either side of each reversal left out.
- **windows**: simulated motion fitted to recorded positions over windows of at most 0.2 s, across
  reversals (`windows.py`), starting from the masked fit. No accelerations
  are estimated.

Intervals are of 95 %: of windows for independent residuals, as encoders' steps are; of the others
from the scatter of stretches of time.

**The simulator's step.** The simulator stops a joint that comes to rest within a step until the
step ends. With steps of 0.5 ms, its default, that takes some 5 mrad/s from the wrist's velocity at
each reversal. Regression is not affected; integration of the equations is. `--time-step` is shorter
here.

Rows of finished seeds are kept in `rows.jsonl`; an interrupted run goes on from there.
"""

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import jaxcslc as jc
import sim
from jaxcslc._text_table import text_table
from jaxcslc.report import write_csv
from scripts.studies import command
from scripts.studies.figures import save_picture
from scripts.studies.rows import Rows, made_of
from scripts.studies.static_friction.methods import METHODS, Identifier, Model
from scripts.studies.static_friction.pictures import static_friction_picture
from scripts.studies.truth import moving_patterns, true_coefficients


jc.enable_x64()

WITHIN = 1.96  # standard errors of a 95 % interval


def machine_of(encoders: bool, time_step: float) -> sim.Machine:
    """The PUMA 560 with static friction, and with quantised encoders if wanted."""
    names = ("static friction", *(["quantisation"] if encoders else []))
    return dataclasses.replace(sim.disturbed(sim.puma560(), *names), time_step=time_step)


def row_of(
    identifier: Identifier, machine: sim.Machine, model: Model, patterns: jc.Patterns
) -> dict[str, Any]:
    """Figures of one model: ε, and its static friction over the true one."""
    true = np.asarray(true_coefficients(identifier.without_static, machine))
    row: dict[str, Any] = {
        "epsilon": epsilon(model.network, model.k, patterns),
        "floor": epsilon(identifier.without_static, true, patterns),
    }
    magnitude = np.array(machine.static) - np.array(machine.dry)
    slope = 1.0 / np.array(machine.static_velocity)
    for name, value, error, truth in (
        ("magnitude", model.magnitude, model.magnitude_error, magnitude),
        ("slope", model.slope, model.slope_error, slope),
    ):
        unknown = np.full(truth.size, np.nan)
        ratios = unknown if value is None else value / truth
        errors = unknown if error is None else error / truth
        for joint in range(truth.size):
            row[f"{name} {joint + 1} over truth"] = float(ratios[joint])
            row[f"{name} {joint + 1} error"] = float(errors[joint])
        covered = int(np.sum(np.abs(ratios - 1.0) <= WITHIN * errors))
        row[f"{name}s covered"] = np.nan if value is None or error is None else covered
    return row


def epsilon(network: jc.CSLC, k: np.ndarray, patterns: jc.Patterns) -> float:
    """The mean error cost [N m] (7.5)."""
    return float(np.asarray(jc.compare(network, patterns, {"": k}).epsilon)[0])


def make_rows(options: argparse.Namespace, machine: sim.Machine, rows: Rows) -> None:
    """Makes every missing row, seed by seed."""
    trajectories = (sim.training(samples=options.samples), sim.comparison())
    spacing = next((tuple(row["spacing"]) for row in rows.all()), None)
    identifier = Identifier(jc.puma560(), np.array(machine.encoder_resolution), spacing)
    for seed in command.progress(range(options.seeds), desc="seeds", unit="seed"):
        missing = [method for method in options.methods if (seed, method) not in rows]
        if not missing:
            continue
        # Two numbers a seed: the encoders of the two recordings start elsewhere.
        trained, performed = (
            sim.simulate(machine, trajectory, seed=2 * seed + i)
            for i, trajectory in enumerate(trajectories)
        )
        patterns = moving_patterns(performed)
        for method, model in identifier.models(trained.recording, missing).items():
            row = row_of(identifier, machine, model, patterns)
            rows.add({"seed": seed, "method": method, "spacing": identifier.spacing, **row})
            end = "" if model.converged else ", not converged"
            tqdm.write(f"seed {seed}, {method}: epsilon {row['epsilon']:.4f} N m{end}", sys.stderr)


def summary(rows: Sequence[dict[str, Any]], methods: Sequence[str], joints: int) -> str:
    """A line for each method: ε, and static friction over the true one, over all seeds."""
    header = ["method", "ε [N m]", "floor", "magnitudes/truth", "covered", "slopes/truth"]
    lines: list[list[str]] = []
    for method in methods:
        of_method = [row for row in rows if row["method"] == method]
        line = [method, f"{np.mean([row['epsilon'] for row in of_method]):.4f}"]
        line += [f"{np.mean([row['floor'] for row in of_method]):.4f}"]
        for name in ("magnitude", "slope"):
            ratios = np.array(
                [[row[f"{name} {i} over truth"] for i in range(1, joints + 1)] for row in of_method]
            )
            covered = np.array([row[f"{name}s covered"] for row in of_method])
            if np.any(np.isnan(covered)):
                line += ["", ""]
            else:
                line += [f"{np.min(ratios):.3g} to {np.max(ratios):.3g}"]
                line += [f"{int(np.sum(covered))}/{ratios.size}"]
        lines.append(line)
    return text_table([*header, "covered"], lines)


def study(options: argparse.Namespace) -> int:
    """Makes what is missing, prints the table and writes the files."""
    machine = machine_of(options.encoders, options.time_step)
    names = ("encoders", "samples", "time_step")
    code = [Path(__file__), Path(__file__).with_name("methods.py")]
    digest = made_of({name: getattr(options, name) for name in names}, code)
    finished = Rows(options.output / "rows.jsonl", ("seed", "method"), digest)
    make_rows(options, machine, finished)
    keys = [(seed, method) for seed in range(options.seeds) for method in options.methods]
    rows = [finished[key] for key in keys]
    kind = "encoders" if options.encoders else "exact positions"
    print(f"{options.seeds} seeds, {kind}")
    print(summary(rows, options.methods, machine.joint_count))
    without_spacing = [{k: v for k, v in row.items() if k != "spacing"} for row in rows]
    write_csv(options.output / "seeds.csv", without_spacing)
    picture = static_friction_picture(
        rows,
        options.methods,
        machine.joint_count,
        title=f"PUMA 560 with static friction, {kind}: {options.seeds} seeds",
    )
    save_picture(picture, options.output / "static_friction.png")
    print(f"wrote {options.output / 'seeds.csv'}, {options.output / 'static_friction.png'}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "static_friction")
    parser.add_argument("--seeds", type=int, default=3, help="how many, from 0 on")
    parser.add_argument("--samples", type=int, default=3300, help="of training, 2 ms apart")
    parser.add_argument("--encoders", action="store_true", help="positions in encoder steps")
    parser.add_argument("--time-step", type=float, default=2e-5, help="of the simulator [s]")
    parser.add_argument("--methods", nargs="+", default=list(METHODS), metavar="METHOD",
                        help=f"some of: {', '.join(map(repr, METHODS))}")  # fmt: skip
    quick = {"seeds": 1, "samples": 1000, "time_step": 2e-4, "methods": ["masked", "moving pairs"]}
    options = command.parse(parser, argv, **quick)
    command.require_least(parser, options, seeds=1)
    if not options.time_step > 0.0:
        parser.error(f"--time-step is {options.time_step}; expected more than 0")
    command.require_some_of(parser, "method", options.methods, METHODS)
    simulation = 4e-4 / options.time_step * options.samples / 3300
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=20.0 + options.seeds * (simulation + 10.0 * len(options.methods)),
    )


if __name__ == "__main__":
    raise SystemExit(main())
