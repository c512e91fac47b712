"""How often `jaxcslc check` names the right cause of a spoilt recording, and how often it errs.

Twelve kinds of spoilt recording, each with several seeds, on three arms: a PUMA 560 of the
simulator, a geared 7-joint arm and a 6-joint one whose torques Pinocchio computes. Masses, centres
and friction differ from those of the robot's file. Clean recordings differ in noise, friction,
encoders, speed, duration and rate. And the lag of late torques: its error and how often its
interval holds the truth.
"""

import argparse
import dataclasses
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import jaxcslc as jc
from jaxcslc.checks import estimate_torque_lag
from jaxcslc.report import all_or_nothing, write_csv
from scripts.studies import command
from scripts.studies.checks.arms import ARMS, network
from scripts.studies.checks.recordings import Conditions, record
from scripts.studies.checks.spoilt import SPOILT, lagging
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store
from scripts.studies.tables import cells_of, rows_table


jc.enable_x64()

_CLEAN, _LAG = "clean", "lag estimate"
# Torques of the PUMA 560 are demands that a drive holds until the next sample: in the mean they act
# half an interval after their row, and count as early by that.
_HOLD = {"PUMA 560": 0.5}


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the study. **Returns** the exit status."""
    parser = command.new_parser(__doc__, "checks")
    parser.add_argument("--arms", nargs="+", default=list(ARMS), help="some of them")
    parser.add_argument("--kinds", nargs="+", default=list(SPOILT), help="some of them")
    parser.add_argument("--seeds", type=int, default=3, help="of each kind on each arm")
    parser.add_argument("--clean", type=int, default=21, help="clean recordings")
    parser.add_argument("--lags", type=int, default=30, help="recordings with late torques")
    command.add_store(parser)
    options = command.parse(
        parser, arguments, arms=["six"], kinds=["units", "gap", "spikes"], seeds=1, clean=1, lags=1
    )
    command.require_least(parser, options, seeds=1, clean=0, lags=0)
    command.require_some_of(parser, "arm", options.arms, ARMS)
    command.require_some_of(parser, "kind", options.kinds, tuple(SPOILT))
    folder: Path = options.output
    code = [Path(__file__).with_name(name) for name in ("arms.py", "spoilt.py", "study.py")]
    rows = Rows(folder / "rows.jsonl", ("arm", "kind", "seed"), made_of({}, code))
    jobs = list(_jobs(options))
    missing = [job for job in jobs if job not in rows]
    return command.run(
        parser,
        lambda: _study(rows, jobs, missing, options),
        rows.path,
        seconds=6.0 * len(missing) + 20.0,
    )


Job = tuple[str, str, int]


def _jobs(options: argparse.Namespace) -> Iterator[Job]:
    for arm in options.arms:
        for kind in options.kinds:
            for seed in range(options.seeds):
                yield arm, kind, seed
    for number in range(options.clean):
        yield options.arms[number % len(options.arms)], _CLEAN, number
    for number in range(options.lags):
        yield options.arms[number % len(options.arms)], _LAG, number


def _study(rows: Rows, jobs: list[Job], missing: list[Job], options: argparse.Namespace) -> int:
    folder: Path = options.output
    for arm, kind, seed in command.progress(missing, desc="recordings"):
        judge: Callable[[str, int], dict[str, Any]] = {_CLEAN: _clean, _LAG: _lag}.get(
            kind, lambda arm, seed, kind=kind: _spoilt(arm, kind, seed)
        )
        rows.add({"arm": arm, "kind": kind, "seed": seed, **judge(arm, seed)})
    results = [rows[job] for job in jobs]
    text = "\n\n".join(_tables(results))
    print(text)
    with all_or_nothing(folder) as written:
        (written / "tables.txt").write_text(text + "\n", encoding="utf-8")
        write_csv(written / "findings.csv", [row for row in results if "first" in row])
    sample = f"{options.seeds} recordings of each kind and arm"
    if table := _cause_rows(results):
        causes = cells_of(table[:-1], ["spoilt", "first"])
        store(options, "checks", sample, {"causes": [["spoilt", "named first"], *causes[1:]]})
    return 0


def _spoilt(arm: str, kind: str, seed: int) -> dict[str, Any]:
    number = list(SPOILT).index(kind)
    rng = np.random.default_rng([seed, number])
    # One recording of each arm and seed, whatever spoils it.
    clean = _recording(arm, Conditions(), 100 + seed)
    spoilt = SPOILT[kind](arm, clean, rng)
    findings = jc.check(network(arm), spoilt.recordings).findings
    first = findings[0] if findings else None
    names = network(arm).robot.joint_names
    expected = {names[joint - 1] for joint in spoilt.joints}
    right = first is not None and first.kind in spoilt.kinds
    return {
        "expected": spoilt.kinds[0],
        "first": "" if first is None else first.kind,
        "right": right,
        "right_joint": right and expected <= set((first.joint if first else "").split(", ")),
        "findings": len(findings),
        "text": "" if first is None else str(first),
    }


def _clean(arm: str, seed: int) -> dict[str, Any]:
    findings = jc.check(network(arm), _recording(arm, _conditions(seed), 200 + seed)).findings
    return {
        "expected": "",
        "first": findings[0].kind if findings else "",
        "right": not findings,
        "right_joint": not findings,
        "findings": len(findings),
        "text": str(findings[0]) if findings else "",
    }


def _lag(arm: str, seed: int) -> dict[str, Any]:
    rng = np.random.default_rng([seed, 99])
    clean = _recording(arm, dataclasses.replace(_conditions(seed), duration=20.0), 200 + seed)
    lag = float(rng.uniform(-0.03, 0.03))
    interval = float(np.median(np.diff(clean.time)))
    truth = lag - _HOLD.get(arm, 0.0) * 0.002
    estimate = estimate_torque_lag(network(arm), lagging(clean, lag))
    return {
        "truth": truth,
        "estimate": estimate.lag,
        "low": estimate.low,
        "high": estimate.high,
        "interval": interval,
    }


def _conditions(seed: int) -> Conditions:
    """Noise, friction, encoders, speed, duration and rate of a clean recording."""
    rng = np.random.default_rng([seed, 7])
    return Conditions(
        duration=float(rng.uniform(12.0, 30.0)),
        rate=float(rng.choice([250.0, 500.0])),
        noise=float(rng.choice([0.002, 0.01, 0.05])),
        counts=float(2.0 ** rng.integers(16, 20)),
        friction=float(rng.uniform(0.6, 1.2)),
        stribeck=float(rng.uniform(0.0, 0.2)),
        speed=float(rng.uniform(0.4, 0.7)),
        velocity=bool(rng.random() < 0.3),
    )


_kept: dict[tuple[str, Conditions, int], jc.Recording] = {}


def _recording(arm: str, conditions: Conditions, seed: int) -> jc.Recording:
    key = (arm, conditions, seed)
    if key not in _kept:
        _kept[key] = record(arm, conditions, seed)
    return _kept[key]


def _cause_rows(results: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row for each kind of spoilt recording, and one for all."""
    kinds = dict.fromkeys(row["kind"] for row in results if row["kind"] not in (_CLEAN, _LAG))
    rows: list[dict[str, Any]] = []
    for kind in kinds:
        some = [row for row in results if row["kind"] == kind]
        wrong = sorted({row["first"] or "nothing" for row in some if not row["right"]})
        rows.append({"spoilt": kind, **_counts(some), "named in place of it": ", ".join(wrong)})
    if rows:
        spoilt = [row for row in results if row["kind"] in kinds]
        rows.append({"spoilt": "all", **_counts(spoilt), "named in place of it": ""})
    return rows


