"""Ends and disturbs programs that write: earlier output stays whole, the next run goes on.

Each case is a program, a copy of a folder in which it has run before, and a fault:

- `SIGKILL`, `SIGINT`, `SIGTERM`: half of the times at any moment of its run, and half of the times
  when it has just begun to write.
- `full disk`: no file may grow beyond a random size.
- `read-only`: the folder of its output cannot be written.
- `other disk`: its output is a link to a folder on another file system, in memory.
- `two at once`: another process does the same.
- `two containers`: each in a process namespace of its own, where both have the same number.

`notebook` interrupts `jc.identify` in a Jupyter kernel and calls it again; `workers` are those of
pytest-xdist, which compile into one new cache. Earlier files must be as they were, or the new ones.
No process is left behind, and no file unless by SIGKILL, or by SIGTERM of what is no command. Then
the program runs to its end, which must give the same results and leave nothing:

    python -m scripts.tools.kills --cases 1000 --jobs 16

It prints a table of faults. Rows go to `build/kills/rows.jsonl`; the next run goes on from there.
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
from jaxcslc._text_table import text_table
from scripts.studies import command
from scripts.studies.rows import Rows, made_of
from scripts.tools.fuzz.templates import write_servos


ROOT = Path(__file__).parents[2]
_OFF = 300.0  # seconds after which a run counts as hanging
_CODES_AFTER = {"SIGINT": (130, -signal.SIGINT), "SIGTERM": (130, -signal.SIGTERM)}
_FAULTS = (
    *("SIGKILL", "SIGINT", "SIGTERM", "full disk", "read-only", "other disk", "two at once"),
    "two containers",
)
_SHARES = (3, 3, 3, 3, 1, 1, 1, 1)
_ENDED = 60.0  # seconds after which processes of an ended program count as left
_NAMESPACE = ("--pid", "--fork", "--mount-proc", "--kill-child")
_MEMORY = Path("/dev/shm")  # another file system, where there is one

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
for name in ("log", "other"):
    jc.save_recording(jc.Recording(t[:, 0], q, torque), f"{name}.csv")
"""
RECORD = """
import sys
try:
    import sim

    machine, trajectory = sim.puma560(), sim.training(samples=600)
    jobs = [sim.Job(machine, trajectory, seed) for seed in range(6)]
    for i, result in sim.record_each(jobs, store="out", side_by_side=1):
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
rows = Rows(Path("out/rows.jsonl"), ("number",), "kills")

def study():
    for number in range(300):
        if (number,) not in rows:
            time.sleep(0.01)
            rows.add({"number": number, "value": number**2, "text": "x" * 5000})
    return 0

sys.exit(command.run(parser, study, rows.path))
"""
NOTEBOOK = """
import random, sys, time

CELLS = [
    "import jaxcslc as jc; jc.enable_x64()",
    "network = jc.derive(jc.load_robot('arm.toml'), lengths='numeric')",
    "recording, settings = jc.load_recording('log.csv'), jc.load_settings('settings.json')",
]
IDENTIFY = "jc.identify(network, recording, settings=settings).save('out/notebook')"

try:
    from jupyter_client.manager import start_new_kernel

    manager, client = start_new_kernel()

    def run(cell, moment=None):
        # A kernel whose cell failed refuses those that it was sent meanwhile, unless told not to.
        client.execute(cell, stop_on_error=False)
        if moment is not None:
            time.sleep(moment)
            manager.interrupt_kernel()
        return client.get_shell_msg(timeout=200)["content"]

    try:
        for cell in CELLS:
            run(cell)
        run(IDENTIFY, random.uniform(0.0, 4.0))
        last = run(IDENTIFY)
    finally:
        manager.shutdown_kernel()  # not at once, which is SIGKILL
    sys.exit(0 if last["status"] == "ok" else str(last))
except KeyboardInterrupt:
    sys.exit(130)
"""
WORKERS = """
import os, sys
from pathlib import Path

try:
    import pytest

    os.environ["XDG_CACHE_HOME"] = str(Path("out/cache").absolute())
    options = ["-q", "-n", "3", "-c", os.devnull, "-p", "no:cacheprovider"]
    code = pytest.main([*options, "--rootdir", ".", "test_fit.py"])
    sys.exit(130 if code == 2 else code)
except KeyboardInterrupt:
    sys.exit(130)
"""
TESTS = """
import json
from pathlib import Path

import pytest
import jaxcslc as jc

jc.enable_x64()


@pytest.mark.parametrize("number", range(6))
def test_fit(number):
    network = jc.derive(jc.load_robot("arm.toml"), lengths="numeric")
    settings = jc.load_settings("settings.json")
    fit = settings.fit(network, settings.patterns(jc.load_recording("log.csv")))
    Path(f"out/{number}.json").write_text(json.dumps({"k": fit.k.tolist()}))
"""


