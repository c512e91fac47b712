"""How often confidence intervals cover the truth: many simulated recordings of one motion.

Two kinds of recordings of the simulated PUMA 560's training trajectory, each with another seed,
none with effects that the network does not model:

- torque noise: the true motion, its torque with white noise of another strength for each joint;
- encoders: positions as quantised encoders read them, with random phases in each recording, through
  smoothing, masks and the parallel filter to a fit; the drives' demanded torque.

Each is identified as a user would, once with standard errors for independent noise and once for
correlated noise. Printed: how often the interval of a coefficient covered the true value.

Intervals need a smoothing with a wider pass band than the parallel filter: here 28 Hz and 15 Hz.
Motion that a smoothing removes is no noise, and no interval allows for it.
"""

import argparse
import dataclasses
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

import jaxcslc as jc
import sim
from jaxcslc._text_table import text_table
from jaxcslc.report import all_or_nothing, write_csv
from scripts.studies import command
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store
from scripts.studies.tables import grouped
from scripts.studies.truth import true_coefficients


jc.enable_x64()


NOISE, ENCODERS = "torque noise", "encoders"
KINDS = (NOISE, ENCODERS)
ERRORS = ("independent", "correlated")
# Of the root mean square torque of each joint; the thesis's machines were near this.
NOISE_TO_TORQUE = 0.02
SETTINGS = jc.Settings(
    jc.Preparation(jc.AveragedSplines(9), torque_alignment="mean", threshold_fraction=0.1),
    jc.LeastSquares(cutoff=15.0),
)


@dataclasses.dataclass(frozen=True)
class Coverage:
    """The intervals of one kind of recording."""

    kind: str
    errors: str
    covered: Bool[np.ndarray, "recordings coefficients"]
    width: Float[np.ndarray, "recordings coefficients"]
    estimate: Float[np.ndarray, "recordings coefficients"]

    def row(self) -> list[str]:
        """Return the row for the printed table."""
        share = self.covered.mean(axis=0)
        within = np.mean((share >= 0.93) & (share <= 0.97))
        return [
            self.kind,
            self.errors,
            f"{100 * self.covered.mean():.1f} %",
            f"{100 * np.median(share):.1f} %",
            f"{100 * share.min():.1f} to {100 * share.max():.1f} %",
            f"{100 * within:.0f} %",
        ]

    def rows(self, names: Sequence[str], truth: np.ndarray) -> list[dict[str, Any]]:
        """A row for each coefficient, for a CSV file."""
        spread = self.estimate.std(axis=0, ddof=1)
        return [
            {
                "recordings": self.kind,
                "errors": self.errors,
                "coefficient": name,
                "true value": truth[i],
                "coverage": self.covered[:, i].mean(),
                "median interval width": np.median(self.width[:, i]),
                "standard deviation": spread[i],
                "mean error / standard deviation": (self.estimate[:, i].mean() - truth[i])
                / spread[i],
            }
            for i, name in enumerate(names)
        ]


Numbered = Iterator[tuple[int, jc.Patterns]]


def noisy_torques(machine: sim.Machine, seeds: Sequence[int]) -> Numbered:
    """The true motion of one recording, its torque with new noise for each seed."""
    _, truth = sim.simulate(sim.undisturbed(machine), sim.training(), seed=0)
    deviation = NOISE_TO_TORQUE * np.sqrt(np.mean(truth.torque**2, axis=0))
    for seed in seeds:
        noise = deviation * np.random.default_rng(seed).normal(size=truth.torque.shape)
        recording = jc.Recording(truth.time, truth.position, truth.torque + noise)
        threshold = SETTINGS.preparation.threshold_fraction
        exact = jc.Preparation(threshold_fraction=threshold, trim=0)
        motion = truth.position, truth.velocity, truth.acceleration
        yield seed, exact.patterns(recording, motion)


