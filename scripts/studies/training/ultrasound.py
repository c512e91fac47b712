"""PERAL against backpropagation on the ultrasound scene, over a range of conditions (6.3.1).

The thesis shows one training: backpropagation to 30 % of correct classifications in 41 epochs,
from there to 50 % in 341 more, and PERAL about five times faster. Its recordings, starts and cost
are not known, so that every one of these is varied here:

- the number of patterns;
- inputs as they are, or with their means subtracted;
- the share of correct classifications at which PERAL takes over;
- the cost that rates are adapted by: the mean error modulus of 6.3.1, or half the mean square.

Every seed is another start. Otherwise as `scripts/studies/training/peral.py`, which see: rates,
PERAL's first rate, how epochs and seconds are counted. A row is a condition and a goal: a share of
correct classifications.

A second table has the shares of correct classifications of the training patterns and of the 1,850
comparison patterns, which no training sees.
"""

import argparse
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import jaxcslc as jc
from jaxcslc._text_table import text_table
from jaxcslc.report import all_or_nothing, write_csv
from jaxcslc.training import Cost, half_square, mean_modulus
from scripts.studies import command
from scripts.studies.figures import save_picture
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store
from scripts.studies.training.learning_pictures import conditions_picture
from scripts.studies.training.peral_comparison import compare_ultrasound, correct, ultrasound
from scripts.studies.training.peral_operations import PERAL_RULE
from scripts.studies.training.peral_tables import epoch_rows, number, spread


jc.enable_x64()

COSTS: dict[str, Cost] = {"mean modulus": mean_modulus, "half square": half_square}
KEYS = ("patterns", "centred", "hand-over", "cost")
OPTIONS = ("seeds", "before", "further", "tuning")
RATIO = "backpropagation's median epochs over PERAL's"
SECONDS_RATIO = "backpropagation's median seconds over PERAL's"


def conditions(options: argparse.Namespace) -> list[tuple[int, bool, float, str]]:
    """Patterns, whether inputs are centred, hand-over and cost."""
    return [
        (patterns, centred, hand_over, cost)
        for patterns in options.patterns
        for centred in (False, True)
        for hand_over in options.hand_over
        for cost in options.costs
    ]


def make_rows(options: argparse.Namespace, rows: Rows) -> None:
    """Compares both rules under every condition that has no row."""
    wanted = conditions(options)
    missing = [condition for condition in wanted if condition not in rows]
    with command.progress(
        desc="conditions", unit="condition", total=len(wanted), initial=len(wanted) - len(missing)
    ) as bar:
        for condition in missing:
            patterns, centred, hand_over, cost = condition
            checkpoints = options.output / f"unfinished-{rows.digest[:12]}"
            outcome = compare_ultrasound(
                ultrasound(patterns, centred=centred),
                options,
                checkpoints,
                handed_over=hand_over,
                cost=COSTS[cost],
            )
            goals = [
                {name: value for name, value in row.items() if name not in ("problem", "variant")}
                for row in epoch_rows(outcome)
            ]
            rows.add(
                dict(zip(KEYS, condition, strict=True))
                | {"goals": goals, "correct": correct(outcome)}
            )
            shutil.rmtree(checkpoints)
            bar.update()


