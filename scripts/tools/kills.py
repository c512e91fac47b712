"""Kills programs at random moments: earlier output must stay whole, and the next run must go on.

A program (`identify`, `record` or `study`) runs once to the end. Then it is started again and again
in a copy of that state, and killed by SIGKILL or interrupted by SIGINT: half of the times at any
moment of its run, and half of the times when it has just begun to write. After each, the files of
before are compared, and what is left behind is counted; then it runs to the end, which must give
the same results, and leave nothing behind.

    python -m scripts.tools.kills identify record study --trials 100 --workers 2

Rows go to `build/kills/rows.jsonl`; the next run goes on from there.
"""

import argparse
import contextlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any, NamedTuple

from jaxcslc._scratch import MARKER
from scripts.studies import command
from scripts.studies.rows import Rows, made_of


ROOT = Path(__file__).parents[2]
_OFF = 120.0  # seconds after which a run counts as hanging
_CODE_AFTER_SIGINT = (130, -signal.SIGINT)

ROBOT = "gravity = [0, -9.81, 0]\n[[joint]]\n[[joint]]\na = 0.3\n"
SETTINGS = '{"smoothing": {"method": "butterworth", "cutoff": 12.0}}'
MAKE = """
import jax, numpy as np, jaxcslc as jc
jc.enable_x64()
network = jc.derive(jc.load_robot("arm.toml"), lengths="numeric")
t = 0.01 * np.arange(600)[:, None]
q, qd, qdd = np.sin([3.0, 5.0] * t), [3.0, 5.0] * np.cos([3.0, 5.0] * t), [0.0, 0.0] * t
qdd = -np.square([3.0, 5.0]) * q
torque = np.asarray(network.torque(np.linspace(0.5, 1.5, len(network.names)), q, qd, qdd))
jc.save_recording(jc.Recording(t[:, 0], q, torque), "log.csv")
"""
RECORD = """
import sys
try:
    import sim

    machine, trajectory = sim.puma560(), sim.training(samples=600)
    jobs = [sim.Job(machine, trajectory, seed) for seed in range(6)]
    for i, result in sim.record_each(jobs, store="store", side_by_side=1):
        print(i, float(result.truth.position.sum()).hex())
except (KeyboardInterrupt, ImportError):  # an extension that is being initialised
    sys.exit(130)
"""
STUDY = """
import sys, time
from pathlib import Path
from scripts.studies import command
from scripts.studies.rows import Rows

parser = command.new_parser("", "study")
rows = Rows(Path("rows.jsonl"), ("number",), "kills")

def study():
    for number in range(300):
        if (number,) not in rows:
            time.sleep(0.01)
            rows.add({"number": number, "value": number**2, "text": "x" * 5000})
    return 0

sys.exit(command.run(parser, study, rows.path))
"""


class Program(NamedTuple):
    """A program that is killed.

    **Attributes**

    - `line`: of the command.
    - `output`: files and folders that it writes, in its folder.
    - `starts`: whether its earlier output is there when it starts; else only its input is.
    - `contents`: what is compared of a file of its output.
    """

    line: list[str]
    output: tuple[str, ...]
    starts: bool
    contents: Callable[[Path], Any]


def _numbers_of(path: Path) -> Any:
    """What of a result is the same in every run."""
    if path.name != "identification.json":
        return path.stat().st_size > 0
    return json.loads(path.read_text("utf-8"))["k"]