def quantised_positions(machine: sim.Machine, seeds: Sequence[int]) -> Numbered:
    """Recordings with quantised encoders, smoothed and masked."""
    quantised = sim.disturbed(machine, "quantisation")
    trajectory = sim.training()
    jobs = [sim.Job(quantised, trajectory, seed) for seed in seeds]
    for number, result in sim.record_each(jobs):
        if isinstance(result, sim.SimulationError):
            raise result
        yield seeds[number], SETTINGS.patterns(result.recording)


PATTERNS: dict[str, Callable[[sim.Machine, Sequence[int]], Numbered]] = {
    NOISE: noisy_torques,
    ENCODERS: quantised_positions,
}


def make_rows(machine: sim.Machine, options: argparse.Namespace, rows: Rows) -> None:
    """Fits every recording that has no row: estimates, and half the widths of intervals."""
    network, count = jc.derive(machine.robot), options.recordings
    missing = {kind: [i for i in range(count) if (kind, i) not in rows] for kind in KINDS}
    done = len(KINDS) * count - sum(map(len, missing.values()))
    with command.progress(
        desc="recordings", unit="recording", total=len(KINDS) * count, initial=done
    ) as bar:
        for kind, seeds in missing.items():
            # White noise on true motion needs no filter.
            cutoff = None if kind == NOISE else SETTINGS.solver.cutoff
            for seed, recording in PATTERNS[kind](machine, seeds) if seeds else ():
                row: dict[str, Any] = {"kind": kind, "seed": seed}
                for errors in ERRORS:
                    settings = SETTINGS.with_options(cutoff=cutoff, errors=errors)
                    fit = settings.fit(network, recording)
                    low, high = fit.confidence_interval(options.level).T
                    row["estimate"] = np.asarray(fit.k).tolist()
                    row[errors] = (0.5 * (high - low)).tolist()
                rows.add(row)
                bar.update()


def coverage_of(
    kind: str, rows: Rows, count: int, truth: Float[np.ndarray, " coefficients"]
) -> list[Coverage]:
    """Compares the intervals of a kind of recordings with the truth."""
    of_kind = [rows[kind, seed] for seed in range(count)]
    estimate = np.array([row["estimate"] for row in of_kind])
    half = {errors: np.array([row[errors] for row in of_kind]) for errors in ERRORS}
    return [
        Coverage(kind, errors, np.abs(estimate - truth) <= width, 2.0 * width, estimate)
        for errors, width in half.items()
    ]


def study(options: argparse.Namespace) -> int:
    """Identifies all recordings, prints the table and writes the file."""
    machine = sim.puma560()
    network = jc.derive(machine.robot)
    names, truth = network.names, np.asarray(true_coefficients(network, machine))
    rows = Rows(
        options.output / "rows.jsonl",
        ("kind", "seed"),
        made_of({"level": options.level}, [Path(__file__)]),
    )
    make_rows(machine, options, rows)
    results = [
        coverage
        for kind in KINDS
        for coverage in coverage_of(kind, rows, options.recordings, truth)
    ]
    header = ["recordings", "errors", "mean", "median", "lowest to highest, over coefficients"]
    header += ["within 93 to 97 %"]
    print(
        f"{100 * options.level:g} % intervals of {len(names)} coefficients that covered the truth,"
        f" {options.recordings} recordings of each kind"
    )
    table = [header, *(coverage.row() for coverage in results)]
    print(text_table(header, table[1:], left=header[:2]))
    sample = f"{options.recordings} recordings of each kind"
    store(options, "coverage", sample, {"intervals": grouped(table)})
    with all_or_nothing(options.output) as folder:
        of_coefficients = [row for coverage in results for row in coverage.rows(names, truth)]
        write_csv(folder / "coverage.csv", of_coefficients)
    print(f"\nwrote coverage.csv into {options.output}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "coverage_study")
    parser.add_argument("--recordings", type=int, default=500, help="how many of each kind")
    parser.add_argument("--level", type=float, default=0.95, help="of the intervals")
    command.add_store(parser)
    options = command.parse(parser, argv, recordings=5)
    command.require_least(parser, options, recordings=2)
    command.require_between(parser, options, level=(0.0, 1.0))
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=25 + 1.2 * options.recordings,
    )


if __name__ == "__main__":
    raise SystemExit(main())