def flat(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row for each condition, goal and rule."""
    return [
        {name: row[name] for name in KEYS} | goal
        for row in rows
        for goal in row["goals"]
        if float(goal["goal"].split()[0].rstrip("%")) > 100.0 * row["hand-over"]
    ]


def table(rows: Sequence[dict[str, Any]]) -> list[list[str]]:
    """A line for each condition and goal, the head first."""
    header = ["patterns", "inputs", "cost", "hand-over", "goal"]
    header += ["epochs, backpropagation", "epochs, PERAL", "ratio", "ratio of seconds"]
    lines: list[list[str]] = []
    for first, second in zip(rows[::2], rows[1::2], strict=True):
        epochs = [
            f"{number(row['epochs, median'])} ({row['reached']}/{row['handed over']})"
            for row in (first, second)
        ]
        lines.append(
            [
                str(first["patterns"]),
                "centred" if first["centred"] else "as they are",
                first["cost"],
                f"{first['hand-over']:.0%}",
                first["goal"],
                *epochs,
                number(second[RATIO], 2),
                number(second[SECONDS_RATIO], 2),
            ]
        )
    return [header, *lines]


def correct_rows(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row for each condition and stage: medians over starts of the shares that are correct."""
    return [
        {name: row[name] for name in KEYS}
        | {"at": "hand-over" if stage["at"] == "hand-over" else f"end of {stage['at']}"}
        | {
            f"{patterns} patterns correct": spread(np.array(stage[patterns]))["median"]
            for patterns in ("training", "comparison")
        }
        for row in rows
        for stage in row["correct"]
    ]


def correct_table(rows: Sequence[dict[str, Any]]) -> list[list[str]]:
    """A line for each row of `correct_rows`, the head first."""
    lines = [
        [
            f"{row['patterns']:,}",
            "centred" if row["centred"] else "as they are",
            row["at"],
            *(f"{row[f'{name} patterns correct']:.1%}" for name in ("training", "comparison")),
            row["cost"],
            f"{row['hand-over']:.0%}",
        ]
        for row in rows
    ]
    header = ["patterns", "inputs", "at", "training patterns correct"]
    header += ["comparison patterns correct", "cost", "hand-over"]
    return [header, *lines]


def wins(rows: Sequence[dict[str, Any]]) -> str:
    """Return in how many conditions and goals which rule takes fewer epochs, and less time."""
    by_rule = [row for row in rows if row["rule"] == PERAL_RULE]
    parts: list[str] = []
    for what, name in (("fewer epochs", RATIO), ("less time", SECONDS_RATIO)):
        ratios = np.array([row[name] for row in by_rule])
        parts.append(
            f"{what}: PERAL in {int(np.sum(ratios > 1))}, backpropagation in"
            f" {int(np.sum(ratios < 1))} of {len(ratios)} conditions and goals,"
            f" {int(np.sum(np.isnan(ratios)))} undecided, as neither reaches the goal in the median"
        )
    return "\n".join(parts)


def study(options: argparse.Namespace) -> int:
    """Makes what is missing, prints the table and writes the files."""
    code = [
        Path(__file__).with_name(f"{name}.py")
        for name in ("ultrasound", "peral_comparison", "peral_operations")
    ]
    digest = made_of({name: getattr(options, name) for name in OPTIONS}, code)
    finished = Rows(options.output / "rows.jsonl", KEYS, digest)
    make_rows(options, finished)
    of_conditions = [finished[condition] for condition in conditions(options)]
    rows, shares = flat(of_conditions), correct_rows(of_conditions)
    print(f"epochs from the hand-over on, medians of {options.seeds} starts (starts that arrive)")
    head, *lines = table(rows)
    print(text_table(head, lines, left=("inputs", "cost")))
    print(wins(rows))
    print("\nclassified correctly, medians of starts that were handed over")
    head, *lines = correct_table(shares)
    print(text_table(head, lines, left=("inputs", "at", "cost")))
    sample = f"{options.seeds} starts"
    store(options, "ultrasound", sample, {"epochs": table(rows)})
    store(options, "ultrasound_comparison", sample, {"patterns": correct_table(shares)})
    with all_or_nothing(options.output) as folder:
        write_csv(folder / "conditions.csv", rows)
        write_csv(folder / "correct.csv", shares)
        save_picture(conditions_picture(rows, options.seeds), folder / "conditions.png")
    print(f"wrote conditions.csv, correct.csv and conditions.png into {options.output}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "peral_ultrasound")
    parser.add_argument("--seeds", type=int, default=20, help="starts")
    parser.add_argument("--patterns", type=int, nargs="+", default=[200, 600, 1050, 3150],
                        help="each from 100 to 3150")  # fmt: skip
    parser.add_argument("--hand-over", type=float, nargs="+", default=[0.2, 0.3, 0.4],
                        metavar="SHARE", help="of correct classifications")  # fmt: skip
    parser.add_argument("--costs", nargs="+", choices=list(COSTS), default=list(COSTS))
    parser.add_argument("--before", type=int, default=300, help="epochs at most to the hand-over")
    parser.add_argument("--further", type=int, default=700, help="epochs of backpropagation after")
    parser.add_argument("--tuning", type=int, default=700, help="epochs of PERAL at most")
    command.add_store(parser)
    options = command.parse(
        parser, argv, seeds=2, patterns=[200], hand_over=[0.3], before=100, further=100, tuning=100
    )
    command.require_least(parser, options, seeds=1, before=1, further=1, tuning=1)
    if not all(100 <= patterns <= 3150 for patterns in options.patterns):
        parser.error(f"--patterns is {options.patterns}; expected 100 to 3150")
    if not all(0.1 < share < 0.5 for share in options.hand_over):
        parser.error(f"--hand-over is {options.hand_over}; expected more than 0.1, less than 0.5")
    epochs = options.before * 2 + options.further + options.tuning
    work = sum(patterns for patterns, *_ in conditions(options)) * options.seeds * epochs
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=20.0 + 1e-6 * work,
    )


if __name__ == "__main__":
    raise SystemExit(main())
