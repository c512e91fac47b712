"""Are servo drives found from commands and positions alone, with intervals that hold?

Arms of position servos (`arms.py`: five joints like an SO-101 or a Koch, and seven) are simulated
in MuJoCo by equations that are not those of `jaxcslc.servo`. Encoders have 12 bits and read at
50 Hz. Gears have 1 degree of play. Servos have a dead zone and a delay of 20 to 60 ms. Friction is
static, Coulomb and load-dependent. Every parameter is drawn anew for each seed and joint.

An arm records twice: once without and once with a known payload. The file's masses are 10 % too
large, which the fit does not know. The fit is judged by

- **coverage**: how many 95 % intervals hold the true value. Parameters that the fit names as
  confounded, or refuses, are counted apart;
- **error**: of the estimates, relative to the true values;
- **position**: root mean square of the error of a simulation, open loop, of a new motion (point to
  point with pauses, without payload). It is divided by the encoder's rounding, by the error of
  the same simulation with the true parameters, and by the error of MuJoCo itself with gains 0.1 %
  larger. Where no load holds a joint on a flank of its gear, links coast from flank to flank, and
  nobody can predict when: the last two are more than the rounding.

`--legs` identifies the legs of a quadruped in the air (`legs.py`) with known gains, held by a stand
and swinging on a rope. The second must be named.

`--cases` simulates ten recordings that confound parameters (`cases.py`), and checks that each is
named with a remedy.

Rows of finished seeds are kept in `rows.jsonl`; an interrupted run goes on from there.
"""

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from jaxcslc._text_table import text_table
from jaxcslc.manipulator import LinkParameters
from jaxcslc.servo import ESTIMATED, ServoFit, identify_servo
from scripts.studies import command
from scripts.studies.rows import Rows, made_of
from scripts.studies.servo import legs
from scripts.studies.servo.arms import (
    LINKS,
    PAYLOADS,
    Servos,
    new_command,
    recorded,
    robot,
    training_command,
)
from scripts.studies.servo.cases import CASES


NAMES = (*ESTIMATED, "dead_zone", "play")
JUDGED = ("gain", "damping", "delay", "offset", "armature", "coulomb")
LEG_PARAMETERS = ("armature", "coulomb", "viscous")
LEGS_DURATION = 20.0  # s
MASSES = 1.1  # of the file, over the true ones
# Of gains, over the true ones, in MuJoCo's second simulation: less than estimates are off.
NEARLY = 1.001
# An arm of five joints, 60 s without and 60 s with payload: seconds on two cores.
SECONDS = {"so101": 150.0, "koch": 150.0, "seven": 300.0}


def row_of(name: str, seed: int, duration: float) -> dict[str, Any]:
    """Record, identify and judge one arm."""
    links = LINKS[name]
    joints = len(links)
    rng = np.random.default_rng([seed, joints])
    servos = Servos.drawn(joints, rng, name)
    commands = [training_command(joints, duration, rng) for _ in range(2)]
    carried = (0.0, PAYLOADS[name])
    recordings = [recorded(links, servos, x, y) for x, y in zip(commands, carried, strict=True)]
    arm = robot(links, MASSES)
    assert arm.links is not None
    point = LinkParameters(PAYLOADS[name], arm.links[-1].centre_of_gravity, 1e-8 * np.eye(3))
    fit = identify_servo(arm, recordings, payloads=[None, point], estimated=NAMES)
    motion = new_command(joints, 0.5 * duration, rng)
    truth = recorded(links, servos, motion, tick=0.0)
    read = recorded(links, servos, motion)
    nearly = dataclasses.replace(servos, gain=NEARLY * servos.gain)
    again = recorded(links, nearly, motion, tick=0.0)
    error = fit.position_error([read])[0]
    known = dataclasses.replace(fit, robot=robot(links), drives=servos.drives())
    true = known.position_error([read])[0]
    floor, nearby = (
        1e3 * np.sqrt(np.mean((x.position - read.position) ** 2)) for x in (truth, again)
    )
    row: dict[str, Any] = {
        "arm": name,
        "seed": seed,
        "error": float(np.sqrt(np.mean(error**2))),
        "true": float(np.sqrt(np.mean(true**2))),
        "floor": float(floor),
        "again": float(nearby),
    }
    return row | judged(fit, servos)


def judged(fit: ServoFit, servos: Servos) -> dict[str, Any]:
    """Return, per parameter: how many intervals hold the truth, of how many, and errors."""
    named = {(x.joint, name) for x in fit.confounded for name in x.parameters}
    row: dict[str, Any] = {}
    for name in JUDGED:
        held: list[bool] = []
        errors: list[float] = []
        apart = 0
        for estimate in fit.parameters:
            label, _, over = estimate.name.partition("/")
            if label != name:
                continue
            if not estimate.is_determined or (estimate.joint, name) in named:
                apart += 1
                continue
            true = float(getattr(servos, name)[estimate.joint])
            true /= float(servos.gain[estimate.joint]) if over else 1.0
            held.append(estimate.low <= true <= estimate.high)
            scale = 1.0 if name in ("delay", "offset") else true
            errors.append((estimate.value - true) / scale)
        row[f"{name} held"], row[f"{name} of"] = sum(held), len(held)
        row[f"{name} apart"], row[f"{name} errors"] = apart, errors
    return row


