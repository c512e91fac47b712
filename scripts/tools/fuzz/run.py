"""A fuzzer of the command: mutated robots, recordings, settings, results, names, command lines.

Every case follows from its number and the seed. It runs one or more commands in a process of its
own kind. Each must end within ten seconds and 3 GB, with a result or with one line that says what
is wrong, leave no partial output, and call no NaN a result:

    python -m scripts.tools.fuzz.run --cases 50000 --jobs 64 --seed 1

It prints a table of outcomes. Rows go to `build/fuzz/rows.jsonl`, and the next run goes on from
there; rows of other code do not count. Files and command lines of cases that are wrong go to
`build/fuzz/wrong`. One case again, with its files:

    python -m scripts.tools.fuzz.run --case 1234 --seed 1
"""

import argparse
import multiprocessing
import os
import shlex
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import jaxcslc as jc
from jaxcslc._text_table import text_table
from scripts.studies import command
from scripts.studies.rows import Rows, made_of


# A case is ended after so much time of the processor [s], so that a busy machine ends none; and
# after so much time by the clock [s], since one that waits for itself uses no processor.
_WORKS, _HANGS = 60.0, 600.0
# Time of the processor that a case takes on average [s], by 42,291 cases of one process.
_A_CASE = 0.042
_FOLDER = Path(__file__).parent

Row = dict[str, Any]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the fuzzer. **Returns** 1 if a case is wrong."""
    parser = command.new_parser(__doc__, "fuzz")
    parser.add_argument("--cases", type=int, default=10_000, help="numbers from 0 up to this")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--seed", type=int, default=0, help="of the cases")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="to stop after")
    parser.add_argument("--case", type=int, help="run this case alone, and show everything")
    options = command.parse(parser, arguments, cases=200, jobs=1)
    command.require_least(parser, options, cases=1, jobs=1, seconds=1)
    options.output.mkdir(parents=True, exist_ok=True)
    if options.case is not None:
        return _show(options.case, options.seed, options.output)
    code = sorted(path for path in _FOLDER.glob("*.py") if path.name != "run.py")
    rows = Rows(options.output / "rows.jsonl", ("seed", "case"), made_of({}, code))
    numbers = [number for number in range(options.cases) if (options.seed, number) not in rows]

    def fuzz() -> int:
        _run(numbers, rows, options)
        return _report(rows, options)

    seconds = min(options.seconds, _A_CASE * len(numbers) / min(options.jobs, 2))
    return command.run(parser, fuzz, rows.path, seconds=seconds)


def _run(numbers: Sequence[int], rows: Rows, options: argparse.Namespace) -> None:
    """Gives numbers to worker processes; a case that ends its process is a row like any other."""
    end = time.monotonic() + options.seconds
    remaining = iter(numbers)
    with (
        tempfile.TemporaryDirectory() as name,
        command.progress(desc="cases", total=len(numbers), unit="case") as bar,
    ):
        templates = Path(name) / "templates"
        running = [
            _Worker(i, options.seed, templates, Path(name) / f"worker {i}")
            for i in range(options.jobs)
        ]
        running[0].make_templates()
        try:
            while running:
                for worker in list(running):
                    if worker.number is None and not worker.start_next(remaining, end):
                        worker.stop()
                        running.remove(worker)
                wait([worker.connection for worker in running], timeout=1.0)
                for worker in running:
                    row = worker.row()
                    if row is not None:
                        rows.add(row)
                        bar.update()
                        if row["fault"]:
                            _keep(row, templates, options.output)
        finally:
            for worker in running:
                worker.stop()


class _Worker:
    """A process that runs one case at a time, and another one when it ended."""

    def __init__(self, index: int, seed: int, templates: Path, folder: Path) -> None:
        self.index, self.seed, self.templates, self.folder = index, seed, templates, folder
        self.number: int | None = None
        self.since = self.worked = 0.0
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, other = context.Pipe()
        self.process = context.Process(
            target=_work, args=(other, self.index, self.seed, self.templates, self.folder)
        )
        self.process.start()
        other.close()

    def make_templates(self) -> None:
        """**Raises** `RuntimeError` if that fails."""
        self.connection.send(None)
        if self.connection.recv() is not True:
            raise RuntimeError("the templates could not be made")

    def start_next(self, numbers: Any, end: float) -> bool:
        number = next(numbers, None) if time.monotonic() < end else None
        if number is None:
            return False
        self.number, self.since = number, time.monotonic()
        self.worked = self._processor_time()
        self.connection.send(number)
        return True

    def row(self) -> Row | None:
        """The row of the current case, once it ended or has to be ended."""
        number, fault = self.number, None
        try:
            if self.connection.poll():
                row = self.connection.recv()
                self.number = None
                return row
        except EOFError:
            self.process.join()
            fault = f"ended its process, exit code {self.process.exitcode}"
        waited = time.monotonic() - self.since
        worked = max(self._processor_time() - self.worked, 0.0)
        if fault is None and (worked > _WORKS or waited > _HANGS):
            fault = f"took more than {worked:.0f} s of the processor, {waited:.0f} s by the clock"
        if fault is None:
            return None
        self.process.kill()
        self.process.join()
        self.number = None
        self._start()
        from scripts.tools.fuzz.cases import kind_of

        row = {"seed": self.seed, "case": number, "kind": kind_of(number or 0, self.seed)}
        return {**row, "code": None, "seconds": worked, "memory": 0, "fault": fault}

    def _processor_time(self) -> float:
        """Return the time that the process and its threads used so far [s]; 0 where unknown."""
        try:
            words = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return 0.0
        return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")

    def stop(self) -> None:
        self.process.kill()
        self.process.join()


def _work(connection: Connection, index: int, seed: int, templates: Path, folder: Path) -> None:
    """What a worker process does: a row for every number that it is sent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends it
    if hasattr(os, "sched_setaffinity"):  # one core each: libraries start as many threads as cores
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[index % len(cores)]})
    _quick_compilation()
    from scripts.tools.fuzz.templates import write_templates
    from scripts.tools.fuzz.verdict import run_case

    limited = False
    while True:
        number = connection.recv()
        if number is None:
            templates.mkdir()
            write_templates(templates)
            connection.send(True)
        else:
            if not limited:
                limited = _limit_memory()
            connection.send(run_case(number, templates, folder, seed))


