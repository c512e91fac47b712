"""After bearings are cleaned: friction alone re-identified from a few seconds (5.2.4, 8.2.3).

A simulated PUMA 560 with encoders and static friction is identified once from the training
trajectory. Then every joint's viscous, dry and static friction falls by 20 to 50 %, drawn at random
for each, and the arm performs the training trajectory again, with torques so much smaller that it
stays within its range. Of this second recording only the first seconds are used:

- **as before**: the coefficients of the first identification.
- **friction alone**: viscous and dry friction are re-identified, the other coefficients are fixed
  (`jaxcslc.reidentify`).
- **everything**: all 43 coefficients from the short recording alone.

All are judged by ε on the comparison trajectory of the cleaned arm, on the links' true motion
where they move. The floor is what the true coefficients leave of it: static friction.
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
from jaxcslc.recordings import choose_spacing
from jaxcslc.report import write_csv
from scripts.studies import command
from scripts.studies.figures import save_picture
from scripts.studies.reidentification.pictures import reidentification_picture
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store
from scripts.studies.tables import median_text
from scripts.studies.truth import moving_patterns, true_coefficients


jc.enable_x64()

CUTOFF = 15.0  # Hz
THRESHOLD_FRACTION = 0.01
TORQUES = 0.8  # of the training trajectory's, for the cleaned arm
METHODS = BEFORE, FRICTION, EVERYTHING = "as before", "friction alone", "everything"


def cleaned(machine: sim.Machine, seed: int, fall: tuple[float, float]) -> sim.Machine:
    """The machine with less friction in every joint."""
    rng = np.random.default_rng([seed, 1])
    left = {
        name: tuple((1.0 - rng.uniform(*fall, machine.joint_count)) * getattr(machine, name))
        for name in ("viscous", "dry")
    }
    # What static friction adds to dry friction falls alike.
    static = np.array(machine.static) * np.array(left["dry"]) / np.array(machine.dry)
    return dataclasses.replace(machine, **left, static=tuple(static))


def settings_of(machine: sim.Machine, recording: jc.Recording) -> jc.Settings:
    """Settings for a recording's encoders."""
    spacing = choose_spacing(
        recording.time, recording.position, resolution=np.array(machine.encoder_resolution)
    )
    preparation = jc.Preparation(
        jc.AveragedSplines(spacing), torque_alignment="mean", threshold_fraction=THRESHOLD_FRACTION
    )
    return jc.Settings(preparation, jc.LeastSquares(cutoff=CUTOFF))


class Study:
    """One machine, and the rows of each seed."""

    def __init__(self, lengths: Sequence[float], fall: tuple[float, float], samples: int) -> None:
        self.machine = sim.disturbed(sim.puma560(), "quantisation", "static friction")
        self.network = jc.derive(jc.puma560())
        self.lengths, self.fall = tuple(lengths), fall
        longest = round(max(lengths) / 0.002) + 1
        torques = tuple(TORQUES * x for x in (25.0, 13.0, 14.0, 8.0, 10.0, 14.0))
        self.training = sim.training(samples=samples)
        self.after_cleaning = sim.training(samples=longest, amplitude=torques)

    def rows(self, seed: int) -> list[dict[str, Any]]:
        """A row for each length and method, of one seed."""
        machine, network = self.machine, self.network
        after = cleaned(machine, seed, self.fall)
        trained = sim.simulate(machine, self.training, seed=3 * seed).recording
        settings = settings_of(machine, trained)
        before = settings.fit(network, settings.patterns(trained))
        recording = sim.simulate(after, self.after_cleaning, seed=3 * seed + 1).recording
        patterns = moving_patterns(sim.simulate(after, sim.comparison(), seed=3 * seed + 2))
        true = true_coefficients(network, after)
        friction = network.layout.indices("viscous", "dry")
        rows: list[dict[str, Any]] = []
        for length in self.lengths:
            first_rows = recording.time - recording.time[0] < length
            short = settings.patterns(recording.rows(first_rows))
            alone = settings.reidentify(network, short, before, ("viscous", "dry"))
            k = {BEFORE: before.k, FRICTION: alone.k}
            whole = settings.solver.fit(network, short, throw=False)
            if whole.result != jc.RESULTS.no_equations:
                k[EVERYTHING] = whole.k
            vectors = k | {"floor": true}
            errors = np.asarray(jc.compare(network, patterns, vectors).epsilon)
            epsilon = dict(zip(vectors, errors.tolist(), strict=True))
            within = np.abs(alone.k - true) <= 2.0 * alone.standard_error
            for method in METHODS:
                off = (
                    np.asarray(k.get(method, np.nan) - true)[friction] / np.asarray(true)[friction]
                )
                row: dict[str, Any] = {
                    "seed": seed,
                    "length": length,
                    "method": method,
                    "epsilon": epsilon.get(method, np.nan),
                    "floor": epsilon["floor"],
                    "friction_error": float(np.median(np.abs(off))),
                    "within_2_errors": "",
                }
                if method == FRICTION:
                    row["within_2_errors"] = float(np.mean(np.asarray(within)[friction]))
                rows.append(row)
        return rows