_COMMAND = "from jaxcslc.cli import main; main()"
_IDENTIFY = ("identify", "arm.toml", "log.csv", "--settings", "settings.json", "-o", "results")
PROGRAMS = {
    "identify": Program(["-c", _COMMAND, *_IDENTIFY], ("results",), True, _numbers_of),
    "record": Program(["-c", RECORD], ("store",), False, lambda path: path.read_bytes()),
    "study": Program(["-c", STUDY], ("rows.jsonl",), False, lambda path: path.read_bytes()),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Kills the programs. **Returns** 1 if a trial is wrong."""
    parser = command.new_parser(__doc__, "kills")
    parser.add_argument("programs", nargs="+", choices=sorted(PROGRAMS), metavar="PROGRAM")
    parser.add_argument("--trials", type=int, default=100, help="of each program")
    parser.add_argument("--workers", type=int, default=2, help="programs at a time")
    options = command.parse(parser, arguments, trials=4)
    command.require_least(parser, options, trials=1, workers=1)
    rows = Rows(options.output / "rows.jsonl", ("program", "trial"), made_of({}, [Path(__file__)]))

    def study() -> int:
        for name in options.programs:
            _kill(name, rows, options)
        return _report(rows, options.programs)

    return command.run(parser, study, rows.path, seconds=8.0 * options.trials)


def _kill(name: str, rows: Rows, options: argparse.Namespace) -> None:
    """All trials of one program that have no row yet."""
    trials = [trial for trial in range(options.trials) if (name, trial) not in rows]
    if not trials:
        return
    program = PROGRAMS[name]
    with tempfile.TemporaryDirectory() as folder:
        prepared = Path(folder) / "prepared"
        prepared.mkdir()
        _prepare(prepared)
        before = _files(prepared)
        start = time.monotonic()
        _finish(program, prepared)
        seconds = time.monotonic() - start
        whole = _whole(program, prepared)
        if not program.starts:
            _remove_new(prepared, before)
        with (
            ThreadPoolExecutor(options.workers) as pool,
            command.progress(desc=name, total=len(trials), unit="trial") as bar,
        ):
            waiting = [
                pool.submit(_trial, name, trial, prepared, whole, seconds, Path(folder))
                for trial in trials
            ]
            try:
                for done in as_completed(waiting):
                    rows.add(done.result())
                    bar.update()
            finally:
                pool.shutdown(cancel_futures=True)


def _trial(
    name: str, trial: int, prepared: Path, whole: dict[str, Any], seconds: float, folder: Path
) -> dict[str, Any]:
    """Starts a program in a copy of `prepared`, ends it, and lets it run again."""
    program, draw = PROGRAMS[name], random.Random(f"{name} {trial}")
    here = folder / f"{name} {trial}"
    shutil.copytree(prepared, here)
    before = {path: path.read_bytes() for path in _files(here)}
    how = draw.choice((signal.SIGKILL, signal.SIGINT))
    moment = "writing" if trial % 2 else "any"
    process = _start(program, here)
    after = _wait(process, here, before, draw, seconds, moment)
    process.send_signal(how)
    try:
        _, errors = process.communicate(timeout=_OFF)
    except subprocess.TimeoutExpired:
        process.kill()
        _, errors = process.communicate()
    faults: list[str] = []
    ended = process.returncode == 0
    # Python's own start, before the first line of a program, has a traceback of its own.
    starting = "Traceback" in errors and 'File "<string>"' not in errors
    if how == signal.SIGINT and not ended and not starting:
        if process.returncode not in _CODE_AFTER_SIGINT:
            faults.append(f"exit code {process.returncode} after SIGINT")
        if "Traceback" in errors:
            faults.append(f"traceback after SIGINT: {errors.strip().splitlines()[-1][:200]}")
    faults += _damage(program, here, before, whole)
    left = _hidden(here)
    if left and how == signal.SIGINT:
        faults.append(f"SIGINT left {', '.join(left)}")
    _finish(program, here)
    now = _whole(program, here)
    if now != whole:
        faults.append("the next run has another result")
    if still := _hidden(here):
        faults.append(f"the next run left {', '.join(still)}")
    shutil.rmtree(here)
    return {
        "program": name,
        "trial": trial,
        "signal": how.name,
        "moment": moment,
        "seconds": round(after, 3),
        "ended": ended,
        "left": len(left),
        "faults": faults,
    }


def _wait(
    process: "subprocess.Popen[str]",
    here: Path,
    before: dict[Path, bytes],
    draw: random.Random,
    seconds: float,
    moment: str,
) -> float:
    """Waits for a random moment, or until a program writes and a moment longer."""
    start, end = time.monotonic(), draw.uniform(0.0, seconds)
    while process.poll() is None and time.monotonic() - start < (end if moment == "any" else _OFF):
        if moment == "writing" and any(path not in before for path in _files(here)):
            time.sleep(draw.choice((0.0, 0.001, 0.01, 0.1, 0.3)) * draw.random())
            break
        time.sleep(0.001)
    return time.monotonic() - start


def _damage(
    program: Program, here: Path, before: dict[Path, bytes], whole: dict[str, Any]
) -> list[str]:
    """Files of before that are gone, or are neither as they were nor the new ones."""
    faults: list[str] = []
    for path, data in before.items():
        if not path.is_file():
            faults.append(f"{path.name} is gone")
        elif path.read_bytes() != data and not _is_whole(program, here, path, whole):
            faults.append(f"{path.name} is damaged")
    return faults


def _is_whole(program: Program, here: Path, path: Path, whole: dict[str, Any]) -> bool:
    try:
        return program.contents(path) == whole.get(str(path.relative_to(here)))
    except ValueError:
        return False


def _prepare(folder: Path) -> None:
    (folder / "arm.toml").write_text(ROBOT, encoding="utf-8")
    (folder / "settings.json").write_text(SETTINGS, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", MAKE], cwd=folder, env=_environment(), capture_output=True, text=True
    )
    if done.returncode:
        raise RuntimeError(f"the input could not be made: {done.stderr}")


def _start(program: Program, folder: Path) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, *program.line],
        cwd=folder,
        env=_environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def _finish(program: Program, folder: Path) -> None:
    """**Raises** `RuntimeError` if the program fails."""
    process = _start(program, folder)
    _, errors = process.communicate()
    if process.returncode:
        raise RuntimeError(f"exit code {process.returncode}: {errors[-1000:]}")


def _environment() -> dict[str, str]:
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    return {**os.environ, "PYTHONPATH": path, "JAX_DISABLE_MOST_OPTIMIZATIONS": "true"}


def _files(folder: Path) -> list[Path]:
    """What is there at this moment; a program may be removing files meanwhile."""
    with contextlib.suppress(FileNotFoundError):
        return sorted(path for path in folder.rglob("*") if path.is_file())
    return []


def _hidden(folder: Path) -> list[str]:
    hidden = [path.name for path in sorted(folder.rglob(".*"))]
    return [name for name in hidden if name != MARKER]


def _whole(program: Program, folder: Path) -> dict[str, Any]:
    """The output of a finished run, by name."""
    files = [path for path in _files(folder) if path.relative_to(folder).parts[0] in program.output]
    return {str(path.relative_to(folder)): program.contents(path) for path in files}


def _remove_new(folder: Path, before: Sequence[Path]) -> None:
    for path in _files(folder):
        if path not in before:
            path.unlink()


def _report(rows: Rows, programs: Sequence[str]) -> int:
    wrong = 0
    for name in programs:
        trials = [row for row in rows.all() if row["program"] == name]
        for row in trials:
            for fault in row["faults"]:
                print(f"{name}, trial {row['trial']}, {row['signal']}: {fault}")
        faulty = sum(bool(row["faults"]) for row in trials)
        wrong += faulty
        kills = sum(row["signal"] == "SIGKILL" for row in trials)
        print(
            f"{name}: {len(trials)} trials, {kills} by SIGKILL and {len(trials) - kills} by"
            f" SIGINT; {sum(row['ended'] for row in trials)} had ended before;"
            f" {sum(row['left'] > 0 for row in trials)} left something for the next run to"
            f" remove; {faulty} wrong"
        )
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
