"""Pick up, carry and place with a payload that is learnt on the way (thesis 2.7, 8.2.4).

Simulated PUMA 560 specimens, one a seed, go from rest to a box of 0 (there is none), 0.5, 1 and
2 kg, pick it up while they stand there, carry it past two via points, put it down and go home.
Each was identified before from a recording of its own, unloaded, and then rehearsed other motions
unloaded, which says how wrong its model is. On the same task:

- **learnt**: what is learnt of the payload from encoders and torques while it is carried is
  compensated at once (`jaxcslc.payload.CarryingLoop`).
- **not learnt**: computed torque of the unloaded arm.
- **known**: computed torque that is told the true payload as soon as it is there.

All are computed torque on the identified arm, with the same gains. Printed and written are the
errors of mass and centre after some time of motion with the payload, their 95 % intervals and how
often these hold the truth, when picking up and putting down were noticed, how far the hand was
from where it should have been, and what `fit_payload` says afterwards of the same recording.
"""

import argparse
import ctypes.util
import hashlib
import json
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from tqdm import tqdm

from jaxcslc.identification import text_table, write_csv
from jaxcslc.plotting import save_picture


# Before MuJoCo is loaded: a film needs OpenGL, and no screen. Without the library MuJoCo would not
# load at all.
if ctypes.util.find_library("EGL"):
    os.environ.setdefault("MUJOCO_GL", "egl")

import sim
from scripts.studies.payload.pictures import (
    PayloadCurve,
    Spread,
    hand_error_picture,
    payload_picture,
)
from scripts.studies.payload.runs import (
    CASES,
    CENTRE,
    EVERY,
    LEARNT,
    MOMENTS,
    NOT_LEARNT,
    SIGMAS,
    WAYS,
    Study,
    Task,
    hand_error,
)


jax.config.update("jax_enable_x64", True)

AWAY = {
    "carrying": "carrying",
    "last leg": "on the last way",
    "arrival": "arriving",
    "place": "at the place",
}


def said(values: Sequence[float], form: str = ".3g") -> str:
    """Median and range from 10 to 90 % of what is known."""
    own = np.array([value for value in values if np.isfinite(value)])
    if not len(own):
        return "-"
    low, middle, high = np.quantile(own, [0.1, 0.5, 0.9])
    return f"{middle:{form}} ({low:{form}} to {high:{form}})"


class Rows:
    """Those of all seeds, and tables of them."""

    def __init__(self, rows: Sequence[Mapping[str, Any]]) -> None:
        self.rows = rows
        self.pairs = list(dict.fromkeys((row["case"], row["mass"]) for row in rows))

    def of(self, case: str, mass: float, name: str) -> list[float]:
        """One number of each seed."""
        here = [row for row in self.rows if (row["case"], row["mass"]) == (case, mass)]
        return [float(row[name]) for row in here]

    def estimates(self) -> str:
        """How good the estimates are, and their intervals."""
        cells: list[list[str]] = []
        for case, mass in self.pairs:
            for moment in (*(f"{t:g} s" for t in MOMENTS), "end", "off-line") if mass else ():
                cells.append([CASES[case].words, f"{mass:g}", moment])
                for name in ("mass", "centre"):
                    unit = "%" if name == "mass" else "mm"
                    off, wide, held = (
                        np.array(self.of(case, mass, f"{name} {what}, {moment}"))
                        for what in (f"error [{unit}]", f"interval [{unit}]", "held")
                    )
                    if name == "mass":
                        cells[-1].append(f"{np.isfinite(off).sum()}/{len(off)}")
                    off, some = np.abs(off), np.isfinite(off).any()
                    cells[-1] += [
                        said(off.tolist()),
                        f"{np.nanmax(off):.3g}" if some else "-",
                        f"{np.nanmedian(wide):.2g}" if some else "-",
                        f"{np.nanmean(held):.0%}" if some else "-",
                    ]
        header = ["case", "kg", "after", "found", "mass error [%]", "worst", "95 % ±", "held"]
        header += ["centre error [mm]", "worst", "95 % ±", "held"]
        return text_table(header, cells, left=("after",))

    def moments(self) -> str:
        """When picking up and putting down were noticed, and what was handed out."""
        cells: list[list[str]] = []
        for case, mass in self.pairs:
            up, down = (
                self.of(case, mass, name) if mass else [] for name in ("picked up", "put down")
            )
            cells.append(
                [
                    CASES[case].words,
                    f"{mass:g}",
                    *(
                        text
                        for each in (up, down)
                        for text in (f"{np.isfinite(each).sum()}/{len(each)}", said(each))
                    ),
                    f"{sum(self.of(case, mass, 'false alarms')):g}",
                    f"{min(self.of(case, mass, 'least eigenvalue')):.2g}",
                ]
            )
        header = ["case", "kg", "up", "after [s]", "down", "after [s]", "false", "least eigenvalue"]
        return text_table(header, cells)

    def hand(self) -> str:
        """Where the hand was, in each way, and how many times farther off without learning."""
        cells: list[list[str]] = []
        for case, mass in self.pairs:
            for key, words in AWAY.items():
                mm = {
                    way: np.array(self.of(case, mass, f"{key} [mm], {way}"))
                    for way in (WAYS if mass else (LEARNT,))
                }
                ratio = mm[NOT_LEARNT] / mm[LEARNT] if mass else np.empty(0)
                cells.append(
                    [
                        CASES[case].words,
                        f"{mass:g}",
                        words,
                        *(said(mm[way].tolist()) if way in mm else "-" for way in WAYS),
                        said(ratio.tolist()),
                    ]
                )
        header = ["case", "kg", "error of the hand [mm]", *WAYS, "not learnt / learnt"]
        return text_table(header, cells, left=("error of the hand [mm]",))


