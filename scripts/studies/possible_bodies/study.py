"""What it costs in torque that bodies be possible and a URDF hold them.

A geared 7-joint arm with motor inertias, whose torques Pinocchio computes, is identified from a
recording; masses and inertias differ from those of its URDF. The possible bodies nearest to the fit
are exported to a URDF, with motor inertias in the file beside it and without any. Pinocchio then
reads the URDF and predicts the torques of a new motion, faster than the one that was recorded.
Its errors stand beside those of the free fit, whose coefficients no body need have.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pinocchio
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc._text_table import text_table
from jaxcslc.export import export_robot, read_motor_inertias
from jaxcslc.report import all_or_nothing, write_csv
from scripts.studies import command
from scripts.studies.checks.arms import GEARED, urdf
from scripts.studies.checks.recordings import Conditions, record
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store


jc.enable_x64()

MOTIONS = {
    "wide": Conditions(duration=20.0, rate=250.0, speed=0.5),
    "slow": Conditions(duration=20.0, rate=250.0, speed=0.15),
    "short": Conditions(duration=5.0, rate=250.0, speed=0.3),
    "noisy": Conditions(duration=10.0, rate=250.0, speed=0.3, noise=0.1),
}
"""Recordings that the arm is identified from."""
_NAMES = {
    "wide": "20 s, half of the top speed",
    "slow": "20 s, slow: 15 % of it",
    "short": "5 s, 30 % of it",
    "noisy": "10 s, 30 % of it, torque noise of 10 %",
}
NEW = Conditions(duration=15.0, rate=250.0, speed=0.6, noise=0.0)
"""The motion that torques are predicted of."""
PREDICTIONS = ("free", "possible", "urdf_and_motors", "urdf_alone")
_HEADS = ("consistent bodies", "URDF and motor inertias", "URDF alone (`--no-motors`)")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the study. **Returns** the exit status."""
    parser = command.new_parser(__doc__, "possible_bodies")
    parser.add_argument("--motions", nargs="+", default=list(MOTIONS), help="some of them")
    parser.add_argument("--seeds", type=int, default=10, help="of each motion")
    command.add_store(parser)
    options = command.parse(parser, arguments, motions=["wide"], seeds=1)
    command.require_least(parser, options, seeds=1)
    command.require_some_of(parser, "motion", options.motions, tuple(MOTIONS))
    folder: Path = options.output
    rows = Rows(folder / "rows.jsonl", ("motion", "seed"), made_of({}, [Path(__file__)]))
    jobs = [(motion, seed) for motion in options.motions for seed in range(options.seeds)]
    missing = [job for job in jobs if job not in rows]
    return command.run(
        parser,
        lambda: _study(rows, jobs, missing, options),
        rows.path,
        seconds=2.0 * len(missing) + 10.0,
    )


def _study(
    rows: Rows,
    jobs: list[tuple[str, int]],
    missing: list[tuple[str, int]],
    options: argparse.Namespace,
) -> int:
    folder: Path = options.output
    with TemporaryDirectory() as scratch:
        path = Path(scratch) / "geared.urdf"
        path.write_text(urdf("geared", GEARED), encoding="utf-8")
        network = jc.derive(jc.load_robot(path), lengths="numeric")
        for motion, seed in command.progress(missing, desc="recordings"):
            rows.add({"motion": motion, "seed": seed, **judged(network, MOTIONS[motion], seed)})
    results = [rows[job] for job in jobs]
    head, *lines = _table(results)
    text = (
        "RMS torque error on a new motion over that of the unconstrained fit (geometric mean; each"
        " joint in parts of its RMS torque); used: bodies that held-out errors within the recording"
        " prefer\n" + text_table(head, lines)
    )
    print(text)
    sample = f"{options.seeds} recordings of each row"
    store(options, "possible_bodies", sample, {"files": [head, *lines]})
    with all_or_nothing(folder) as written:
        (written / "tables.txt").write_text(text + "\n", encoding="utf-8")
        write_csv(written / "errors.csv", [_flat(row) for row in results])
    return 0