class Program(NamedTuple):
    """A program that is disturbed.

    **Attributes**

    - `line`: of the command.
    - `output`: files and folders that it writes, in its folder; it may go into a folder `out`.
    - `starts`: whether its earlier output is there when it starts; else only its input is.
    - `contents`: what is compared of a file of its output.
    - `is_command`: whether it is one of `jaxcslc`, which ends in one line.
    """

    line: list[str]
    output: tuple[str, ...]
    starts: bool
    contents: Callable[[Path], Any]
    is_command: bool = True


def _content_of(path: Path) -> Any:
    """What of a result is the same in every run; False of a file that is not whole."""
    text = path.read_bytes()
    if path.suffix == ".json":
        return json.loads(text).get("k", True)
    return text.endswith((b"\n", b"</html>"))


def _bytes_of(path: Path) -> Any:
    return path.read_bytes()


def _rows_of(path: Path) -> Any:
    """Rows of a study, which two at once may both have written."""
    rows = map(json.loads, path.read_text("utf-8").splitlines())
    return {row["number"]: row for row in rows}


def _command(*words: str, output: str = "out") -> Program:
    line = ["-c", "from jaxcslc.cli import main; main()", *words]
    return Program(line, (output,), True, _content_of)


_ARM = ("arm.toml", "results")
_LIMITED = ("--limits", "limits.toml", "--duration", "1", "--rate", "50", "--starts", "1")
_IDENTIFY = ("identify", "arm.toml", "log.csv", "--settings", "settings.json", "-o", "out/results")
PROGRAMS = {
    "compare": _command("compare", "results", "results", "-o", "out/page.html"),
    "derive": _command("derive", "arm.toml", "-o", "out/tables"),
    "example": _command("example", "ur5", "-o", "out/ur5"),
    "excite": _command("excite", "arm.toml", *_LIMITED, "-o", "out/motion.csv"),
    "export": _command("export", *_ARM, "-o", "out/arm.toml", "--force"),
    "export-c": _command("export", *_ARM, "--c", "-o", "out/arm.c", "--force"),
    "fleet": _command(
        *("identify", "arm.toml", "log.csv", "other.csv", "--settings", "settings.json"),
        *("--dask", "local", "--fleet", "-o", "out/fleet"),
    ),
    "identify": _command(*_IDENTIFY),
    "init": _command("init", "arm.toml", "log.csv", "--overwrite", output="jaxcslc.toml"),
    "notebook": Program(["-c", NOTEBOOK], ("out",), True, _content_of, is_command=False),
    "payload": _command(
        "payload", "arm.toml", "log.csv", "--previous", "results", "-o", "out/payload"
    ),
    "record": Program(["-c", RECORD], ("out",), False, _bytes_of, is_command=False),
    "servo": _command(
        *("identify", "servos.toml", "servos.csv", "--drive", "servo", "-o", "out/servo")
    ),
    "study": Program(["-c", STUDY], ("out",), False, _rows_of, is_command=False),
    "workers": Program(["-c", WORKERS], ("out",), False, _content_of, is_command=False),
}


class _Prepared(NamedTuple):
    """A folder in which all is ready for a program, its output after a run, and the run's time."""

    folder: Path
    whole: dict[str, Any]
    seconds: float


