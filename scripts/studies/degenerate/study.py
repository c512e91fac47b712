"""Recordings that determine little: the torques that fits of them predict for other motion.

Ten arms, whose links are some 20 % and 2 cm off those of their files. Each is recorded in ways that
leave coefficients open: joints that stand still, in the only recording or in one of two; one
recording of two at a wrong rate; 30 samples; rows that are held for ten samples; a joint that is
driven onto its stop. Default settings identify it.

Printed for each kind: over arms and seeds, the largest torque that is predicted for a motion of
all joints, over the largest that the file's links with the true friction predict; of the joint that
is worst; over the true torque, where that is larger. The truth itself has a ratio of at most one.

Finished rows are kept in `rows.jsonl`; an interrupted run goes on from there.
"""

import argparse
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib.metadata import files
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc.manipulator import LinkParameters
from jaxcslc.report import all_or_nothing, write_csv
from scripts.studies import command
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store
from scripts.studies.tables import cells_of, median_text, rows_table


jc.enable_x64()

_RATE, _DURATION = 200.0, 10.0  # Hz, s
_ENCODER = 1e-5  # rad, or m: a step
_NOISE = 0.01  # of each joint's torque, as a part of its RMS
_MASSES, _CENTRES = 0.2, 0.02  # how far links are from the file's: a part of the mass, and m
_FASTER = 1.3  # the motion that is predicted, over the one that is fitted

_FILES = {
    "UR3": "ur3_robot.urdf",
    "UR5": "ur5_robot.urdf",
    "xArm7": "xarm7.urdf",
    "Z1": "z1.urdf",
    "Kinova": "kinova_description/robots/kinova.urdf",
    "SO-101": "so101.urdf",
    "two joints": "TwoDofs.urdf",
    "finger": "finger_edu.urdf",
}
ARMS = ("PUMA 560", "Panda", *_FILES)
"""The file of each is in the package `example-robot-data`, save for the first."""


@cache
def robot_of(arm: str) -> jc.Manipulator:
    """The arm as its file has it, with viscous and dry friction."""
    if arm == "PUMA 560":
        return jc.puma560().with_friction("viscous", "dry")
    name = _FILES.get(arm, "panda_collision.urdf")
    (path,) = (
        path.locate()
        for path in files("example-robot-data") or ()
        if str(path).endswith(f"/{name}")
    )
    fingers = arm == "Panda"
    robot = jc.load_robot(str(path), fix=["panda_finger*"] if fingers else ())
    return robot.with_friction("viscous", "dry")


@dataclasses.dataclass(frozen=True)
class Specimen:
    """An arm whose links differ from its file's.

    - `network`: of the file, with viscous and dry friction.
    - `truth`, `file`: (p,) coefficients of the specimen's links and of the file's, with the same
      friction.
    """

    network: jc.CSLC
    truth: Float[np.ndarray, " coefficients"]
    file: Float[np.ndarray, " coefficients"]


def specimen(arm: str, seed: int) -> Specimen:
    """An arm by a seed: masses, centres of gravity and friction."""
    rng = np.random.default_rng(seed)
    network = derived(arm)
    links = network.robot.links
    assert links is not None
    other = [
        LinkParameters(
            float(link.mass) * factor,
            np.asarray(link.centre_of_gravity) + _CENTRES * rng.standard_normal(3),
            np.asarray(link.inertia) * factor,
            float(link.motor_inertia),
        )
        for link, factor in zip(
            links, np.exp(_MASSES * rng.standard_normal(len(links))), strict=True
        )
    ]
    n = network.joint_count
    # Friction as a part of the torque that gravity needs with the arm stretched out.
    scale = np.max(np.abs(_torque(network, network.coefficients_from(links), *_motion(n, rng))), 0)
    friction = {
        "viscous": 0.1 * scale * rng.uniform(0.5, 2.0, n),
        "dry": 0.1 * scale * rng.uniform(0.5, 2.0, n),
    }
    return Specimen(
        network,
        *(np.asarray(network.coefficients_from(some, **friction)) for some in (other, links)),
    )


@cache
def derived(arm: str) -> jc.CSLC:
    """The network of an arm."""
    return jc.derive(robot_of(arm), lengths="numeric")


Motion = tuple[Float[np.ndarray, "samples joints"], ...]


