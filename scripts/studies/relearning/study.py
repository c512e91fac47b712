"""After bearings are cleaned: friction alone is learnt again, from a few seconds (5.2.4, 8.2.3).

A simulated PUMA 560 with encoders and static friction is identified once from the training
trajectory. Then every joint's viscous, dry and static friction falls by 20 to 50 %, each by its
own draw, and the arm performs the training trajectory again, with torques so much smaller that
it stays within its range. Of this second recording only the first seconds are learnt from:

- **as before**: nothing is learnt, the old coefficients stay.
- **friction alone**: viscous and dry friction, the rest held (`jaxcslc.reidentify`).
- **everything**: all 43 coefficients from the short recording alone.

All are judged by ε on the comparison trajectory of the cleaned arm, on the links' true motion
where they move. The floor is what the true coefficients leave of it: static friction.
"""

import argparse
import dataclasses
import hashlib
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from tqdm import tqdm

import jaxcslc as jc
import sim
from jaxcslc.identification import text_table, write_csv
from jaxcslc.motion import as_recorded, choose_spacing
from jaxcslc.plotting import save_picture
from scripts.studies.relearning.pictures import relearning_picture


jax.config.update("jax_enable_x64", True)

MOVING = 1e-3  # rad/s; slower than this a joint may be stuck
CUTOFF = 15.0  # Hz
THRESHOLD_FRACTION = 0.01
TORQUES = 0.8  # of the training trajectory's, for the cleaned arm
BEFORE, FRICTION, EVERYTHING = "as before", "friction alone", "everything"
WAYS = (BEFORE, FRICTION, EVERYTHING)


def cleaned(machine: sim.Machine, seed: int, fall: tuple[float, float]) -> sim.Machine:
    """The machine with less friction in every joint."""
    rng = np.random.default_rng([seed, 1])
    left = {
        name: tuple((1.0 - rng.uniform(*fall, machine.joint_count)) * getattr(machine, name))
        for name in ("viscous", "dry")
    }
    # What static friction adds to dry friction falls alike.
    static = np.array(machine.static) * np.array(left["dry"]) / np.array(machine.dry)
    return dataclasses.replace(machine, **left, static=tuple(static))


def settings_of(machine: sim.Machine, recording: jc.Recording) -> jc.Settings:
    spacing = choose_spacing(
        recording.time, recording.position, resolution=np.array(machine.encoder_resolution)
    )
    return jc.Settings(
        smoothing=jc.AveragedSplines(spacing),
        torque_alignment="mean",
        threshold_fraction=THRESHOLD_FRACTION,
        cutoff=CUTOFF,
    )


def judged(performed: sim.SimulatedRecording) -> jc.Patterns:
    """The links' true motion where they move, and the torque that made it."""
    recording, truth = performed
    motion = jc.Recording(
        recording.time, truth.position, truth.torque, truth.velocity, truth.acceleration
    )
    return as_recorded(motion, thresholds=MOVING)


def first(recording: jc.Recording, length: float) -> jc.Recording:
    kept = recording.time - recording.time[0] < length
    return jc.Recording(recording.time[kept], recording.position[kept], recording.torque[kept])


class Study:
    """One machine, and what each seed makes of it."""

    def __init__(self, lengths: Sequence[float], fall: tuple[float, float], samples: int) -> None:
        self.machine = sim.disturbed(sim.puma560(), "quantisation", "static friction")
        self.network = jc.derive(jc.puma560())
        self.lengths, self.fall = tuple(lengths), fall
        plain = sim.training(samples=samples)
        longest = round(max(lengths) / 0.002) + 1
        torques = tuple(TORQUES * x for x in (25.0, 13.0, 14.0, 8.0, 10.0, 14.0))
        self.trajectories = plain, sim.training(samples=longest, amplitude=torques)

    def rows(self, seed: int) -> list[dict[str, Any]]:
        """Each length and way, of one seed."""
        machine, network = self.machine, self.network
        after = cleaned(machine, seed, self.fall)
        trained = sim.simulate(machine, self.trajectories[0], seed=3 * seed).recording
        settings = settings_of(machine, trained)
        known = settings.fit(network, settings.patterns(trained))
        again = sim.simulate(after, self.trajectories[1], seed=3 * seed + 1).recording
        patterns = judged(sim.simulate(after, sim.comparison(), seed=3 * seed + 2))
        true = network.coefficients_from(after.links, viscous=after.viscous, dry=after.dry)
        friction = np.array([c.group in ("viscous", "dry") for c in network.coefficients])
        rows: list[dict[str, Any]] = []
        for length in self.lengths:
            short = settings.patterns(first(again, length))
            learnt = settings.reidentify(network, short, known, ("viscous", "dry"))
            found = {BEFORE: known.k, FRICTION: learnt.k}
            whole = settings.solver.fit(network, short, throw=False)
            if whole.result != jc.RESULTS.no_equations:
                found[EVERYTHING] = whole.k
            vectors = found | {"floor": true}
            errors = np.asarray(jc.compare(network, patterns, vectors).epsilon)
            epsilon = dict(zip(vectors, errors.tolist(), strict=True))
            held = np.abs(learnt.k - true) <= 2.0 * learnt.standard_error
            for way in WAYS:
                off = np.asarray(found.get(way, np.nan) - true)[friction] / np.asarray(
                    true[friction]
                )
                rows.append(
                    {
                        "seed": seed,
                        "length": length,
                        "way": way,
                        "epsilon": epsilon.get(way, np.nan),
                        "floor": epsilon["floor"],
                        "friction_error": float(np.median(np.abs(off))),
                        "within_2_errors": float(np.mean(held[friction]))
                        if way == FRICTION
                        else "",
                    }
                )
        return rows


