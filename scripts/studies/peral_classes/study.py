"""PERAL on classes of network, and when to switch to it (thesis 8.2.2).

Classes: linear combiners, a hard limiter, sigmoids in one and two layers, radial basis functions,
the CSLCs of arms of 2, 3, 6 and 7 joints, and two systems that are no manipulators. Each learns
random patterns (systems: samples of their motion), with noise on its targets of so many parts of
their standard deviation. Every seed has other patterns, another truth (systems: the true constants)
and another start.

- **Rules.** Backpropagation from random weights; from many of its epochs on, PERAL. Both start with
  4/13 of the rate that gains most in their first epoch, and adapt it by the rule of 6.3.1, one rate
  for each adaptive layer, by half the mean square error.
- **Best switch in hindsight**: of all these switches, never and at once among them, the one that is
  quickest for a seed.
- **Indicator**: `SwitchWhen`, whose settings were selected by `--tune` on the classes marked with a
  star, on other seeds than the results'.
- **Alternatives**: momentum, Adam, RPROP and quickprop with the best of four or five learning rates
  in hindsight; the one-step secant, conjugate gradients, scaled conjugate gradients, BFGS, L-BFGS
  and Levenberg-Marquardt; the direct solve where there is one. A step of conjugate gradients or
  BFGS is one evaluation of the cost: their line searches take several.
- **Goals**: a root mean square error that exceeds the least by so much of the targets' standard
  deviation, in quadrature. The least is that of the direct solve, or of Levenberg-Marquardt from
  the true weights.
- **Seconds** are epochs times the time of one epoch of one training alone, the search for rates
  included, the shortest of several; those of the indicator include its looks.

Finished parts are kept in `rows.jsonl`; an interrupted run goes on from there.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax

import jaxcslc as jc
from jaxcslc.report import all_or_nothing, write_csv
from jaxcslc.training import SwitchWhen
from scripts.studies import command
from scripts.studies.figures import save_picture
from scripts.studies.peral_classes.classes import CLASSES, problem
from scripts.studies.peral_classes.pictures import pictures
from scripts.studies.peral_classes.results import (
    alternative_row,
    guided_row,
    hard_limiter_row,
    rule_row,
)
from scripts.studies.peral_classes.spectra import spectrum_row
from scripts.studies.peral_classes.tables import Results, page_tables, report, tuning_table
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store


jc.enable_x64()

RULES, GUIDED, ALTERNATIVES, SPECTRUM = "rules", "indicator", "alternatives", "spectrum"
KEYS = ("class", "noise", "part", "every", "margin")
OPTIONS = ("seeds", "first_seed", "epochs", "tuning")
# Tried by --tune.
EVERY, MARGIN = (5, 10), (1.0, 1.25, 1.5, 2.0)
TUNING_SEEDS = 1000  # the first seed of --tune
Key = tuple[str, float, str, int, float]


def parts(options: argparse.Namespace) -> list[Key]:
    """Keys of the rows that are wanted."""
    keys: list[Key] = []
    for name in options.classes:
        for noise in options.noise:
            if name == "hard limiter" and noise != options.noise[0]:
                continue
            keys.append((name, noise, RULES, 0, 0.0))
            if name != "hard limiter":
                keys += [(name, noise, GUIDED, *setting) for setting in options.settings]
            if not options.tune and name != "hard limiter":
                keys.append((name, noise, ALTERNATIVES, 0, 0.0))
        if not options.tune and name != "hard limiter":
            keys.append((name, 0.0, SPECTRUM, 0, 0.0))
    return keys


def make_row(key: Key, options: argparse.Namespace) -> dict[str, Any]:
    """One part of the results."""
    name, noise, part, every, margin = key
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    of_class = problem(CLASSES[name], noise, seeds)
    if name == "hard limiter":
        return hard_limiter_row(of_class, options.epochs)
    if part == ALTERNATIVES:
        return alternative_row(of_class, options.epochs)
    if part == SPECTRUM:
        return spectrum_row(of_class)
    if part == GUIDED:
        return guided_row(of_class, SwitchWhen(every=every, margin=margin), options.epochs)
    return rule_row(of_class, options.epochs, options.tuning)


def study(options: argparse.Namespace) -> int:
    """Makes what is missing, prints the tables and writes the files."""
    code = [
        Path(__file__).with_name(f"{name}.py")
        for name in ("alternatives", "classes", "classic_rules", "results", "spectra", "switches")
    ]
    digest = made_of({name: getattr(options, name) for name in OPTIONS}, code)
    finished = Rows(options.output / "rows.jsonl", KEYS, digest)
    wanted = parts(options)
    missing = [key for key in wanted if key not in finished]
    with command.progress(
        desc="parts", unit="part", total=len(wanted), initial=len(wanted) - len(missing)
    ) as bar:
        for before, key in zip([missing[:1], *missing], missing, strict=False):
            if before and before[0] != key[0]:
                jax.clear_caches()  # programs of another class
            bar.set_description(f"{key[0]}, noise {key[1]:g}, {key[2]}")
            finished.add(dict(zip(KEYS, key, strict=True)) | make_row(key, options))
            bar.update()
    rows = [finished[key] for key in wanted]
    if options.tune:
        print(tuning_table(rows))
        return 0
    results = Results(rows)
    print(report(results, options.seeds))
    if results.compared:
        tables, sample = page_tables(results), f"{options.seeds} seeds"
        if set(options.classes) == set(CLASSES):
            store(options, "peral_classes", sample, tables)
        else:  # of some classes, the page has the rules of the thesis
            store(options, "peral_rules", sample, {"steps": tables["epochs"]})
    with all_or_nothing(options.output) as folder:
        for name, lines in (
            ("methods.csv", results.methods()),
            ("indicator.csv", results.indicator()),
        ):
            if lines:
                write_csv(folder / name, lines)
        for name, figure in pictures(results).items():
            save_picture(figure, folder / name)
    print(f"results are in {options.output}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    default = SwitchWhen()
    parser = command.new_parser(__doc__, "peral_classes")
    parser.add_argument("--classes", nargs="+", default=list(CLASSES), metavar="NAME",
                        help=f"some of: {', '.join(map(repr, CLASSES))}")  # fmt: skip
    parser.add_argument("--noise", type=float, nargs="+", default=[0.0, 0.05, 0.2],
                        help="of targets, in parts of their standard deviation")  # fmt: skip
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--epochs", type=int, default=600, help="of backpropagation, at most")
    parser.add_argument("--tuning", type=int, default=200, help="epochs of PERAL after a switch")
    parser.add_argument("--every", type=int, default=default.every, help="of the indicator")
    parser.add_argument("--margin", type=float, default=default.margin, help="of the indicator")
    parser.add_argument("--tune", action="store_true", help="compare settings of the indicator")
    command.add_store(parser)
    options = command.parse(
        parser, argv, classes=["linear"], noise=[0.05], seeds=2, epochs=60,
        tuning=30,
    )  # fmt: skip
    command.require_least(parser, options, seeds=1, first_seed=0, epochs=20, tuning=2, every=1)
    command.require_some_of(parser, "class", options.classes, tuple(CLASSES))
    if not all(0.0 <= noise <= 1.0 for noise in options.noise):
        parser.error(f"--noise is {options.noise}; expected 0 to 1")
    if not options.margin > 0.0:
        parser.error(f"--margin is {options.margin}; expected more than 0")
    options.settings = [(options.every, options.margin)]
    if options.tune:
        options.settings = [(every, margin) for every in EVERY for margin in MARGIN]
        options.classes = [name for name in options.classes if CLASSES[name].tuned]
        options.first_seed += TUNING_SEEDS
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=seconds(options),
    )


def seconds(options: argparse.Namespace) -> float:
    """Return how long the study takes on two cores: mostly compilation."""
    return sum(20.0 if "6" in key[0] or "7" in key[0] else 10.0 for key in parts(options))


if __name__ == "__main__":
    raise SystemExit(main())
