"""Constants that enter nonlinearly: how often the global minimum is met, and what else there is.

Four systems of `study.py` with constants that their equations are not linear in: the period of a
motor's cogging torque; the speed over which its friction falls (Stribeck); the slip angles over
which a vehicle's tyres saturate; the exponent of the flow between tanks. Coefficients are
eliminated by the direct solve, the others are searched.

- **starts**: of evenly spread starts of local searches on one recording, the share that ended in
  the best minimum; what a local search without a choice of starts would do;
- **searches**: of whole searches, each on another recording with other points, the share that
  ended in the global minimum: within five standard errors, and a thousandth of the bounds, of the
  truth;
- **other minima**: how many were seen on the first recording, and how much larger the error of the
  next best is.

Finished rows stay in the output folder, and an interrupted run goes on from there.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import jaxcslc as jc
from jaxcslc._text_table import text_table
from jaxcslc.report import all_or_nothing, write_csv
from jaxcslc.systems import ConstantSearch, SystemRecording, search_constants, system_patterns
from scripts.studies import command
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store
from scripts.studies.systems.example import Example
from scripts.studies.systems.examples.motor import FREE_PERIOD, STRIBECK
from scripts.studies.systems.examples.tanks import FREE_EXPONENT
from scripts.studies.systems.examples.vehicle import SATURATING_TYRES


jc.enable_x64()

EXAMPLES = {
    example.name: example for example in (FREE_PERIOD, STRIBECK, SATURATING_TYRES, FREE_EXPONENT)
}
_FOLDER = Path(__file__).parent
_SECONDS = 8.0  # of a search
CODE = [*sorted(_FOLDER.glob("*.py")), *sorted((_FOLDER / "examples").glob("*.*"))]
# Of what counts as the global minimum.
_ERRORS, _PART = 5.0, 1e-3


def is_global(example: Example, search: ConstantSearch) -> bool:
    """Return whether the values are the true ones except for noise."""
    errors = dict(zip(search.fit.names, np.asarray(search.fit.standard_error), strict=True))
    bounds = {c.name: c.bounds for c in example.system.nonlinear if c.bounds is not None}
    return all(
        abs(value - example.truth[name])
        <= _ERRORS * errors.get(name, 0.0) + _PART * (bounds[name][1] - bounds[name][0])
        for name, value in search.values.items()
    )


def row_of(
    example: Example, seed: int, recording: SystemRecording, starts: int, candidates: int
) -> dict[str, Any]:
    """A whole search on a recording."""
    patterns = system_patterns(example.system, recording, example.settings.preparation)
    search = search_constants(
        example.system,
        patterns,
        example.settings.solver,
        starts=starts,
        candidates=candidates,
        seed=seed,
    )
    errors = dict(
        zip(search.fit.names, np.asarray(search.fit.standard_error).tolist(), strict=True)
    )
    return {
        "example": example.name,
        "seed": seed,
        "starts": starts,
        "global": is_global(example, search),
        "ended_in_best": search.minima[0].starts,
        "values": dict(search.values),
        "errors": {name: errors.get(name) for name in search.names},
        "minima": [
            {"values": minimum.values.tolist(), "ratio": minimum.ratio, "starts": minimum.starts}
            for minimum in search.minima
        ],
    }


def compute(options: argparse.Namespace, rows: Rows) -> None:
    """Adds the rows that are missing: the first search has as many starts as are judged."""
    for name in options.examples:
        example = EXAMPLES[name]
        missing = [s for s in range(options.searches) if (name, s) not in rows]
        if not missing:
            continue
        recordings = example.recordings(missing, motions=options.motions)
        pairs = zip(missing, recordings, strict=True)
        for seed, recording in command.progress(
            pairs, desc=name, unit="recording", total=len(missing)
        ):
            starts = options.starts if seed == 0 else options.starts_of_search
            rows.add(row_of(example, seed, recording, starts, options.candidates))


def summary(rows: Sequence[dict[str, Any]]) -> list[str]:
    """The line of one example."""
    first, example = rows[0], EXAMPLES[rows[0]["example"]]
    met = sum(row["global"] for row in rows)
    values = ", ".join(
        f"{name} = {value:.5g} ± {first['errors'][name]:.2g} ({example.truth[name]:g})"
        for name, value in first["values"].items()
        if first["errors"][name] is not None
    )
    others = first["minima"][1:]
    return [
        example.name,
        values,
        f"{first['ended_in_best']} of {first['starts']}",
        f"{met} of {len(rows)}",
        f"{len(others)}" + (f", {others[0]['ratio']:.3g} times" if others else ""),
    ]


def study(options: argparse.Namespace) -> int:
    """Searches, prints the table and writes the file."""
    names = ("motions", "starts", "starts_of_search", "candidates")
    digest = made_of({name: getattr(options, name) for name in names}, CODE)
    rows = Rows(options.output / "rows.jsonl", ("example", "seed"), digest)
    compute(options, rows)
    by_example = [
        [rows[name, seed] for seed in range(options.searches)] for name in options.examples
    ]
    header = ["searched", "first search (truth)", "starts", "searches", "other minima"]
    lines = [summary(group) for group in by_example]
    print(text_table(header, lines, left=tuple(header[:2])))
    store(
        options, "systems_search", f"{options.searches} recordings", {"constants": [header, *lines]}
    )
    with all_or_nothing(options.output) as folder:
        write_csv(
            folder / "minima.csv",
            [
                {
                    "example": group[0]["example"],
                    "constants": " ".join(f"{value:.6g}" for value in minimum["values"]),
                    "error / smallest": minimum["ratio"],
                    "starts": minimum["starts"],
                }
                for group in by_example
                for minimum in group[0]["minima"]
            ],
        )
    print(f"\nwrote minima.csv into {options.output}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "systems_search")
    parser.add_argument("--searches", type=int, default=20, help="of each system")
    parser.add_argument("--motions", type=int, default=5, help="different ones of each system")
    parser.add_argument("--starts", type=int, default=100, help="of the first search")
    parser.add_argument("--starts-of-search", type=int, default=16, help="of the other searches")
    parser.add_argument("--candidates", type=int, default=512, help="points that are evaluated")
    parser.add_argument("--examples", nargs="+", default=list(EXAMPLES), metavar="NAME")
    command.add_store(parser)
    options = command.parse(parser, argv, searches=1, motions=1, starts=4, candidates=64)
    command.require_least(
        parser, options, searches=1, motions=1, starts=1, starts_of_search=1, candidates=1
    )
    command.require_some_of(parser, "example", options.examples, tuple(EXAMPLES))
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=_SECONDS * options.searches * len(options.examples),
    )


if __name__ == "__main__":
    raise SystemExit(main())
