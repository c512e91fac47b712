"""How often two recordings are said to disagree, when they do and when they do not.

Two recordings of one arm by other motion and other noise are identified together, with default
settings: of the same arm; after friction has changed in all joints; with a payload in the second
one. The three arms are those of `scripts.studies.checks`. Printed: how often the test of
`jaxcslc.uncertainty.fit_recordings` found a disagreement, with standard errors alone and with
systematic errors, which is what a report says; and how often what it named first is of the kind
that changed (friction, or what a payload moves).

Finished rows are kept in `rows.jsonl`; an interrupted run goes on from there.
"""

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import jaxcslc as jc
from jaxcslc.report import all_or_nothing, write_csv
from jaxcslc.uncertainty import SeveralFit, fit_recordings
from scripts.studies import command
from scripts.studies.checks.arms import ARMS, network
from scripts.studies.checks.recordings import Conditions, record
from scripts.studies.rows import Rows, made_of
from scripts.studies.tables import rows_table


jc.enable_x64()

_FIRST = Conditions(duration=15.0, rate=250.0)
_FRICTION, _PAYLOAD = (1.05, 1.1, 1.2), (0.1, 0.25, 0.5, 1.0)
CASES = {
    "same arm": _FIRST,
    **{
        f"friction {100 * factor - 100:+.0f} %": dataclasses.replace(_FIRST, friction=factor)
        for factor in _FRICTION
    },
    **{f"payload {mass:g} kg": dataclasses.replace(_FIRST, payload=mass) for mass in _PAYLOAD},
}
"""Conditions of the second recording; those of the first never change."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the study. **Returns** the exit status."""
    parser = command.new_parser(__doc__, "agreement")
    parser.add_argument("--arms", nargs="+", default=list(ARMS), help="some of them")
    parser.add_argument("--cases", nargs="+", default=list(CASES), help="some of them")
    parser.add_argument("--same", type=int, default=50, help="pairs of the same arm")
    parser.add_argument("--seeds", type=int, default=5, help="pairs of each other case")
    options = command.parse(
        parser, arguments, arms=["six"], cases=["same arm", "payload 1 kg"], same=1, seeds=1
    )
    command.require_least(parser, options, same=1, seeds=1)
    command.require_some_of(parser, "arm", options.arms, ARMS)
    command.require_some_of(parser, "case", options.cases, tuple(CASES))
    folder: Path = options.output
    rows = Rows(folder / "rows.jsonl", ("arm", "case", "seed"), made_of({}, [Path(__file__)]))
    jobs = [
        (arm, case, seed)
        for arm in options.arms
        for case in options.cases
        for seed in range(options.same if CASES[case] == _FIRST else options.seeds)
    ]
    missing = [job for job in jobs if job not in rows]
    return command.run(
        parser,
        lambda: _study(rows, jobs, missing, options),
        rows.path,
        seconds=6.0 * len(missing) + 20.0,
    )


def compared(arm: str, case: str, seed: int) -> dict[str, Any]:
    """Return what the test says of two recordings."""
    recordings = {
        "first": record(arm, _FIRST, 300 + 2 * seed),
        "second": record(arm, CASES[case], 301 + 2 * seed),
    }
    report = jc.identify(network(arm), recordings, checks=False)
    several = report.several
    assert several is not None
    alone = fit_recordings(report.network, several.patterns, report.settings.solver)
    names = several.agreement.differing["second"]
    return {
        "standard errors": _disagree(alone),
        "with systematic errors": _disagree(several),
        "differing": list(names),
        "kind": bool(names) and _is_friction(names[0]) == ("friction" in case),
    }


def _disagree(several: SeveralFit) -> bool:
    return any(several.agreement.differing.values())


def _is_friction(name: str) -> bool:
    return name.startswith(("kv", "kd"))


def _study(
    rows: Rows, jobs: list[tuple[str, str, int]], missing: Any, options: argparse.Namespace
) -> int:
    for arm, case, seed in command.progress(missing, desc="pairs of recordings"):
        rows.add({"arm": arm, "case": case, "seed": seed, **compared(arm, case, seed)})
    table = [
        _line(case, arm, [rows[job] for job in jobs if job[1] == case and arm in ("all", job[0])])
        for case in options.cases
        for arm in ([*options.arms, "all"] if len(options.arms) > 1 else options.arms)
    ]
    print("pairs of recordings that are said to disagree\n" + rows_table(table))
    with all_or_nothing(options.output) as written:
        write_csv(written / "agreement.csv", table)
    return 0


def _line(case: str, arm: str, some: list[dict[str, Any]]) -> dict[str, Any]:
    same = CASES[case] == _FIRST
    return {
        "second recording": case,
        "arm": arm,
        **{name: _part(some, name) for name in ("standard errors", "with systematic errors")},
        "right kind first": "" if same else _part(some, "kind"),
        "coefficients named": float(np.median([len(row["differing"]) for row in some])),
    }


def _part(rows: Sequence[dict[str, Any]], name: str) -> str:
    return f"{sum(row[name] for row in rows)} of {len(rows)}"


if __name__ == "__main__":
    raise SystemExit(main())
