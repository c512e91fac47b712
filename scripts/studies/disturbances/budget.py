"""What each disturbance of a PUMA 560 costs, and what each counter-measure gains (7.2 to 7.6).

Every disturbance of Section 7.2 alone, none, and all together, over many seeds. Each seed is a
training recording, from which the network is identified, and a comparison recording, on which it
is judged: with its counter-measure, with it alone switched off, and beside the true coefficients.

- **The pipeline.** Averaged splines with sections, their spacings chosen by `choose_spacing` on
  the first training recording of a case; the torque that belongs to a sample the mean of the two
  intervals that meet there; samples slower than a hundredth of a joint's greatest speed left out;
  regressor and torque low-passed alike at 15 Hz; joints weighted by their residuals. Measures that
  need to know of a disturbance (backlash mask, full inertia tensors, torque offsets, limit of
  linearity) are on where the machine has it.
- **Switched off:** central differences of the counts in place of splines; no threshold of speed; no
  backlash mask (Eqn. 2.5-7); no low pass; principal axes in place of full tensors; no torque
  offsets; pairs of more demand than the limit of linearity kept; the torque of the sample alone.
  The delay of the drives is compensated in neither case. 'undisturbed' is with and without the
  threshold of speed. 'all disturbances' is with all measures and without any, and 'all, but' with
  all but one: all of them of the network of principal axes without offsets, so that their
  coefficients are the same ones.
- **ε** (7.5) is on the links' true motion where a joint moves. Where gears give way, rotors move
  otherwise than links, which no coefficient of a rigid machine can follow: the torque that a
  prediction is compared with is what rigid gears would have needed for the links' motion. What
  true coefficients leave of it, the floor, is static friction, and what a network has no terms for.
- **Coefficient error** is the root mean square, over all coefficients of the network fitted, of
  how far each is from its true value times its output sensitivity on the training recording
  (7.6) [N m]. A network of principal axes has the true moments as its true values.

Rows of finished seeds are kept in `rows.jsonl`; an interrupted run goes on from there.
"""

import argparse
import dataclasses
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import jaxcslc as jc
import sim
from jaxcslc.recordings import choose_spacing
from jaxcslc.report import all_or_nothing
from scripts.studies import command
from scripts.studies.disturbances.fits import Fits, identify, judge
from scripts.studies.disturbances.measures import CASES, machine_of
from scripts.studies.disturbances.summary import FIGURES, mask_text, summarise, table, write
from scripts.studies.rows import Rows, made_of


jc.enable_x64()

MACHINES = {"a": sim.puma_a, "b": sim.puma_b, "armstrong": sim.puma560}
# Recordings made side by side: enough to keep cores busy, few enough to lose little.
SEEDS_AT_ONCE = 16


@dataclasses.dataclass
class Clock:
    """Seconds spent in simulation and in everything after it."""

    simulation: float = 0.0
    identification: float = 0.0


def make_rows(
    machines: Mapping[str, sim.Machine], trajectories: Sequence[sim.Trajectory], seeds: int,
    rows: Rows, clock: Clock,
) -> None:  # fmt: skip
    """Makes every missing row, a few seeds of all cases at a time."""
    wanted = [(case, seed) for seed in range(seeds) for case in machines]
    missing = [key for key in wanted if key not in rows]
    spacings = {case: first_spacing(rows, case) for case in machines}
    with command.progress(
        total=len(wanted), initial=len(wanted) - len(missing), desc="rows", unit="row"
    ) as bar:
        for start in range(0, len(wanted), SEEDS_AT_ONCE * len(machines)):
            block = wanted[start : start + SEEDS_AT_ONCE * len(machines)]
            part = [key for key in block if key not in rows]
            for case, seed, figures in results(machines, trajectories, part, spacings, clock):
                rows.add({"case": case, "seed": seed, **figures})
                bar.update()


def first_spacing(rows: Rows, case: str) -> tuple[int, ...] | None:
    """The spacing that was selected on the first recording of a case, if there is one."""
    spacings = (row["spacing"] for row in rows.all() if row["case"] == case and "spacing" in row)
    first = next(spacings, None)
    return None if first is None else tuple(first)