def judged(network: jc.CSLC, conditions: Conditions, seed: int) -> dict[str, Any]:
    """RMS errors of torque on a new motion, by joint, of the free fit and of what was exported."""
    report = jc.identify(
        network,
        record("geared", conditions, 2 * seed + 1),
        settings=jc.Settings(),
        checks=False,
        systematic=False,
        possible="always",
        file_prior=False,
    )
    possible = report.possible
    assert possible is not None
    new = report.settings.patterns(record("geared", NEW, 2 * seed + 2))
    mask, torque = np.asarray(new.mask), np.asarray(new.torque)
    predictions = {
        name: np.asarray(network.torque(k, new.q, new.qd, new.qdd))
        for name, k in (("free", possible.free.k), ("possible", possible.parameters.k))
    }
    with TemporaryDirectory() as folder:
        for name, motors in (("urdf_and_motors", True), ("urdf_alone", False)):
            path = Path(folder) / f"{name}.urdf"
            export_robot(
                network,
                possible.free,
                path,
                motion=report.patterns["training"],
                motors=motors,
            )
            predictions[name] = torque_of_urdf(path, new)
    errors = {
        name: np.sqrt(
            np.sum(np.where(mask, torque - predicted, 0.0) ** 2, axis=0) / np.sum(mask, axis=0)
        ).tolist()
        for name, predicted in predictions.items()
    }
    size = np.sqrt(np.sum(np.where(mask, torque, 0.0) ** 2, axis=0) / np.sum(mask, axis=0))
    return {
        **errors,
        "torque": size.tolist(),
        "change": possible.change,
        "change_error": possible.change_error,
        "distance": possible.parameters.distance,
    }


def torque_of_urdf(path: Path, patterns: jc.Patterns) -> Float[np.ndarray, "samples joints"]:
    """Pinocchio's torque of a URDF and the motor inertias beside it, with the URDF's friction."""
    model = pinocchio.buildModelFromUrdf(str(path))
    motors = path.with_name(f"{path.stem}.motors.toml")
    if motors.exists():
        for name, inertia in read_motor_inertias(motors).items():
            model.armature[model.joints[model.getJointId(name)].idx_v] = inertia
    data = model.createData()
    q, qd, qdd = (np.asarray(values) for values in (patterns.q, patterns.qd, patterns.qdd))
    rigid = np.stack(
        [pinocchio.rnea(model, data, *state) for state in zip(q, qd, qdd, strict=True)]
    )
    robot = jc.load_robot(path)
    assert robot.viscous is not None and robot.dry is not None
    return rigid + np.asarray(robot.viscous) * qd + np.asarray(robot.dry) * np.sign(qd)


def _table(results: list[dict[str, Any]]) -> list[list[str]]:
    """Return a line for each motion, the head first: the error of all joints together, over that
    of the unconstrained fit.
    """
    rows = [["recording", "unconstrained fit, % of torque", *_HEADS, "worst file", "used"]]
    for motion in dict.fromkeys(row["motion"] for row in results):
        motion_rows = [row for row in results if row["motion"] == motion]
        ratios = {name: [_ratio(row, name) for row in motion_rows] for name in PREDICTIONS[1:]}
        percent = [100 * _together(row, "free") for row in motion_rows]
        cells = [f"{np.exp(np.mean(np.log(values))):.3f}" for values in ratios.values()]
        better = sum(row["change"] + 1.895 * row["change_error"] < 0 for row in motion_rows)
        rows.append(
            [
                _NAMES[motion],
                f"{np.mean(percent):.2f}",
                *cells,
                f"{max(ratios['urdf_and_motors']):.3f}",
                f"{better} of {len(motion_rows)}",
            ]
        )
    return rows


def _together(row: dict[str, Any], name: str) -> float:
    """The error of all joints, each in parts of its torque."""
    parts = np.array(row[name]) / np.array(row["torque"])
    return float(np.sqrt(np.mean(parts**2)))


def _ratio(row: dict[str, Any], name: str) -> float:
    return _together(row, name) / _together(row, "free")


def _flat(row: dict[str, Any]) -> dict[str, Any]:
    """Return lists by joint as one, with a column per joint."""
    flat: dict[str, Any] = {}
    for name, value in row.items():
        if isinstance(value, list):
            flat |= {f"{name}_{joint}": entry for joint, entry in enumerate(value, start=1)}
        else:
            flat[name] = value
    return flat


if __name__ == "__main__":
    command.keep_compiled()
    raise SystemExit(main())