def main(arguments: Sequence[str] | None = None) -> int:
    """Disturbs the programs. **Returns** 1 if a case is wrong."""
    parser = command.new_parser(__doc__, "kills")
    parser.add_argument("programs", nargs="*", metavar="PROGRAM", help="by default all")
    parser.add_argument("--cases", type=int, default=1000, help="of all programs together")
    parser.add_argument("--jobs", type=int, default=2, help="programs at a time")
    parser.add_argument("--seed", type=int, default=0, help="of the cases")
    options = command.parse(parser, arguments, cases=22)
    command.require_least(parser, options, cases=1, jobs=1)
    command.require_some_of(parser, "program", options.programs, tuple(PROGRAMS))
    keys = ("seed", "program", "case")
    rows = Rows(options.output / "rows.jsonl", keys, made_of({}, [Path(__file__)]))
    names = options.programs or list(PROGRAMS)
    cases = [(names[number % len(names)], number) for number in range(options.cases)]

    def study() -> int:
        _run([case for case in cases if (options.seed, *case) not in rows], rows, options)
        return _report([row for row in rows.all() if row["seed"] == options.seed])

    return command.run(parser, study, rows.path, seconds=10.0 * options.cases / options.jobs)


def _run(cases: Sequence[tuple[str, int]], rows: Rows, options: argparse.Namespace) -> None:
    """All cases that have no row yet, in folders that are prepared once for each program."""
    with (
        tempfile.TemporaryDirectory() as folder,
        ThreadPoolExecutor(options.jobs) as pool,
        command.progress(desc="cases", total=len(cases), unit="case") as bar,
    ):
        made = Path(folder) / "made"
        made.mkdir()
        _make_input(made)
        names = sorted({name for name, _ in cases})
        ready = dict(zip(names, pool.map(lambda name: _prepare(name, made), names), strict=True))
        waiting = [
            pool.submit(_case, name, number, options.seed, ready[name], Path(folder))
            for name, number in cases
        ]
        try:
            for done in as_completed(waiting):
                rows.add(done.result())
                bar.update()
        finally:
            pool.shutdown(cancel_futures=True)


def _make_input(folder: Path) -> None:
    """Robot, log, settings, limits, an identification."""
    (folder / "arm.toml").write_text(ROBOT, encoding="utf-8")
    (folder / "settings.json").write_text(SETTINGS, encoding="utf-8")
    limits = "[joints]\nvelocity = 2.0\ntorque = 20.0\nposition = [[-1, 1], [-1, 1]]\n"
    (folder / "limits.toml").write_text(limits, encoding="utf-8")
    (folder / "test_fit.py").write_text(TESTS, encoding="utf-8")
    (folder / "out").mkdir()
    write_servos(folder)
    _finish(Program(["-c", MAKE], (), True, _bytes_of), folder)
    _finish(_command(*_IDENTIFY[:-1], "results"), folder)


def _prepare(name: str, made: Path) -> _Prepared:
    """A program's folder, with the output of a run if it starts with some."""
    program, folder = PROGRAMS[name], made.parent / f"prepared {name}"
    shutil.copytree(made, folder)
    start = time.monotonic()
    _finish(program, folder)
    seconds = time.monotonic() - start
    whole = _whole(program, folder)
    if not program.starts:
        shutil.rmtree(folder)
        shutil.copytree(made, folder)
    return _Prepared(folder, whole, seconds)


def _case(name: str, number: int, seed: int, prepared: _Prepared, folder: Path) -> dict[str, Any]:
    """Disturbs a program in a copy of its folder, and lets it run again."""
    draw = random.Random(f"{seed} {name} {number}")
    here = folder / f"{name} {number}"
    shutil.copytree(prepared.folder, here)
    fault = draw.choices(_FAULTS, _SHARES)[0]
    with contextlib.ExitStack() as undone:
        faults, left = _disturb(PROGRAMS[name], here, fault, draw, prepared, undone)
        try:
            _finish(PROGRAMS[name], here)
        except RuntimeError as error:
            faults.append(f"the next run fails: {error}")
        if _whole(PROGRAMS[name], here) != prepared.whole:
            faults.append("the next run has another result")
        if still := _hidden(here):
            faults.append(f"the next run left {', '.join(still)}")
    shutil.rmtree(here)
    row: dict[str, Any] = {"seed": seed, "program": name, "case": number, "fault": fault}
    return {**row, "left": left, "faults": faults}


