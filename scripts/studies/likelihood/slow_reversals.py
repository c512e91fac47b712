"""Static friction from a recording that is made for it: slow reversals of all joints.

A simulated PUMA 560 with static friction (Eqn. 2.5-4) and encoders performs the training
trajectory, whose joints hardly move at the low speeds of static friction, and one in which every
joint swings to and fro under feedback control, with greatest speeds of four times those at which
static friction has fallen to 1/e. Both recordings are identified together
(`jaxcslc.MaximumLikelihood`).

Joint by joint, over seeds: magnitudes and slopes of static friction over the true ones, with median
errors and medians of reported standard errors; and how many of the reported 95 % intervals cover
the truth, of static friction and of all coefficients.

Rows of finished seeds are kept in `rows.jsonl`; an interrupted run goes on from there.
"""

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import jaxcslc as jc
import sim
from jaxcslc._text_table import text_table
from jaxcslc.report import write_csv
from jaxcslc.uncertainty import uncertainty_interval
from scripts.studies import command
from scripts.studies.likelihood.study import WITHIN, static_table
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store
from scripts.studies.truth import true_coefficients


jc.enable_x64()

# Of each joint's swing: greatest speed over that at which static friction has fallen to 1/e, and
# period [s].
FASTEST = 4.0
PERIODS = (2.9, 2.3, 1.9, 1.7, 1.3, 1.1)
START = (0.4, -1.2, 0.3, 0.0, 0.3, 0.0)  # rad


def swings(machine: sim.Machine, samples: int) -> sim.Trajectory:
    """Sines of all joints from rest, under the control of the comparison trajectory."""
    template = sim.comparison()
    time = template.sample_interval * np.arange(samples)[:, None]
    rate = 2.0 * np.pi / np.array(PERIODS)
    speed = FASTEST * np.array(machine.static_velocity)
    path = sim.SampledPath(
        np.array(START) + speed / rate * (1.0 - np.cos(rate * time)),
        speed * np.sin(rate * time),
        speed * rate * np.cos(rate * time),
        interval=template.sample_interval,
    )
    return dataclasses.replace(
        template, name="slow reversals", start=np.array(START), samples=samples, path=path
    )


def row_of(machine: sim.Machine, samples: int, slow_samples: int, seed: int) -> dict[str, Any]:
    """Errors, over the true values, of the fit of both recordings of one seed."""
    trajectories = (sim.training(samples=samples), swings(machine, slow_samples))
    recordings = [
        sim.simulate(machine, trajectory, seed=2 * seed + number).recording
        for number, trajectory in enumerate(trajectories)
    ]
    network = jc.derive(machine.robot.with_friction("viscous", "dry", "static"))
    result = jc.MaximumLikelihood().fit(network, recordings)
    static = np.array(machine.static) - np.array(machine.dry)
    slopes = 1.0 / np.array(machine.static_velocity)
    true = np.asarray(true_coefficients(network, machine, static=static))
    rows = network.layout.term_slice("static")
    low, high = uncertainty_interval(result.fit, None, 0.95).T
    inside = (low <= true) & (true <= high)
    error = np.asarray(result.fit.standard_error)
    return {
        "static": (np.asarray(result.k)[rows] / static).tolist(),
        "static error": (error[rows] / static).tolist(),
        "slope": (result.slopes / slopes).tolist(),
        "slope error": (result.slope_error / slopes).tolist(),
        "magnitudes inside": inside[rows].tolist(),
        "slopes inside": (np.abs(result.slopes - slopes) <= WITHIN * result.slope_error).tolist(),
        "all inside": float(np.mean(inside)),
        "steps": result.steps,
        "converged": result.converged,
    }


def study(options: argparse.Namespace) -> int:
    """Makes what is missing, prints the table and writes the rows."""
    machine = sim.disturbed(sim.puma560(), "static friction", "quantisation")
    machine = dataclasses.replace(machine, time_step=options.time_step)
    sizes = {"samples": options.samples, "slow_samples": options.slow_samples}
    digest = made_of({**sizes, "time_step": options.time_step}, [Path(__file__)])
    finished = Rows(options.output / "rows.jsonl", ("seed",), digest)
    seeds = command.seeds_of(options)
    for seed in command.progress(seeds, desc="seeds", unit="seed"):
        if (seed,) not in finished:
            row = row_of(machine, options.samples, options.slow_samples, seed)
            finished.add({"seed": seed, **row})
    rows = [finished[(seed,)] for seed in seeds]
    head, *lines = static_table(rows)
    print(text_table(head, lines))
    store(options, "slow_reversals", f"seeds {seeds[0]} to {seeds[-1]}", {"joints": [head, *lines]})
    for name in ("magnitudes inside", "slopes inside", "all inside"):
        share = 100 * np.mean([row[name] for row in rows])
        print(f"{name.removesuffix(' inside')}: {share:.1f} % of 95 % intervals cover the truth")
    print(f"converged: {sum(row['converged'] for row in rows)} of {len(rows)}")
    plain = ("seed", "all inside", "steps", "converged")
    write_csv(options.output / "seeds.csv", [{name: row[name] for name in plain} for row in rows])
    print(f"wrote {options.output / 'seeds.csv'}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "slow_reversals")
    command.add_seeds(parser, 10)
    parser.add_argument("--samples", type=int, default=3300, help="of training, 2 ms apart")
    parser.add_argument("--slow-samples", type=int, default=6600, help="of slow reversals")
    parser.add_argument("--time-step", type=float, default=1e-4, help="of the simulator [s]")
    command.add_store(parser)
    options = command.parse(parser, argv, seeds=1, samples=1000, slow_samples=1500, time_step=5e-4)
    command.require_least(parser, options, seeds=1, first=0, samples=300, slow_samples=300)
    if not options.time_step > 0.0:
        parser.error(f"--time-step is {options.time_step}; expected more than 0")
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=30.0 + options.seeds * (2.5e-3 / options.time_step + 35.0),
    )


if __name__ == "__main__":
    raise SystemExit(main())