def _motion(n: int, rng: np.random.Generator, speed: float = 1.0) -> Motion:
    """Positions, velocities and accelerations: three sines a joint."""
    time = np.arange(int(_RATE * _DURATION))[:, None] / _RATE
    q, qd, qdd = np.zeros((3, len(time), n))
    q += rng.uniform(-0.5, 0.5, n)
    for frequency in (1.0, 2.3, 3.7):
        rate, amplitude = speed * frequency * rng.uniform(0.8, 1.2, n), rng.uniform(0.1, 0.3, n)
        angle = rate * time + rng.uniform(0.0, 2 * np.pi, n)
        q += amplitude * np.sin(angle)
        qd += amplitude * rate * np.cos(angle)
        qdd -= amplitude * rate**2 * np.sin(angle)
    return q, qd, qdd


def _torque(network: jc.CSLC, k: Any, *motion: np.ndarray) -> np.ndarray:
    return np.asarray(network.torque(np.asarray(k), *motion))


def _recording(
    some: Specimen, motion: Motion, rng: np.random.Generator, further: Any = 0.0
) -> jc.Recording:
    """A recording of a motion: encoder steps, and noise of the torque."""
    torque = _torque(some.network, some.truth, *motion) + further
    torque += _NOISE * np.std(torque, axis=0) * rng.standard_normal(torque.shape)
    time = np.arange(len(torque)) / _RATE
    return jc.Recording(time, _ENCODER * np.round(motion[0] / _ENCODER), torque)


def _usual(some: Specimen, rng: np.random.Generator) -> list[jc.Recording]:
    return [_recording(some, _motion(some.network.joint_count, rng), rng)]


def _still(some: Specimen, rng: np.random.Generator) -> list[jc.Recording]:
    """Half of the joints do not move."""
    return [_recording(some, _with_still(_motion(some.network.joint_count, rng)), rng)]


def _with_still(motion: Motion) -> Motion:
    q, qd, qdd = motion
    moves = np.arange(q.shape[1]) % 2 == 0
    return np.where(moves, q, q[:1]), np.where(moves, qd, 0.0), np.where(moves, qdd, 0.0)


def _still_in_one(some: Specimen, rng: np.random.Generator) -> list[jc.Recording]:
    """Half of the joints do not move in one of two, and have no torque there."""
    second = _recording(some, _with_still(_motion(some.network.joint_count, rng)), rng)
    torque = np.where(np.std(second.position, axis=0) > 0.0, second.torque, 0.0)
    return [*_usual(some, rng), dataclasses.replace(second, torque=torque)]


def _wrong_rate(some: Specimen, rng: np.random.Generator) -> list[jc.Recording]:
    """Time of one of two runs at half its speed."""
    first, second = (*_usual(some, rng), *_usual(some, rng))
    return [first, dataclasses.replace(second, time=2.0 * second.time)]


def _short(some: Specimen, rng: np.random.Generator) -> list[jc.Recording]:
    """30 samples."""
    return [_usual(some, rng)[0].rows(slice(500, 530))]


def _half_a_second(some: Specimen, rng: np.random.Generator) -> list[jc.Recording]:
    """Half a second."""
    return [_usual(some, rng)[0].rows(slice(500, 600))]


def _held(some: Specimen, rng: np.random.Generator) -> list[jc.Recording]:
    """Each row ten times."""
    (usual,) = _usual(some, rng)
    rows = np.arange(usual.samples) // 10 * 10
    return [jc.Recording(usual.time, usual.position[rows], usual.torque[rows])]


def _repeated(some: Specimen, rng: np.random.Generator) -> list[jc.Recording]:
    """The same second again and again."""
    (usual,) = _usual(some, rng)
    rows = np.arange(usual.samples) % 200
    return [jc.Recording(usual.time, usual.position[rows], usual.torque[rows])]


def _on_stop(some: Specimen, rng: np.random.Generator) -> list[jc.Recording]:
    """The second joint, or the first of few, is on its stop for most of the time."""
    motion = _motion(some.network.joint_count, rng)
    joint = min(1, some.network.joint_count - 2)
    stop = float(np.quantile(motion[0][:, joint], 0.3))
    on = motion[0][:, joint] > stop
    q, qd, qdd = (np.array(values) for values in motion)
    depth = q[on, joint] - stop
    q[on, joint], qd[on, joint], qdd[on, joint] = stop, 0.0, 0.0
    further = np.zeros(q.shape)
    further[on, joint] = (
        10.0 * depth * np.std(_torque(some.network, some.truth, q, qd, qdd), 0)[joint]
    )
    return [_recording(some, (q, qd, qdd), rng, further)]


