"""Study of what `jaxcslc check` says of 44 kinds of wrong recordings and files.

Each kind comes in three sizes, from mild to gross, on six arms whose files are those of
manufacturers or of example-robot-data, and whose torques Pinocchio computes. A recording is *named*
(its cause is the first finding), *named wrongly*, *silent and wrong* (nothing is said, and more
coefficients called well determined are outside of their 95 % intervals than chance explains) or
*silent and harmless*. What is *well determined up to scale* may be off by one factor, within what
the report states. Clean recordings give the false alarms.
"""

import argparse
import multiprocessing
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np
import scipy

import jaxcslc as jc
from jaxcslc.checks import Finding
from jaxcslc.report import WELL_DETERMINED, all_or_nothing, write_csv
from jaxcslc.uncertainty import SHOWN_SCALE, uncertainty_interval
from scripts.studies import command
from scripts.studies.checks.robots import ARMS, Conditions, arm, record
from scripts.studies.checks.spoilers import SIZES, SPOILERS, Spoilt, spoilt
from scripts.studies.rows import Rows, made_of
from scripts.studies.tables import rows_table


jc.enable_x64()

_CLEAN = "clean"
# Seeds of clean recordings, which spoilt ones do not share.
_FIRST_CLEAN = 1000
# Chance that a right fit has as many coefficients outside of their intervals as a wrong one.
_CHANCE = 0.01
_LEVEL = 0.95
Job = tuple[str, str, int, int]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the study. **Returns** the exit status."""
    parser = command.new_parser(__doc__, "spoiler")
    parser.add_argument("--arms", nargs="+", default=list(ARMS), help="some of them")
    parser.add_argument("--kinds", nargs="+", default=list(SPOILERS), help="some of them")
    parser.add_argument("--sizes", nargs="+", default=list(SIZES), help="some of them")
    parser.add_argument("--seeds", type=int, default=1, help="of each kind and size on each arm")
    parser.add_argument("--clean", type=int, default=20, help="clean recordings of each arm")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    options = command.parse(parser, arguments, arms=["UR5", "Panda"], sizes=["middle"], clean=4)
    command.require_least(parser, options, seeds=1, clean=0, jobs=1)
    command.require_some_of(parser, "arm", options.arms, ARMS)
    command.require_some_of(parser, "kind", options.kinds, tuple(SPOILERS))
    command.require_some_of(parser, "size", options.sizes, SIZES)
    folder: Path = options.output
    code = [Path(__file__).with_name(f"{name}.py") for name in ("robots", "spoilers", "spoiler")]
    keys = ("arm", "kind", "size", "seed")
    rows = Rows(folder / "rows.jsonl", keys, made_of({}, code))
    jobs = list(_jobs(options))
    missing = [job for job in jobs if job not in rows]
    return command.run(
        parser,
        lambda: _study(rows, jobs, missing, folder, options.jobs),
        rows.path,
        seconds=4.0 * len(missing) / max(min(options.jobs, 2), 1) + 5.0,
    )


def _jobs(options: argparse.Namespace) -> Iterator[Job]:
    for name in options.arms:
        for kind in options.kinds:
            for size in options.sizes:
                for seed in range(options.seeds):
                    yield name, kind, SIZES.index(size), seed
        for seed in range(options.clean):
            yield name, _CLEAN, 0, _FIRST_CLEAN + seed


def _study(rows: Rows, jobs: list[Job], missing: list[Job], folder: Path, processes: int) -> int:
    for row in command.progress(_computed(missing, processes), desc="runs", total=len(missing)):
        rows.add(row)
    results = [rows[job] for job in jobs]
    text = "\n\n".join(_tables(results))
    print(text)
    with all_or_nothing(folder) as written:
        (written / "tables.txt").write_text(text + "\n", encoding="utf-8")
        write_csv(written / "runs.csv", results)
    return 0


def _computed(jobs: Sequence[Job], processes: int) -> Iterable[dict[str, Any]]:
    if processes == 1:
        yield from map(judged, jobs)
        return
    # Threads of XLA do not survive a fork.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=context) as pool:
        for future in as_completed([pool.submit(judged, job) for job in jobs]):
            yield future.result()


def judged(job: Job) -> dict[str, Any]:
    """Return what the check says of a recording, and what a fit to it is worth."""
    name, kind, size, seed = job
    if kind == _CLEAN:
        case = Spoilt((record(name, clean_conditions(seed), seed).recording,), ())
    else:
        case = spoilt(name, kind, size, seed)
    network = arm(case.file or name).network
    report = _identified(network, case)
    # A report has the findings of the check, which takes half of the time.
    page = None if report is None else report.data_check
    findings = (jc.check(network, case.recordings) if page is None else page).findings
    first = findings[0] if findings else None
    friction = clean_conditions(seed).friction if kind == _CLEAN else 1.0
    # What is worth knowing of a fit is whether it is wrong and nothing was said.
    truth = arm(name, seed).coefficients(friction)
    well, outside, printed = _confident(network, report, truth) if first is None else (0, 0, 0)
    right = first is not None and _is_right(first, case, network)
    wrong = outside > scipy.stats.binom.ppf(1.0 - _CHANCE, well, 1.0 - _LEVEL)
    silent = "silent and wrong" if wrong else "silent and harmless"
    return {
        **{"arm": name, "kind": kind, "size": size, "seed": seed},
        "result": silent if first is None else "named" if right else "named wrongly",
        "verdict": "refused" if report is None else report.page(charts=False).tone,
        "why": "" if report is None else report.verdict,
        "well_determined": well,
        "outside": outside,
        "outside_as_printed": printed,
        "first": "" if first is None else first.kind,
        "joint": "" if first is None else first.joint,
        "text": " | ".join(map(str, findings)),
    }


def _is_right(found: Finding, case: Spoilt, network: jc.CSLC) -> bool:
    names = [network.output_names[joint] for joint in case.joints]
    return found.kind in case.kinds and set(names) <= set(found.joint.split(", "))


def _identified(network: jc.CSLC, case: Spoilt) -> jc.Report | None:
    """Return the report of a recording; None if one line says why there is none."""
    try:
        return jc.identify(network, case.recordings[0], possible="never")
    except ValueError:
        return None


def _confident(
    network: jc.CSLC, report: jc.Report | None, truth: np.ndarray
) -> tuple[int, int, int]:
    """Return how many coefficients are well determined, how many of them are wrong, and printed so.

    - Wrong: outside of the interval by what the verdict says. *Up to scale* allows for one factor
      of all coefficients, within what the report says to be possible.
    - Printed so: outside of the interval, whatever the verdict.
    """
    if report is None or report.network.size != len(truth):
        return 0, 0, 0
    kinds = np.array([row["verdict"] for row in report.rows()])
    well, plain = np.isin(kinds, WELL_DETERMINED), kinds == WELL_DETERMINED[0]
    interval = uncertainty_interval(report.fit, report.systematic, _LEVEL)
    printed = _outside(interval, truth)
    wrong = printed
    if well.any() and not np.all(plain[well]):
        shown = report.systematic.within[SHOWN_SCALE]
        bound = np.inf if shown == "nothing" else float(shown.strip("± %")) / 100.0
        ratios = np.asarray(report.fit.k)[well] / truth[well]
        factor = float(np.clip(np.median(ratios), max(1.0 - bound, 0.0), 1.0 + bound))
        wrong = np.where(plain, printed, _outside(interval, factor * truth))
    return int(well.sum()), int(np.sum(wrong & well)), int(np.sum(printed & well))


def _outside(interval: np.ndarray, truth: np.ndarray) -> np.ndarray:
    return (truth < interval[:, 0]) | (truth > interval[:, 1])


def clean_conditions(seed: int) -> Conditions:
    """Return noise, friction, encoders, speed, duration and rate of a clean recording."""
    rng = np.random.default_rng([seed, 7])
    return Conditions(
        duration=float(rng.uniform(12.0, 40.0)),
        rate=float(rng.choice([125.0, 250.0, 500.0])),
        noise=float(rng.choice([0.002, 0.01, 0.05])),
        ticks=float(2.0 ** rng.integers(14, 20)),
        friction=float(rng.uniform(0.5, 2.0)),
        speed=float(rng.uniform(0.5, 2.0)),
    )


_VERDICTS = ("good", "caution", "bad", "refused")
_RESULTS = ("named", "named wrongly", "silent and wrong", "silent and harmless")


def _tables(results: list[dict[str, Any]]) -> Iterator[str]:
    kinds = [kind for kind in dict.fromkeys(row["kind"] for row in results) if kind != _CLEAN]
    rows: list[dict[str, Any]] = []
    for kind in [*kinds, "all"]:
        some = [row for row in results if kind == row["kind"] or (kind == "all" != row["kind"])]
        some = [row for row in some if row["kind"] != _CLEAN]
        named = [f"{_count(some, 'named', size)}" for size in sorted({x["size"] for x in some})]
        others = {row["first"] for row in some if row["result"] == "named wrongly"}
        rows.append(
            {
                "kind": kind,
                "runs": len(some),
                **{result: _count(some, result) for result in _RESULTS},
                "named by size": " ".join(named),
                "confident and wrong": _confident_text(some),
                "instead": ", ".join(sorted(others)) if kind != "all" else "",
            }
        )
    yield rows_table(rows)
    clean = [row for row in results if row["kind"] == _CLEAN]
    groups = {
        "clean": clean,
        **{
            size: [x for x in results if x["kind"] != _CLEAN and SIZES[x["size"]] == size]
            for size in SIZES
        },
    }
    yield "verdicts of jaxcslc identify\n" + rows_table(
        [
            {
                "recordings": name,
                **{verdict: sum(x["verdict"] == verdict for x in some) for verdict in _VERDICTS},
            }
            for name, some in groups.items()
            if some
        ]
    )
    if clean:
        alarms = [f"{row['arm']} {row['seed']}: {row['text']}" for row in clean if row["first"]]
        share = _confident_text(clean)
        yield "\n".join(
            [
                f"false alarms on {len(clean)} clean recordings: {len(alarms)}; confident and"
                f" wrong: {share}",
                *alarms,
            ]
        )


def _count(rows: list[dict[str, Any]], result: str, size: int | None = None) -> int:
    return sum(row["result"] == result and size in (None, row["size"]) for row in rows)


def _confident_text(rows: list[dict[str, Any]]) -> str:
    """Coefficients that are wrong by their verdict, of those called well determined without a word.

    In brackets: outside of the interval, which allows for usual errors of the torque scale only.
    """
    silent = [row for row in rows if not row["first"]]
    keys = ("outside", "outside_as_printed", "well_determined")
    outside, printed, well = (sum(row[key] for row in silent) for key in keys)
    return f"{outside} ({printed}) of {well}"


if __name__ == "__main__":
    raise SystemExit(main())
