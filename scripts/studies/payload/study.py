"""Pick up, carry and place with a payload identified while it is carried (thesis 2.7, 8.2.4).

Simulated PUMA 560 specimens, one for each seed, go from rest to a box of 0 (there is none), 0.5, 1
and 2 kg, pick it up at rest, carry it past two via points, put it down and go home. Each was
identified before from an unloaded training recording, and then performed other unloaded motions,
from which the errors of its model are known. Methods on the same task:

- **learnt**: the payload's estimate from encoders and torques is compensated at once
  (`jaxcslc.payload.PayloadCompensation`).
- **not learnt**: computed torque of the unloaded arm.
- **known**: computed torque with the true payload as soon as it is there.

All are computed torque of the identified arm, with the same gains. Printed and written are the
errors of mass and centre after some time of motion with the payload, their 95 % intervals and how
often these cover the truth, the times at which picking up and putting down were detected, the error
of the hand, and the estimates of `fit_payload` from the same recording.

Results are kept in `rows.jsonl`; an interrupted run goes on from there.
"""

import argparse
import ctypes.util
import os
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jaxcslc.report import write_csv
from scripts.studies.figures import save_picture


# Before MuJoCo is loaded: a film needs OpenGL without a screen. Without the library MuJoCo would
# not load at all.
if ctypes.util.find_library("EGL"):
    os.environ.setdefault("MUJOCO_GL", "egl")

import jaxcslc as jc
import sim
from scripts.studies import command
from scripts.studies.payload.arms import LEARNT, NOT_LEARNT, Arms
from scripts.studies.payload.errors import CURVE_STEP, SIGMAS, hand_error
from scripts.studies.payload.pictures import (
    PayloadCurve,
    Spread,
    hand_error_picture,
    payload_picture,
)
from scripts.studies.payload.results import Tables
from scripts.studies.payload.task import CASES, CENTRE, Task
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store


jc.enable_x64()


def draw(case: str, masses: Sequence[float], finished: Rows, output: Path) -> list[Path]:
    """Writes the pictures of a case."""
    curves: dict[str, PayloadCurve] = {}
    errors: dict[str, dict[str, Spread]] = {}
    task = Task(0.0, CASES[case].last_leg)
    time = task.time[::CURVE_STEP]
    for mass in masses:
        result = finished[case, mass]
        curve = {name: np.array(values) for name, values in result["curve"].items()}
        detected = tuple(float(curve[name]) for name in ("picked_up", "put_down"))
        name = f"{mass:g} kg" if mass else "nothing"
        curves[name] = PayloadCurve(
            time,
            curve["mass"],
            curve["mass_error"],
            curve["centre"],
            curve["centre_error"],
            curve["carrying"],
            mass,
            CENTRE,
            task.picked,
            task.placed,
            tuple(moment for moment in detected if moment > 0),
        )
        errors[name] = {
            method: Spread(*(np.array(quantile) for quantile in quantiles))
            for method, quantiles in result["away"].items()
        }
    description = CASES[case].description
    paths = [output / f"{case}_payload.png", output / f"{case}_hand.png"]
    picture = payload_picture(curves, title=f"Learnt while carried, one arm: {description}")
    save_picture(picture, paths[0])
    picture = hand_error_picture(
        time,
        errors,
        picked=task.picked,
        placed=task.placed,
        title=f"The hand, median and 10 to 90 % of the arms: {description}",
    )
    save_picture(picture, paths[1])
    return paths


def film(path: Path, arms: Arms, case: str, mass: float) -> None:
    """One arm with and without learning, side by side.

    **Raises** `sim.MachineError` where films cannot be made.
    """
    task, first = Task(mass, CASES[case].last_leg), arms.of_case(CASES[case].disturbances)[:1]
    runs = [arms.run(task, first, method)[0] for method in (LEARNT, NOT_LEARNT)]
    off = [hand_error(task, first[0].machine, run) for run in runs]
    observed = runs[0].observed

    def caption(number: int, sample: int) -> str:
        text = f"hand off by {off[number][sample]:5.2f} mm"
        if number or not observed["carrying"][sample]:
            return text
        half = SIGMAS * observed["mass_error"][sample]
        return f"{text}, estimate {observed['mass'][sample]:.3f} ± {half:.3f} kg"

    unfinished = path.with_name(f"unfinished_{path.name}")
    sim.film(
        unfinished,
        first[0].machine,
        [run.truth for run in runs],
        loads=task.loads,
        titles=[f"payload {method}" for method in (LEARNT, NOT_LEARNT)],
        caption=caption,
        size=(480, 400),
    )
    unfinished.replace(path)