KINDS: Mapping[str, Callable[[Specimen, np.random.Generator], list[jc.Recording]]] = {
    "all joints move": _usual,
    "joints still": _still,
    "joints still in one of two": _still_in_one,
    "one rate wrong": _wrong_rate,
    "30 samples": _short,
    "half a second": _half_a_second,
    "rows held": _held,
    "one second repeated": _repeated,
    "joint on its stop": _on_stop,
}
"""Recordings of a specimen, by what is wrong with them."""


def largest_torque(arm: str, kind: str, seed: int) -> dict[str, Any]:
    """The largest torques for other motion, over those of the file's links, of the worst joint."""
    some, rng = specimen(arm, seed), np.random.default_rng([seed, 1])
    recordings = KINDS[kind](some, rng)
    motion = _motion(some.network.joint_count, rng, _FASTER)
    try:
        report = jc.identify(some.network, recordings, checks=False, systematic=False)
    except (ValueError, RuntimeError) as error:
        return {"ratio": None, "error": str(error)[:200]}
    fitted = _torque(report.network, report.k, *motion)
    truth, file = (_torque(some.network, k, *motion) for k in (some.truth, some.file))
    size = np.maximum(*(np.max(np.abs(torque), axis=0) for torque in (truth, file)))
    return {
        "ratio": float(np.max(np.max(np.abs(fitted), axis=0) / size)),
        "fit": float(np.max(np.std(fitted - truth, axis=0) / np.std(truth, axis=0))),
        "file": float(np.max(np.std(file - truth, axis=0) / np.std(truth, axis=0))),
        "error": "",
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the study. **Returns** the exit status."""
    parser = command.new_parser(__doc__, "degenerate")
    parser.add_argument("--arms", nargs="+", default=list(ARMS), help="some of them")
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), help="some of them")
    command.add_seeds(parser, 3)
    command.add_store(parser)
    options = command.parse(parser, arguments, arms=["two joints", "finger"], seeds=1)
    command.require_least(parser, options, seeds=1)
    command.require_some_of(parser, "arm", options.arms, ARMS)
    command.require_some_of(parser, "kind", options.kinds, tuple(KINDS))
    folder: Path = options.output
    rows = Rows(folder / "rows.jsonl", ("arm", "kind", "seed"), made_of({}, [Path(__file__)]))
    jobs = [
        (arm, kind, seed)
        for arm in options.arms
        for kind in options.kinds
        for seed in command.seeds_of(options)
    ]
    missing = [job for job in jobs if job not in rows]
    return command.run(
        parser,
        lambda: _study(rows, jobs, missing, options),
        rows.path,
        seconds=3.0 * len(missing) + 20.0,
    )


def _study(
    rows: Rows, jobs: list[tuple[str, str, int]], missing: Any, options: argparse.Namespace
) -> int:
    for arm, kind, seed in command.progress(missing, desc="recordings"):
        rows.add({"arm": arm, "kind": kind, "seed": seed, **largest_torque(arm, kind, seed)})
    table = [_line(kind, [rows[job] for job in jobs if job[1] == kind]) for kind in options.kinds]
    print("largest torque for other motion over that of the file\n" + rows_table(table))
    store(options, "degenerate", f"{options.seeds} seeds of each arm", {"largest": cells_of(table)})
    with all_or_nothing(options.output) as written:
        write_csv(written / "degenerate.csv", table)
    return 0


def _line(kind: str, some: list[dict[str, Any]]) -> dict[str, Any]:
    fitted = [row for row in some if row["ratio"] is not None]
    worst = max(fitted, key=lambda row: row["ratio"], default=None)
    return {
        "recording": kind,
        "largest ratio": np.nan if worst is None else worst["ratio"],
        "of": "" if worst is None else worst["arm"],
        "ratio": median_text([row["ratio"] for row in fitted]),
        "error of the fit": median_text([row["fit"] for row in fitted]),
        "error of the file": median_text([row["file"] for row in fitted]),
        "refused": f"{len(some) - len(fitted)} of {len(some)}",
    }


if __name__ == "__main__":
    raise SystemExit(main())