def summary(rows: Sequence[dict[str, Any]], lengths: Sequence[float]) -> list[list[str]]:
    """Medians and 10 to 90 % ranges, one line for each length, the head first."""
    cells = [
        ["ε [N m] after", *METHODS, "true coefficients", "error of friction alone [%]"],
    ]
    for length in lengths:
        of_length = [row for row in rows if row["length"] == length]
        before, alone, whole = (
            [row for row in of_length if row["method"] == method] for method in METHODS
        )
        cells.append(
            [
                f"{length:g} s",
                *(median_text([row["epsilon"] for row in some]) for some in (before, alone, whole)),
                median_text([row["floor"] for row in before]),
                median_text([100 * row["friction_error"] for row in alone]),
            ]
        )
    return cells


def draw(rows: Sequence[dict[str, Any]], lengths: Sequence[float], path: Path) -> None:
    """Draws ε by the length of the recording."""
    errors = {
        method: np.array(
            [
                [
                    row["epsilon"]
                    for row in rows
                    if row["method"] == method and row["length"] == length
                ]
                for length in lengths
            ]
        )
        for method in METHODS
    }
    picture = reidentification_picture(
        lengths,
        errors,
        floor=float(np.median([row["floor"] for row in rows])),
        title="PUMA 560 with cleaned bearings: torque error on another trajectory",
    )
    save_picture(picture, path)


def study(options: argparse.Namespace) -> int:
    """Makes what is missing, prints the table and writes the files."""
    lengths = sorted(set(options.lengths))
    made = {"lengths": lengths, "fall": list(options.fall), "samples": options.samples}
    digest = made_of(made, [Path(__file__)])
    finished = Rows(options.output / "rows.jsonl", ("seed",), digest)
    of_machine = Study(lengths, tuple(options.fall), options.samples)
    for seed in command.progress(range(options.seeds), desc="seeds", unit="seed"):
        if (seed,) not in finished:
            finished.add({"seed": seed, "rows": of_machine.rows(seed)})
    rows = [row for seed in range(options.seeds) for row in finished[(seed,)]["rows"]]
    head, *lines = summary(rows, lengths)
    print(f"{options.seeds} seeds: median (10 to 90 %)\n{text_table(head, lines)}")
    store(options, "reidentification", f"{options.seeds} seeds", {"durations": [head, *lines]})
    within = [row["within_2_errors"] for row in rows if row["method"] == FRICTION]
    print(
        f"friction alone: {np.mean(within):.0%} of its coefficients within two standard errors of"
        " the truth; standard errors do not contain static friction, which has no coefficient"
    )
    write_csv(options.output / "seeds.csv", rows)
    draw(rows, lengths, options.output / "reidentification.png")
    print(f"wrote {options.output / 'seeds.csv'}, {options.output / 'reidentification.png'}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "reidentification")
    parser.add_argument("--seeds", type=int, default=20, help="how many, from 0 on")
    parser.add_argument("--lengths", type=float, nargs="+", default=[0.5, 1.0, 2.0, 3.3, 6.6],
                        metavar="S", help="of the recordings after cleaning [s]")  # fmt: skip
    parser.add_argument("--fall", type=float, nargs=2, default=(0.2, 0.5), metavar=("LOW", "HIGH"),
                        help="of friction, as parts of it")  # fmt: skip
    parser.add_argument("--samples", type=int, default=3300, help="of training, 2 ms apart")
    command.add_store(parser)
    options = command.parse(parser, argv, seeds=1, lengths=[0.5, 2.0], samples=1500)
    command.require_least(parser, options, seeds=1)
    if min(options.lengths) < 0.2:
        parser.error(f"--lengths: {min(options.lengths):g} s is too short; expected 0.2 s or more")
    if not 0.0 <= options.fall[0] <= options.fall[1] < 1.0:
        parser.error("--fall: expected two parts from 0 to less than 1, the lower one first")
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=20.0 + options.seeds * (5.0 + 3.0 * len(options.lengths)),
    )


if __name__ == "__main__":
    raise SystemExit(main())