class Finished:
    """Results in a file, one line a case and mass, so that a run can be taken up again."""

    def __init__(self, path: Path, made_of: str) -> None:
        self.path, self.made_of = path, made_of
        self.found: dict[tuple[str, float], dict[str, Any]] = {}
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        for line in text[: text.rfind("\n") + 1].splitlines():  # the last may be half-written
            try:
                entry = json.loads(line)
                if entry["made_of"] == made_of:
                    self.found[entry["case"], entry["mass"]] = entry["result"]
            except (ValueError, KeyError, TypeError) as error:
                raise ValueError(f"{path}: {error!r}; expected rows of this script") from error

    def add(self, case: str, mass: float, result: dict[str, Any]) -> None:
        self.found[case, mass] = result
        self.path.parent.mkdir(parents=True, exist_ok=True)
        entry = {"case": case, "mass": mass, "made_of": self.made_of, "result": result}
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")


def draw(case: str, masses: Sequence[float], finished: Finished, output: Path) -> list[Path]:
    """The pictures of a case."""
    curves: dict[str, PayloadCurve] = {}
    errors: dict[str, dict[str, Spread]] = {}
    task = Task(0.0, CASES[case].last)
    time = task.time[::EVERY]
    for mass in masses:
        result = finished.found[case, mass]
        seen = {key: np.array(value) for key, value in result["curve"].items()}
        noticed = tuple(float(seen[name]) for name in ("picked_up", "put_down"))
        name = f"{mass:g} kg" if mass else "nothing"
        curves[name] = PayloadCurve(
            time,
            seen["mass"],
            seen["mass_error"],
            seen["centre"],
            seen["centre_error"],
            seen["carrying"],
            mass,
            CENTRE,
            task.picked,
            task.placed,
            tuple(each for each in noticed if each > 0),
        )
        errors[name] = {
            way: Spread(*(np.array(each) for each in values))
            for way, values in result["away"].items()
        }
    words = CASES[case].words
    first, second = output / f"{case}_payload.png", output / f"{case}_hand.png"
    save_picture(payload_picture(curves, title=f"Learnt on the way, one arm: {words}"), first)
    picture = hand_error_picture(
        time,
        errors,
        picked=task.picked,
        placed=task.placed,
        title=f"The hand, median and 10 to 90 % of the arms: {words}",
    )
    save_picture(picture, second)
    return [first, second]


