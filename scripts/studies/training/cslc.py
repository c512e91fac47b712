"""Train the PUMA 560's CSLC on many recordings side by side, next to the direct solve (7.5).

Both simulated machines of the experiment perform the training and the comparison trajectory once
per seed. From zero weights, one network per recording is trained by each route of `side_by_side`:
backpropagation alone, backpropagation and PERAL in turns, and PERAL in most epochs. The table has
epochs, seconds and ε next to the direct solve of the same patterns, and the seconds of one training
alone. `--letter` adds the training with the thesis's own masks, rates and end.

    python -m scripts.studies.training.cslc
    python -m scripts.studies.training.cslc --seeds 8 --routes backpropagation --letter 1
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxcslc as jc
import sim
from jaxcslc.report import all_or_nothing, write_csv, write_json
from scripts.studies import command
from scripts.studies.puma560.machines import (
    SOLVED,
    TO_THE_LETTER,
    SeedTrainings,
    as_in_the_thesis,
    machines,
    trained_side_by_side,
)
from scripts.studies.rows import Rows, made_of
from scripts.studies.tables import rows_table
from scripts.studies.training.side_by_side import ROUTES
from scripts.studies.training.thesis_route import thesis_route
from scripts.studies.truth import published_coefficients, true_coefficients


jc.enable_x64()

LETTER = "7.5 to the letter"
OPTIONS = ("seeds", "first", "samples", "letter", "untimed")
CODE = [Path(__file__)] + [
    Path(__file__).with_name(f"{name}.py") for name in ("side_by_side", "thesis_route")
]


def route_row(name: str, route: str, every: SeedTrainings, alone: float) -> dict[str, Any]:
    """Return epochs, seconds and errors of one route's trainings; medians over seeds."""
    solved = every.comparison_error[SOLVED]
    errors, training = every.comparison_error[route], every.trainings.get(route)
    epochs = [float("nan")] * 2
    if training is not None:
        epochs = [float(np.median(numbers)) for numbers in training.epochs()]
    others = np.minimum(every.comparison_error["Ar+LS"], every.comparison_error["Ar+Rg"])
    return {
        "machine": name,
        "coefficients": route,
        "epochs of backpropagation": epochs[0],
        "epochs of PERAL": epochs[1],
        "all seeds [s]": float("nan") if training is None else training.seconds,
        "one seed alone [s]": alone,
        "training ε [N m]": float(np.median(every.training_error[route])),
        "comparison ε [N m]": float(np.median(errors)),
        "over the direct solve": float(np.median(errors / solved)),
        "worst seed": float(np.max(errors / solved)),
        "seeds below Ar+LS and Ar+Rg": int(np.sum(errors < others)),
    }


def machine_rows(
    name: str, machine: sim.Machine, options: argparse.Namespace, finished: Rows
) -> None:
    """Add the rows of one machine that are missing, each as soon as it is there."""
    cslc = jc.derive(jc.puma560())
    seeds = command.seeds_of(options)
    trajectories = sim.adjusted_training(samples=options.samples), sim.comparison()
    jobs = [
        sim.Job(machine, trajectory, seed + offset)
        for offset, trajectory in enumerate(trajectories)
        for seed in seeds
    ]
    recordings = [simulated.recording for simulated in sim.record(jobs, progress=True)]
    training, comparison = recordings[: len(seeds)], recordings[len(seeds) :]
    truth = true_coefficients(cslc, machine)
    timed = not options.untimed
    for route in options.routes:
        if (name, route) in finished:
            continue
        every = trained_side_by_side(cslc, training, comparison, truth, (route,), timed=timed)
        alone = float("nan")
        if timed:
            first = trained_side_by_side(
                cslc, training[:1], comparison[:1], truth, (route,), timed=True
            )
            alone = first.trainings[route].seconds
        finished.add(route_row(name, route, every, alone))
        if (name, SOLVED) not in finished:
            others = (other for other in every.comparison_error if other not in ROUTES)
            finished.add(*(route_row(name, other, every, float("nan")) for other in others))
    if options.letter and (name, LETTER) not in finished:
        finished.add(letter_row(name, cslc, training, comparison, options.letter))


def letter_row(
    name: str,
    cslc: jc.CSLC,
    training: Sequence[jc.Recording],
    comparison: Sequence[jc.Recording],
    count: int,
) -> dict[str, Any]:
    """Return the row of trainings to the letter on the first `count` recordings."""
    published = published_coefficients(cslc)
    errors: list[float] = []
    epochs: list[tuple[int, int]] = []
    for learnt, judged in zip(training[:count], comparison[:count], strict=True):
        route = thesis_route(cslc, learnt, TO_THE_LETTER, published)
        table = jc.compare(cslc, as_in_the_thesis(judged), {"": route.k})
        errors += np.asarray(table.epsilon).tolist()
        parts = (route.first.epochs, route.second.epochs)
        epochs.append((parts[0][0] + parts[1][0], parts[0][1] + parts[1][1]))
    backpropagation, peral = np.median(epochs, axis=0).tolist()
    return {
        "machine": name,
        "coefficients": LETTER,
        "epochs of backpropagation": backpropagation,
        "epochs of PERAL": peral,
        "comparison ε [N m]": float(np.median(errors)),
    }


def study(options: argparse.Namespace) -> int:
    """Train on every machine, print the table and write the files."""
    digest = made_of({name: getattr(options, name) for name in OPTIONS}, CODE)
    finished = Rows(options.output / "rows.jsonl", ("machine", "coefficients"), digest)
    for name, machine in machines().items():
        if name[-1] in options.machines:
            machine_rows(name, machine, options, finished)
    rows = [row for row in finished.by_key.values() if row["machine"][-1] in options.machines]
    columns = list(max(rows, key=len))
    rows = [{column: row.get(column, float("nan")) for column in columns} for row in rows]
    print(rows_table(rows))
    print(f"on {jax.devices()[0].device_kind}")
    with all_or_nothing(options.output) as folder:
        write_csv(folder / "training.csv", rows)
        arguments = vars(options) | {"output": str(options.output)}
        write_json(folder / "training.json", {"rows": rows, "command": arguments})
    print(f"wrote {options.output}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "cslc_training")
    command.add_seeds(parser, 32)
    parser.add_argument("--samples", type=int, default=3300, help="of the training recordings")
    parser.add_argument("--machines", nargs="+", choices=["A", "B"], default=["A", "B"])
    parser.add_argument("--routes", nargs="+", choices=list(ROUTES), default=list(ROUTES)[:2])
    parser.add_argument("--letter", type=int, default=0,
                        help="trainings with the thesis's masks, rates and end")  # fmt: skip
    parser.add_argument("--untimed", action="store_true",
                        help="train once only: seconds then contain compiling")  # fmt: skip
    options = command.parse(
        parser, argv, samples=1500, seeds=2, machines=["A"], routes=["backpropagation"],
        untimed=True,
    )  # fmt: skip
    command.require_least(parser, options, samples=500, letter=0)
    if options.quick:
        command.compile_quickly()
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=40.0 if options.quick else 60.0 + 8.0 * options.seeds * len(options.machines),
    )


if __name__ == "__main__":
    raise SystemExit(main())