def summary(rows: Sequence[dict[str, Any]], lengths: Sequence[float]) -> str:
    """Medians and 10 to 90 % ranges, one line a length."""

    def said(values: Sequence[float]) -> str:
        own = np.array(values)[np.isfinite(values)]
        if not len(own):
            return "-"
        low, middle, high = np.quantile(own, [0.1, 0.5, 0.9])
        return f"{middle:.3g} ({low:.3g} to {high:.3g})"

    cells: list[list[str]] = []
    for length in lengths:
        here = [row for row in rows if row["length"] == length]
        ways = [[row for row in here if row["way"] == way] for way in WAYS]
        cells.append(
            [
                f"{length:g} s",
                *(said([row["epsilon"] for row in way]) for way in ways),
                said([row["floor"] for row in ways[0]]),
                said([100 * row["friction_error"] for row in ways[1]]),
            ]
        )
    header = ["ε [N m] after", *WAYS, "true coefficients", "error of friction alone [%]"]
    return text_table(header, cells)


class Finished:
    """Rows in a file, one line a seed, so that a run can be taken up again."""

    def __init__(self, path: Path, made_of: str) -> None:
        self.path, self.made_of = path, made_of
        self.found: dict[int, list[dict[str, Any]]] = {}
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        for line in text[: text.rfind("\n") + 1].splitlines():  # the last may be half-written
            try:
                entry = json.loads(line)
                if entry["made_of"] == made_of:
                    self.found[entry["seed"]] = entry["rows"]
            except (ValueError, KeyError, TypeError) as error:
                raise ValueError(f"{path}: {error!r}; expected rows of this script") from error

    def add(self, seed: int, rows: list[dict[str, Any]]) -> None:
        self.found[seed] = rows
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"seed": seed, "made_of": self.made_of, "rows": rows}) + "\n")


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, default=Path("build/relearn_friction"))
    parser.add_argument("--seeds", type=int, default=20, help="how many, from 0 on")
    parser.add_argument("--lengths", type=float, nargs="+", default=[0.5, 1.0, 2.0, 3.3, 6.6],
                        metavar="S", help="of the recordings to learn again from [s]")  # fmt: skip
    parser.add_argument("--fall", type=float, nargs=2, default=(0.2, 0.5), metavar=("LOW", "HIGH"),
                        help="by what part friction falls")  # fmt: skip
    parser.add_argument("--samples", type=int, default=3300, help="of training, 2 ms apart")
    given = parser.parse_args(arguments)
    if given.seeds < 1:
        parser.error(f"--seeds is {given.seeds}; expected 1 or more")
    if min(given.lengths) < 0.2:
        parser.error(f"--lengths: {min(given.lengths):g} s is too short; expected 0.2 s or more")
    if not 0.0 <= given.fall[0] <= given.fall[1] < 1.0:
        parser.error("--fall: expected two parts from 0 to less than 1, the lower one first")
    lengths = sorted(set(given.lengths))
    try:
        made_of = json.dumps([lengths, list(given.fall), given.samples])
        code = hashlib.sha256(Path(__file__).read_bytes() + made_of.encode()).hexdigest()
        finished = Finished(given.output / "rows.jsonl", code)
        study = Study(lengths, tuple(given.fall), given.samples)
        for seed in tqdm(range(given.seeds), desc="seeds", disable=None):
            if seed not in finished.found:
                finished.add(seed, study.rows(seed))
    except (sim.MachineError, sim.SimulationError, ValueError, RuntimeError) as error:
        parser.error(" ".join(str(error).split()))
    except KeyboardInterrupt:
        print("stopped; the same command goes on from here", file=sys.stderr)
        return 130
    rows = [row for seed in range(given.seeds) for row in finished.found[seed]]
    print(f"{given.seeds} seeds: median (10 to 90 %)\n{summary(rows, lengths)}")
    held = [row["within_2_errors"] for row in rows if row["way"] == FRICTION]
    print(
        f"friction alone: {np.mean(held):.0%} of its coefficients within two standard errors of"
        " the truth; errors by static friction, which no coefficient stands for, are not in these"
    )
    write_csv(given.output / "seeds.csv", rows)
    errors = {
        way: np.array(
            [
                [row["epsilon"] for row in rows if row["way"] == way and row["length"] == length]
                for length in lengths
            ]
        )
        for way in WAYS
    }
    picture = relearning_picture(
        lengths,
        errors,
        floor=float(np.median([row["floor"] for row in rows])),
        title="PUMA 560 with cleaned bearings: torque error on another trajectory",
    )
    save_picture(picture, given.output / "relearning.png")
    print(f"wrote {given.output / 'seeds.csv'}, {given.output / 'relearning.png'}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
