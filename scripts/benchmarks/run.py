"""Benchmarks with committed figures: first answers, rates, trainings, commands, memory.

Every figure is a named metric with a unit and a direction. Compile and run times are apart, run
times wait for the result, and rates are beside those of Pinocchio in the same run.

    make bench                                   all but the long groups, beside what is stored
    make bench ARGS="--groups 'direct solve'"    some groups, long ones too
    make bench ARGS=--update                     store the figures, and write docs/benchmarks.md
    make bench ARGS="--out figures.json"         on another machine ...
    make bench ARGS="--merge figures.json"       ... and its figures into the page
"""

import argparse
import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import jaxcslc as jc
from scripts.benchmarks.groups import GROUPS
from scripts.benchmarks.metrics import Metric, report
from scripts.benchmarks.stored.page import PAGE, page
from scripts.benchmarks.stored.results import (
    Measurement,
    baseline_of,
    load,
    merged,
    save,
    this_machine,
)


jc.enable_x64()


def shown(metrics: Iterable[Metric]) -> Iterator[Metric]:
    """The same, each printed as soon as it is measured."""
    for metric in metrics:
        print(f"  {metric.name} {metric.value:.4g} {metric.unit}", file=sys.stderr, flush=True)
        yield metric


def measured(names: Sequence[str], out: Path | None) -> list[Measurement]:
    """Runs groups; a file that is named has all finished ones at any time."""
    done: list[Measurement] = []
    for name in names:
        done.append(Measurement.of(name, shown(GROUPS[name].metrics())))
        if out is not None:
            save(done, out)
    return done


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--groups",
        nargs="+",
        choices=GROUPS,
        default=[name for name, group in GROUPS.items() if not group.long],
        help="what to measure; all but the long ones",
    )
    parser.add_argument("--gate", action="store_true", help="exit 1 if a metric became worse")
    parser.add_argument("--update", action="store_true", help="store the figures, write the page")
    parser.add_argument("--out", type=Path, help="a file for the figures")
    parser.add_argument("--merge", type=Path, nargs="+", help="files of figures; nothing is run")
    options = parser.parse_args(argv)

    stored = load()
    if options.merge is not None:
        figures = [measurement for path in options.merge for measurement in load(path)]
    else:
        with TemporaryDirectory() as cache:  # nothing is compiled before it is timed
            os.environ["XDG_CACHE_HOME"] = cache
            figures = measured(options.groups, options.out)
    metrics = [metric for measurement in figures for metric in measurement.metrics]
    worse = report(metrics, baseline_of(stored, this_machine()))
    if options.update or options.merge is not None:
        save(merged(stored, figures))
        PAGE.write_text(page(load()), encoding="utf-8")  # of the digits that are stored
        print(f"wrote {PAGE}")
    return 1 if options.gate and worse else 0


if __name__ == "__main__":
    raise SystemExit(main())