def _limit_memory() -> bool:
    """Memory that a case may allocate beyond what libraries map as they start."""
    import resource

    from scripts.tools.fuzz.verdict import MOST_MEMORY

    mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    # What is mapped and not used does not count: as much again, for pools and stacks of threads.
    most = 2 * mapped + 2 * MOST_MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    return True


def _quick_compilation() -> None:
    import jax

    # As the command itself does, but for programs that are compiled more often than run.
    jc.enable_x64()
    command.keep_compiled()
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    command.compile_quickly()


def _show(number: int, seed: int, output: Path) -> int:
    """Runs one case, and keeps its files."""
    _quick_compilation()
    from scripts.tools.fuzz.templates import write_templates
    from scripts.tools.fuzz.verdict import run_case

    with tempfile.TemporaryDirectory() as name:
        templates = Path(name) / "templates"
        templates.mkdir()
        write_templates(templates)
        row = run_case(number, templates, Path(name) / "case", seed)
        folder = _keep(row, templates, output)
    print(f"{(folder / 'case.txt').read_text('utf-8')}its files are in {folder}")
    return int(row["fault"] is not None)


def _keep(row: Row, templates: Path, output: Path) -> Path:
    """Writes the files of a case and of the templates that it names, and what was wrong."""
    from scripts.tools.fuzz.cases import case

    folder = output.absolute() / "wrong" / f"{row['seed']} {row['case']}"
    shutil.rmtree(folder, ignore_errors=True)
    here, source = folder / "case", folder / "templates"
    here.mkdir(parents=True)
    shutil.copytree(templates, source)
    lines = [
        shlex.join(["jaxcslc", *line]) for line in case(row["case"], source, here, row["seed"])[2]
    ]
    text = "\n".join([*lines, "", f"{row['kind']}: {row['fault']}", ""])
    (folder / "case.txt").write_text(text, encoding="utf-8", errors="backslashreplace")
    return folder


def _report(rows: Rows, options: argparse.Namespace) -> int:
    """Prints a table of outcomes, and what is wrong."""
    done = [
        row for row in rows.all() if row["seed"] == options.seed and row["case"] < options.cases
    ]
    done.sort(key=lambda row: row["case"])
    wrong = [row for row in done if row["fault"]]
    for row in wrong:
        print(f"case {row['case']} ({row['kind']}): {row['fault']}")
    kinds = sorted({row["kind"] for row in done})
    table: list[list[str]] = []
    for kind in (*kinds, "all"):
        some = [row for row in done if kind in (row["kind"], "all")]
        counts = Counter(
            "wrong" if row["fault"] else _OUTCOMES.get(row["code"], "") for row in some
        )
        numbers = [len(some), *(counts[name] for name in (*_OUTCOMES.values(), "wrong"))]
        most = [max((row[name] for row in some), default=0) for name in ("seconds", "memory")]
        table.append([kind, *map(str, numbers), f"{most[0]:.1f}", f"{most[1]:.0f}"])
    header = ["kind", "cases", *_OUTCOMES.values(), "wrong", "longest [s]", "most [MB]"]
    print(text_table(header, table))
    if wrong:
        print(f"files of what is wrong: {options.output / 'wrong'}")
    return int(bool(wrong))


_OUTCOMES = {0: "result", 1: "findings", 2: "one line"}


if __name__ == "__main__":
    sys.exit(main())