def summary(rows: Sequence[dict[str, Any]]) -> str:
    """Return a table of coverage and errors, and one of positions."""
    lines: list[list[str]] = []
    for name in JUDGED:
        held, of = (sum(row[f"{name} {x}"] for row in rows) for x in ("held", "of"))
        apart = sum(row[f"{name} apart"] for row in rows)
        errors = np.array([x for row in rows for x in row[f"{name} errors"]] or [np.nan])
        size = float(np.sqrt(np.mean(errors**2)))
        unit = {"delay": ("ms", 1e3), "offset": ("mrad", 1e3)}.get(name, ("%", 1e2))
        share = f"{100 * held / of:.0f} %" if of else ""
        lines.append([name, f"{held}/{of}", share, f"{apart}", f"{unit[1] * size:.2g} {unit[0]}"])
    table = text_table(["parameter", "held", "coverage", "named or refused", "RMS error"], lines)
    ratios, of_true, of_again = (
        np.array([row["error"] / row[name] for row in rows]) for name in ("floor", "true", "again")
    )
    errors = np.array([row["error"] for row in rows])
    return (
        f"{table}\n\nnew motion: {np.mean(errors):.2f} mrad, {np.median(ratios):.2f} times the"
        f" encoder's rounding (median; worst {np.max(ratios):.2f}), {np.median(of_true):.2f} times"
        f" the error with the true parameters (median; worst {np.max(of_true):.2f}),"
        f" {np.median(of_again):.2f} times that of MuJoCo with gains 0.1 % larger (median; worst"
        f" {np.max(of_again):.2f})"
    )


def leg_rows(options: argparse.Namespace) -> int:
    """Print, per seed, how many intervals hold of legs on a stand, and whether a rope is named."""
    robot = legs.robot()
    held = {name: [0, 0] for name in LEG_PARAMETERS}
    wrong = 0
    for seed in command.progress(command.seeds_of(options), desc="legs", unit="seed"):
        rng = np.random.default_rng(seed)
        drives = legs.Drives.drawn(rng)
        motion = legs.command_of(LEGS_DURATION, rng)
        for base in legs.BASES:
            fit = identify_servo(
                robot,
                legs.recorded(drives, motion, base),
                known={"gain": legs.GAIN, "damping": legs.DAMPING},
                estimated=("delay", "offset", *LEG_PARAMETERS),
            )
            named = any(note.startswith("The base moves") for note in fit.notes)
            wrong += named != (base == "rope")
            tqdm.write(f"{base} {seed}: {'base named' if named else 'base still'}", sys.stderr)
            if base == "rope":
                continue
            for name, counts in held.items():
                for joint, true in enumerate(getattr(drives, name)):
                    estimate = fit.parameter(joint, name)
                    counts[0] += estimate.low <= true <= estimate.high
                    counts[1] += 1
    print(text_table(["parameter", "held"], [[x, f"{a}/{b}"] for x, (a, b) in held.items()]))
    print(f"bases misjudged: {wrong} of {2 * options.seeds}")
    return wrong


def cases() -> int:
    """Print for each confounded case what the fit named; return the number that it missed."""
    lines: list[list[str]] = []
    missed = 0
    for title, case in CASES.items():
        found, remedy = case()
        missed += not found
        lines.append([title, "named" if found else "missed", remedy])
    print(text_table(["case", "", "remedy"], lines))
    return missed


def study(options: argparse.Namespace) -> int:
    """Make what is missing and print the tables."""
    if options.cases:
        return min(cases(), 1)
    if options.legs:
        return min(leg_rows(options), 1)
    code = [Path(__file__), Path(__file__).with_name("arms.py")]
    digest = made_of({"duration": options.duration}, code)
    rows = Rows(options.output / "rows.jsonl", ("arm", "seed"), digest)
    for name in options.arms:
        for seed in command.progress(command.seeds_of(options), desc=name, unit="seed"):
            if (name, seed) not in rows:
                rows.add(row := row_of(name, seed, options.duration))
                tqdm.write(f"{name} {seed}: {row['error']:.2f} mrad", sys.stderr)
        print(f"{name}, {options.seeds} seeds")
        print(summary([rows[name, seed] for seed in command.seeds_of(options)]), flush=True)
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study."""
    parser = command.new_parser(__doc__, "servo")
    command.add_seeds(parser, 20)
    parser.add_argument("--arms", nargs="+", default=list(LINKS), help="of " + " ".join(LINKS))
    parser.add_argument("--duration", type=float, default=60.0, help="of a recording [s]")
    parser.add_argument("--legs", action="store_true", help="legs in the air instead")
    parser.add_argument("--cases", action="store_true", help="the confounded cases instead")
    options = command.parse(parser, arguments, seeds=1, arms=["so101"], duration=20.0)
    command.require_least(parser, options, seeds=1, duration=5.0)
    command.require_some_of(parser, "arm", options.arms, tuple(LINKS))
    seconds = sum(SECONDS[x] * options.seeds * options.duration / 60.0 for x in options.arms)
    if options.cases or options.legs:
        seconds = 60.0 if options.cases else 40.0 * options.seeds
    return command.run(
        parser, lambda: study(options), options.output / "rows.jsonl", seconds=seconds
    )


if __name__ == "__main__":
    sys.exit(main())