def _tables(results: list[dict[str, Any]]) -> Iterator[str]:
    if rows := _cause_rows(results):
        yield "the right cause is named first\n" + rows_table(rows)
    clean = [row for row in results if row["kind"] == _CLEAN]
    if clean:
        alarms = [row["text"] for row in clean if not row["right"]]
        yield "\n".join([f"false alarms on {len(clean)} clean recordings: {len(alarms)}", *alarms])
    lags = [row for row in results if row["kind"] == _LAG]
    if lags:
        yield "lag of late torques\n" + rows_table(list(_lag_rows(lags)), digits=3)


def _counts(rows: list[dict[str, Any]]) -> dict[str, str]:
    cells = {"first": _part(rows, "right"), "with the joint": _part(rows, "right_joint")}
    for arm in ARMS:
        some = [row for row in rows if row["arm"] == arm]
        if some:
            cells[arm] = _part(some, "right")
    return cells


def _part(rows: list[dict[str, Any]], name: str) -> str:
    return f"{sum(row[name] for row in rows)} of {len(rows)}"


def _lag_rows(rows: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    for arm in (*ARMS, "all"):
        some = [row for row in rows if arm in (row["arm"], "all")]
        if not some:
            continue
        errors = np.array([(row["estimate"] - row["truth"]) / row["interval"] for row in some])
        yield {
            "arm": arm,
            "recordings": len(some),
            "median error [samples]": float(np.median(np.abs(errors))),
            "90 % below [samples]": float(np.quantile(np.abs(errors), 0.9)),
            "interval holds the truth": f"{sum(_held(row) for row in some)} of {len(some)}",
        }


def _held(row: dict[str, Any]) -> bool:
    return row["low"] <= row["truth"] <= row["high"]


if __name__ == "__main__":
    raise SystemExit(main())