def results(
    machines: Mapping[str, sim.Machine],
    trajectories: Sequence[sim.Trajectory],
    part: Sequence[tuple[str, int]],
    spacings: dict[str, tuple[int, ...] | None],
    clock: Clock,
) -> Iterator[tuple[str, int, dict[str, Any]]]:
    """Figures of each case and seed as soon as they are there, or the reason of a failure."""
    # Two numbers a seed: the encoders of the two recordings start elsewhere.
    jobs = [
        sim.Job(machines[case], trajectory, 2 * seed + i)
        for i, trajectory in enumerate(trajectories)
        for case, seed in part
    ]
    fits: dict[tuple[str, int], Fits] = {}
    waiting: dict[tuple[str, int], sim.SimulatedRecording] = {}
    failed: set[tuple[str, int]] = set()
    before = time.perf_counter()
    for number, result in sim.record_each(jobs):
        clock.simulation += (now := time.perf_counter()) - before
        key = (case, _) = part[number % len(part)]
        if key not in failed:
            try:
                if isinstance(result, sim.SimulationError):
                    raise result
                if number < len(part):
                    spacing = spacings[case] or selected_spacing(machines[case], result.recording)
                    spacings[case] = spacing
                    fits[key] = identify(case, machines[case], result, spacing)
                else:
                    waiting[key] = result
                if key in fits and key in waiting:
                    yield *key, judge(case, machines[case], fits.pop(key), waiting.pop(key))
            except (sim.SimulationError, ValueError, RuntimeError) as error:
                failed.add(key)
                yield *key, {"failed": str(error).partition("\n")[0]}
        clock.identification += (before := time.perf_counter()) - now


def selected_spacing(machine: sim.Machine, recording: jc.Recording) -> tuple[int, ...]:
    """Spacings of averaged splines that suit a recording's encoders."""
    resolution = np.array(machine.encoder_resolution)
    return choose_spacing(recording.time, recording.position, resolution=resolution)


def study(options: argparse.Namespace) -> int:
    """Makes what is missing, prints the tables and writes the files."""
    clock = Clock()
    cases = [case for case in CASES if case in options.cases]
    whole = MACHINES[options.machine]()
    machines = {case: machine_of(whole, case) for case in cases}
    trajectories = (sim.training(samples=options.samples), sim.comparison())
    code = [Path(__file__).with_name(name) for name in ("budget.py", "fits.py", "measures.py")]
    digest = made_of({"machine": options.machine, "samples": options.samples}, code)
    rows = Rows(options.output / "rows.jsonl", ("case", "seed"), digest)
    make_rows(machines, trajectories, options.seeds, rows, clock)

    finished = [rows[case, seed] for case in cases for seed in range(options.seeds)]
    failed = [row for row in finished if "failed" in row]
    for row in failed[:5]:
        print(f"failed: {row['case']}, seed {row['seed']}: {row['failed']}")
    if len(failed) == len(finished):
        print(f"all {len(finished)} rows failed; nothing to summarise")
        return 1
    summaries = summarise(cases, finished)
    title = f"{whole.robot.name}: what disturbances cost, {options.seeds} seeds"
    for figure, quantity in FIGURES.items():
        print(f"\n{title}: {quantity}, mean ± standard deviation (5 to 95 % of the seeds)")
        print(table(summaries, figure))
    print()
    for text in mask_text(finished):
        print(text)
    if failed:
        print(f"{len(failed)} of {len(finished)} rows failed and are left out")
    with all_or_nothing(options.output) as folder:
        write(folder, summaries, finished, title)
    print(f"simulation took {clock.simulation:.0f} s, the rest {clock.identification:.0f} s")
    print(f"wrote tables and pictures into {options.output}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "disturbance_budget")
    parser.add_argument("--seeds", type=int, default=100, help="how many, from 0 on")
    parser.add_argument("--cases", nargs="+", default=list(CASES), metavar="CASE",
                        help=f"some of: {', '.join(CASES)}")  # fmt: skip
    parser.add_argument("--machine", choices=list(MACHINES), default="armstrong",
                        help="links and friction")  # fmt: skip
    parser.add_argument(
        "--samples", type=int, default=3300, help="of a training recording, 2 ms apart"
    )
    options = command.parse(parser, argv, seeds=1, samples=1000, cases=list(CASES)[:3])
    command.require_least(parser, options, seeds=1)
    command.require_some_of(parser, "case", options.cases, CASES)
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=30.0 + 1.5 * options.seeds * len(options.cases),
    )


if __name__ == "__main__":
    raise SystemExit(main())