def _disturb(
    program: Program,
    here: Path,
    fault: str,
    draw: random.Random,
    prepared: _Prepared,
    undone: contextlib.ExitStack,
) -> tuple[list[str], int]:
    """Runs a program with a fault.

    - `undone`: what the next run is without.

    **Returns** what is wrong, and how much is left behind.
    """
    if fault == "other disk" and _MEMORY.is_dir():
        other = Path(undone.enter_context(tempfile.TemporaryDirectory(dir=_MEMORY))) / "out"
        shutil.copytree(here / "out", other)
        shutil.rmtree(here / "out")
        (here / "out").symlink_to(other)
    before = {path: path.read_bytes() for path in _files(here)}
    limit = int(10 ** draw.uniform(1.0, 6.0)) if fault == "full disk" else None
    if fault == "read-only":
        for path in (here, here / "out"):
            path.chmod(0o555)
    alone = fault == "two containers"
    running = [_start(program, here, limit, obeys=fault == "read-only", alone=alone)]
    if fault in ("two at once", "two containers"):
        time.sleep(draw.uniform(0.0, 0.2))
        running.append(_start(program, here, alone=alone))
    if fault.startswith("SIG"):
        _wait(running[0], here, before, draw, prepared.seconds)
        running[0].send_signal(getattr(signal, fault))
    faults: list[str] = []
    for process in running:
        errors = _errors_of(process)
        if wrong := _wrong_end(program, process.returncode, errors, fault):
            faults.append(wrong)
    if fault == "read-only":
        for path in (here, here / "out"):
            path.chmod(0o755)
    faults += _damage(program, here, before, prepared.whole)
    if still := _still_running(here):
        faults.append(f"{fault} left processes: {', '.join(still)}")
    left = _hidden(here)
    # A library's own process is ended by SIGTERM as by SIGKILL: only commands handle it.
    if left and fault != "SIGKILL" and (program.is_command or fault != "SIGTERM"):
        faults.append(f"{fault} left {', '.join(left)}")
    return faults, len(left)


def _errors_of(process: "subprocess.Popen[str]") -> str:
    try:
        return process.communicate(timeout=_OFF)[1]
    except subprocess.TimeoutExpired:
        process.kill()
        return f"{process.communicate()[1]}\nhangs"


def _wrong_end(program: Program, code: int, errors: str, fault: str) -> str | None:
    """What is wrong with how a process ended; None if nothing is."""
    last = (errors.strip().splitlines() or [""])[-1][:200]
    # Python's own start, before the first line of a program, has a traceback of its own.
    starting = "Traceback" in errors and 'File "<string>"' not in errors
    if errors.endswith("hangs"):
        return f"hangs after {fault}"
    if code == 0 or fault == "SIGKILL" or starting:
        return None
    if fault in _CODES_AFTER:
        expected = _CODES_AFTER[fault] if program.is_command else (*_CODES_AFTER[fault], -15)
        if code not in expected:
            return f"exit code {code} after {fault}: {last}"
        return f"traceback after {fault}: {last}" if "Traceback" in errors else None
    if fault in ("full disk", "read-only"):
        if program.is_command and (code != 2 or len(errors.strip().splitlines()) != 1):
            return f"exit code {code} of {fault}: {last}"
        return None
    return f"exit code {code} of {fault}: {last}"


def _wait(
    process: "subprocess.Popen[str]",
    here: Path,
    before: dict[Path, bytes],
    draw: random.Random,
    seconds: float,
) -> None:
    """Waits for a random moment, or until a program writes and a moment longer."""
    start, end = time.monotonic(), draw.uniform(0.0, seconds)
    writing = draw.random() < 0.5
    while process.poll() is None and time.monotonic() - start < (_OFF if writing else end):
        if writing and any(path not in before for path in _files(here)):
            time.sleep(draw.choice((0.0, 0.001, 0.01, 0.1, 0.3)) * draw.random())
            break
        time.sleep(0.001)


