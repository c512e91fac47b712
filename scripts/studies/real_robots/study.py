"""Real arms: torque errors on motion that was not fitted, by ways of this library and of others.

Every recording is divided once and for all (`arms.py`), and nothing is chosen on the motion that is
judged. Methods:

- **usual pipeline**: 20 Hz Butterworth of order 4, zero phase, on positions and torques, central
  differences, ordinary or weighted least squares, without and with torque offsets. Where the
  robot's file has masses, also with a ridge towards them.
- **identify**: the command as typed, `jaxcslc identify ROBOT RECORDING`, in a process of its own.
- **identify, ...**: the same with `--estimator maximum-likelihood`, `--friction auto` or
  `--quality best`.

The error is 100 |e| / |torque| of each joint, of the raw torque, over all samples and over those
that the settings' masks leave in. All are judged on the same motion, smoothed as `jaxcslc identify`
chose on the training recording, with friction at rest as `predicted_torque` has it; the usual
pipeline also on its own motion, and with friction by the sign of velocity, and the best counts.

Rows of finished arms are kept in `rows.jsonl`; an interrupted run goes on from there.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

import jaxcslc as jc
from jaxcslc._text_table import text_table
from jaxcslc.friction import along_motion
from jaxcslc.recordings import Patterns, Recording
from jaxcslc.report import predicted_torque, write_csv
from scripts.studies import command
from scripts.studies.real_robots import by_arm
from scripts.studies.real_robots.arms import Arm, read
from scripts.studies.real_robots.methods import FAMILIES, PIPELINE, Model, evenly
from scripts.studies.real_robots.tables import tables
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store


jc.enable_x64()

# Seconds on two cores, all methods.
SECONDS = {
    "KUKA KR300": 100.0,
    "KUKA LWR4+": 250.0,
    "Franka Panda": 200.0,
    "Stäubli TX40": 200.0,
}


def torque_of(
    model: Model, patterns: Patterns, *, by_sign: bool = False
) -> Float[np.ndarray, "samples joints"]:
    """What a model predicts.

    - `by_sign`: friction of joints that stand still by the sign of their measured velocity too.
    """
    if by_sign:
        return np.asarray(model.network.torque(model.k, patterns.q, patterns.qd, patterns.qdd))
    network, k, states = model.network, model.k, model.states
    if states is not None:
        network, k = (
            along_motion(states.network, patterns, states.presliding_distance),
            states.fit.k,
        )
    return np.asarray(predicted_torque(network, patterns, k))


def errors_of(
    model: Model,
    settings: jc.Settings,
    recording: Recording,
    *,
    by_sign: bool = False,
    ends: float = 0.0,
) -> dict[str, list[float]]:
    """Return the errors in percent of the raw torque, joint by joint: over all samples, and over
    judged ones.

    - `ends`: omitted at either end [s].
    """
    patterns = settings.patterns(recording)
    torque, mask = np.asarray(patterns.torque), np.asarray(patterns.mask)
    error = torque - torque_of(model, patterns, by_sign=by_sign)
    first, *_, last = (time := np.asarray(patterns.time))
    inside = ((time >= first + ends) & (time <= last - ends))[:, None]
    shares = {}
    for name, counts in (("all", np.ones_like(mask) & inside), ("judged", mask & inside)):
        left, whole = (np.sum(np.where(counts, x, 0.0) ** 2, axis=0) for x in (error, torque))
        ratio = np.where(whole > 0.0, left / np.where(whole > 0.0, whole, 1.0), np.nan)
        shares[name] = (100.0 * np.sqrt(ratio)).tolist()
    return shares | {"share": (100.0 * mask[inside[:, 0]].mean(axis=0)).tolist()}


def judged(
    model: Model, common: jc.Settings, recording: Recording, ends: float = 0.0
) -> dict[str, list[float]]:
    """Errors on the common motion; of the usual pipeline as its errors are least: there or on its
    own motion, with friction at rest as ours or by the sign of velocity."""
    raw = common.with_options(torque_alignment="sample", smooth_torque=False)
    if not model.method.startswith(PIPELINE):
        return errors_of(model, raw, recording, ends=ends)
    own_motion = raw.with_options(smoothing=model.settings.preparation.smoothing)
    ways = [
        errors_of(model, settings, motion, by_sign=by_sign, ends=ends)
        for settings, motion in ((raw, recording), (own_motion, evenly(recording)))
        for by_sign in (False, True)
    ]
    return min(ways, key=lambda values: sum(values["all"]))


def rows_of(name: str, arm: Arm, families: Sequence[str]) -> list[dict[str, Any]]:
    """A row for each method and each recording that is judged."""
    models: list[Model] = []
    for family in families:
        models += FAMILIES[family](arm)
    common = next((m.settings for m in models if m.method == "identify"), jc.Settings())
    return [
        {
            "arm": name,
            "recording": test,
            "method": model.method,
            "seconds": model.seconds,
            "note": model.note,
            **judged(model, common, recording, arm.ends),
        }
        for model in models
        for test, recording in arm.tests.items()
    ]


def table_text(rows: Sequence[dict[str, Any]], kind: str) -> str:
    """Errors of an arm's methods, joint by joint."""
    joints = len(rows[0][kind])
    header = ["recording", "method", *(str(joint + 1) for joint in range(joints)), "mean"]
    cells = [
        [row["recording"], row["method"]]
        + [f"{value:.1f}" for value in (*row[kind], float(np.mean(row[kind])))]
        for row in rows
    ]
    return text_table(header, cells, left=header[:2])


def study(options: argparse.Namespace) -> int:
    """Makes what is missing, prints the tables and writes the rows."""
    code = [
        Path(__file__),
        Path(__file__).with_name("arms.py"),
        Path(__file__).with_name("methods.py"),
    ]
    digest = made_of({"families": options.methods}, code)
    finished = Rows(options.output / "rows.jsonl", ("arm",), digest)
    for name in command.progress(options.arms, desc="arms", unit="arm"):
        if (name,) not in finished:
            arm = read(name, options.data)
            rows = rows_of(name, arm, options.methods)
            finished.add({"arm": name, "source": arm.source, "split": arm.split, "rows": rows})
            tqdm.write(f"{name}: {len(rows)} rows", sys.stderr)
    results = [finished[(name,)] for name in options.arms]
    for result in results:
        print(f"{result['arm']}: {result['split']}; error [%] over all samples, then judged ones")
        for kind in ("all", "judged"):
            print(table_text(result["rows"], kind), end="\n\n")
    flat = [row for result in results for row in result["rows"]]
    write_csv(
        options.output / "errors.csv",
        [
            {name: row[name] for name in ("arm", "recording", "method", "seconds", "note")}
            | {"joint": joint, "all": row["all"][joint - 1], "judged": row["judged"][joint - 1]}
            | {"share": row["share"][joint - 1]}
            for row in flat
            for joint in range(1, len(row["all"]) + 1)
        ],
    )
    print(f"wrote {options.output / 'errors.csv'}")
    store(options, "real_robots", "one recording of each motion", tables(results))
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = by_arm.new_parser(__doc__, "real_robots")
    parser.add_argument("--methods", nargs="+", default=list(FAMILIES), help=", ".join(FAMILIES))
    options = by_arm.parse(parser, argv, arms=["KUKA KR300"], methods=["usual"])
    command.require_some_of(parser, "family of methods", options.methods, tuple(FAMILIES))
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=sum(
            SECONDS[name] if {*options.methods} - {"usual"} else 20.0 for name in options.arms
        ),
    )


if __name__ == "__main__":
    raise SystemExit(main())