def film(path: Path, study: Study, case: str, mass: float) -> None:
    """One arm with and without learning, side by side.

    **Raises** `sim.MachineError` where films cannot be made.
    """
    task, arms = Task(mass, CASES[case].last), study.arms(CASES[case].disturbances)[:1]
    runs = [study.run(task, arms, way)[0] for way in (LEARNT, NOT_LEARNT)]
    away = [hand_error(task, arms[0], run) for run in runs]
    seen = runs[0].observed

    def caption(number: int, sample: int) -> str:
        off = f"hand off by {away[number][sample]:5.2f} mm"
        if number or not seen["carrying"][sample]:
            return off
        half = SIGMAS * seen["mass_error"][sample]
        return f"{off}, thinks it carries {seen['mass'][sample]:.3f} ± {half:.3f} kg"

    half_made = path.with_name(f"unfinished_{path.name}")
    sim.film(
        half_made,
        arms[0].machine,
        [run.truth for run in runs],
        loads=task.loads,
        titles=[f"payload {way}" for way in (LEARNT, NOT_LEARNT)],
        caption=caption,
        size=(480, 400),
    )
    half_made.replace(path)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, default=Path("build/payload_study"))
    parser.add_argument("--seeds", type=int, default=10, help="how many specimens, from 0 on")
    parser.add_argument("--masses", type=float, nargs="+", default=[0.0, 0.5, 1.0, 2.0],
                        metavar="KG", help="of what is carried [kg]")  # fmt: skip
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES),
                        help="; ".join(f"{k}: {v.words}" for k, v in CASES.items()))  # fmt: skip
    parser.add_argument("--frequency", type=float, default=20.0,
                        help="natural frequency of the controllers [rad/s]")  # fmt: skip
    parser.add_argument("--training", type=int, default=3300,
                        help="samples to identify an arm from, 2 ms apart")  # fmt: skip
    parser.add_argument("--film", action=argparse.BooleanOptionalAction, default=True,
                        help="of one arm with the heaviest payload, if OpenGL works")  # fmt: skip
    given = parser.parse_args(arguments)
    if given.seeds < 1:
        parser.error(f"--seeds is {given.seeds}; expected 1 or more")
    if not 1.0 <= given.frequency <= 60.0:
        parser.error(f"--frequency is {given.frequency:g}; expected 1 to 60 rad/s")
    if not all(0.0 <= mass <= 5.0 for mass in given.masses):
        parser.error("--masses: expected 0 to 5 kg")
    cases, masses = [case for case in CASES if case in given.cases], sorted(set(given.masses))
    units = [(case, mass) for case in cases for mass in masses]
    options = given.seeds, given.frequency, given.training
    written: list[Path] = [given.output / "seeds.csv"]
    try:
        runs = ("payload_runs.py", "payload_loops.py")
        code = b"".join(Path(__file__).with_name(name).read_bytes() for name in runs)
        made_of = hashlib.sha256(code + json.dumps(options).encode()).hexdigest()
        finished, study = Finished(given.output / "rows.jsonl", made_of), Study(*options)
        for case, mass in tqdm(units, desc="cases and masses", disable=None):
            if (case, mass) not in finished.found:
                finished.add(case, mass, study.unit(case, mass))
        rows = [row for unit in units for row in finished.found[unit]["rows"]]
        table = Rows(rows)
        names = dict.fromkeys(name for row in rows for name in row)
        write_csv(written[0], [{name: row.get(name, "") for name in names} for row in rows])
        text = "\n\n".join(
            [
                f"{given.seeds} arms: median (10 to 90 %)",
                "Estimates, after so much motion with the payload\n" + table.estimates(),
                "Noticed after so much time from setting off on\n" + table.moments(),
                "The hand\n" + table.hand(),
            ]
        )
        print(text)
        (given.output / "tables.txt").write_text(text + "\n", encoding="utf-8")
        written.append(given.output / "tables.txt")
        for case in cases:
            written += draw(case, masses, finished, given.output)
        if given.film and max(masses) > 0:
            shown, mass = "friction" if "friction" in cases else cases[0], max(masses)
            path = given.output / f"{shown}_{mass:g}_kg.mp4"
            if not path.exists():
                try:
                    film(path, Study(1, *options[1:]), shown, mass)
                except sim.MachineError as error:
                    print(" ".join(f"no film: {error}".split()), file=sys.stderr)
            written += [path] if path.exists() else []
    except (sim.MachineError, sim.SimulationError, ValueError, RuntimeError) as error:
        parser.error(" ".join(str(error).split()))
    except KeyboardInterrupt:
        print("stopped; the same command goes on from here", file=sys.stderr)
        return 130
    print("wrote " + ", ".join(str(path) for path in written))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