def _damage(
    program: Program, here: Path, before: dict[Path, bytes], whole: dict[str, Any]
) -> list[str]:
    """Files of before that are gone, or are neither as they were nor the new ones."""
    faults: list[str] = []
    for path, data in before.items():
        if not path.is_file():
            faults.append(f"{path.name} is gone")
        elif path.name == MARKER or path.read_bytes() == data:
            continue
        elif not _is_whole(program, here, path, whole):
            faults.append(f"{path.name} is damaged")
    return faults


def _is_whole(program: Program, here: Path, path: Path, whole: dict[str, Any]) -> bool:
    try:
        return program.contents(path) == whole.get(str(path.relative_to(here)))
    except ValueError:
        return False


def _still_running(folder: Path) -> list[str]:
    """Names of processes that work in a folder and do not end, where that can be known."""
    end, names = time.monotonic() + _ENDED, [""]
    while names and time.monotonic() < end:
        names = []
        for process in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                if (process / "cwd").readlink() == folder:
                    names.append((process / "comm").read_text().strip())
        time.sleep(0.1)
    return names


def _start(
    program: Program,
    folder: Path,
    limit: int | None = None,
    *,
    obeys: bool = False,
    alone: bool = False,
) -> "subprocess.Popen[str]":
    """Starts a program.

    - `limit`: of the size of files [bytes].
    - `obeys`: whether it has no right of a superuser to write everywhere.
    - `alone`: whether it sees no process but its own, where the system allows it.
    """
    line = [sys.executable, *program.line]
    if alone and os.geteuid() == 0 and (unshare := shutil.which("unshare")):
        line = [unshare, *_NAMESPACE, *line]
    if obeys and os.geteuid() == 0 and (setpriv := shutil.which("setpriv")):
        line = [setpriv, "--bounding-set=-dac_override", "--inh-caps=-dac_override", *line]
    if limit is not None:
        line = ["sh", "-c", f'ulimit -f {max(limit // 512, 1)}; exec "$@"', "sh", *line]
    return subprocess.Popen(
        line,
        cwd=folder,
        env=_environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def _finish(program: Program, folder: Path) -> None:
    """**Raises** `RuntimeError` if the program fails."""
    process = _start(program, folder)
    errors = _errors_of(process)
    if process.returncode:
        raise RuntimeError(f"exit code {process.returncode}: {errors[-1000:]}")


def _environment() -> dict[str, str]:
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    return {**os.environ, "PYTHONPATH": path, "JAX_DISABLE_MOST_OPTIMIZATIONS": "true"}


def _files(folder: Path) -> list[Path]:
    """What is there at this moment; a program may be removing files meanwhile."""
    with contextlib.suppress(FileNotFoundError):
        roots = [folder, *(path for path in folder.iterdir() if path.is_symlink())]
        return sorted(path for root in roots for path in root.rglob("*") if path.is_file())
    return []


def _hidden(folder: Path) -> list[str]:
    names = {path.name for root in (folder, folder / "out") for path in root.rglob(".*")}
    return sorted(names - {MARKER})


def _whole(program: Program, folder: Path) -> dict[str, Any]:
    """The output of a finished run, by name."""
    files = [path for path in _files(folder) if path.relative_to(folder).parts[0] in program.output]
    return {
        str(path.relative_to(folder)): program.contents(path)
        for path in files
        if path.name != MARKER
    }


def _report(rows: Sequence[dict[str, Any]]) -> int:
    """Prints what is wrong, and a table of programs and faults."""
    for row in rows:
        for fault in row["faults"]:
            print(f"{row['program']}, case {row['case']}, {row['fault']}: {fault}")
    table: list[list[str]] = []
    for name in [*PROGRAMS, "all"]:
        some = [row for row in rows if name in (row["program"], "all")]
        counts = [sum(row["fault"] == fault for row in some) for fault in _FAULTS]
        left = sum(row["left"] > 0 for row in some)
        wrong = sum(bool(row["faults"]) for row in some)
        if some:
            table.append([name, *map(str, (*counts, left, wrong))])
    print(text_table(["program", *_FAULTS, "left to the next run", "wrong"], table))
    return int(any(row["faults"] for row in rows))


if __name__ == "__main__":
    sys.exit(main())