def filmed(options: argparse.Namespace, cases: Sequence[str]) -> list[Path]:
    """The film of one arm with the heaviest payload, made unless it exists."""
    mass = max(options.masses)
    if not options.film or mass <= 0:
        return []
    case = "friction" if "friction" in cases else cases[0]
    path: Path = options.output / f"{case}_{mass:g}_kg.mp4"
    if not path.exists():
        try:
            film(path, Arms(1, options.frequency, options.training), case, mass)
        except sim.MachineError as error:
            print(" ".join(f"no film: {error}".split()), file=sys.stderr)
    return [path] if path.exists() else []


def study(options: argparse.Namespace) -> int:
    """Makes what is missing, prints the tables and writes the files."""
    cases = [case for case in CASES if case in options.cases]
    masses = sorted(set(options.masses))
    pairs = [(case, mass) for case in cases for mass in masses]
    code = [
        Path(__file__).with_name(f"{name}.py")
        for name in ("arms", "bound", "errors", "loops", "task")
    ]
    names = ("seeds", "frequency", "training", "quick")
    digest = made_of({name: getattr(options, name) for name in names}, code)
    finished = Rows(options.output / "rows.jsonl", ("case", "mass"), digest)
    arms = Arms(options.seeds, options.frequency, options.training, select=not options.quick)
    for case, mass in command.progress(pairs, desc="cases and masses", unit="pair"):
        if (case, mass) not in finished:
            finished.add({"case": case, "mass": mass, **arms.results(case, mass)})
    rows = [row for pair in pairs for row in finished[pair]["rows"]]
    columns = dict.fromkeys(name for row in rows for name in row)
    written: list[Path] = [options.output / "seeds.csv", options.output / "tables.txt"]
    write_csv(written[0], [{name: row.get(name, "") for name in columns} for row in rows])
    tables = Tables(rows)
    text = "\n\n".join(
        [
            f"{options.seeds} arms: median (10 to 90 %)",
            "Estimates, after so much motion with the payload\n" + tables.estimates(),
            "Detected after so much time from setting off on\n" + tables.moments(),
            "Errors of the mass at the end, and the Cramér-Rao bound of the motion\n"
            + tables.bounds(),
            "The hand\n" + tables.hand(),
        ]
    )
    print(text)
    written[1].write_text(text + "\n", encoding="utf-8")
    store(options, "payload", f"{options.seeds} machines", {"disturbances": tables.page_table()})
    for case in cases:
        written += draw(case, masses, finished, options.output)
    written += filmed(options, cases)
    print("wrote " + ", ".join(str(path) for path in written))
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "payload_study")
    parser.add_argument("--seeds", type=int, default=10, help="how many specimens, from 0 on")
    parser.add_argument("--masses", type=float, nargs="+", default=[0.0, 0.5, 1.0, 2.0],
                        metavar="KG", help="of the payloads [kg]")  # fmt: skip
    descriptions = "; ".join(f"{name}: {case.description}" for name, case in CASES.items())
    parser.add_argument(
        "--cases", nargs="+", choices=list(CASES), default=list(CASES), help=descriptions
    )
    parser.add_argument("--frequency", type=float, default=20.0,
                        help="natural frequency of the controllers [rad/s]")  # fmt: skip
    parser.add_argument("--training", type=int, default=3300,
                        help="samples to identify an arm from, 2 ms apart")  # fmt: skip
    parser.add_argument("--film", action=argparse.BooleanOptionalAction, default=True,
                        help="of one arm with the heaviest payload, if OpenGL works")  # fmt: skip
    quick = {"seeds": 1, "masses": [1.0], "cases": list(CASES)[:1], "training": 1000, "film": False}
    command.add_store(parser)
    options = command.parse(parser, argv, **quick)
    command.require_least(parser, options, seeds=1)
    if not 1.0 <= options.frequency <= 60.0:
        parser.error(f"--frequency is {options.frequency:g}; expected 1 to 60 rad/s")
    if not all(0.0 <= mass <= 5.0 for mass in options.masses):
        parser.error("--masses: expected 0 to 5 kg")
    pairs = len(options.cases) * len(options.masses)
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=30.0 + 60.0 * options.film + pairs * (15.0 + 5.0 * options.seeds),
    )


if __name__ == "__main__":
    raise SystemExit(main())
