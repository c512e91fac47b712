"""A fuzzer of the command: mutated robots, recordings, settings, results and command lines.

Every case follows from its number. It runs the command in this process and must end within ten
seconds, with a result or with one line that says what is wrong, and leave no partial output:

    python -m scripts.tools.fuzz.run --cases 10000 --workers 2

Rows go to `build/fuzz/rows.jsonl`, and the next run goes on from there; rows of other code do not
count. One case again, with its files and all that it prints:

    python -m scripts.tools.fuzz.run --case 1234
"""

import multiprocessing
import shlex
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
from scripts.studies import command
from scripts.studies.rows import Rows, made_of


_HANGS = 60.0  # seconds after which a case is ended
_FOLDER = Path(__file__).parent

Row = dict[str, Any]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the fuzzer. **Returns** 1 if a case is wrong."""
    parser = command.new_parser(__doc__, "fuzz")
    parser.add_argument("--cases", type=int, default=10_000, help="numbers from 0 up to this")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--seconds", type=float, default=600.0, help="to stop after")
    parser.add_argument("--case", type=int, help="run this case alone, and show everything")
    options = command.parse(parser, arguments, cases=200, workers=1)
    command.require_least(parser, options, cases=1, workers=1, seconds=1)
    if options.case is not None:
        return _show(options.case, options.output)
    code = sorted(path for path in _FOLDER.glob("*.py") if path.name != "run.py")
    rows = Rows(options.output / "rows.jsonl", ("case",), made_of({}, code))
    numbers = [number for number in range(options.cases) if (number,) not in rows]

    def fuzz() -> int:
        _run(numbers, rows, options.workers, options.seconds, options.output)
        return _report(rows, options.cases)

    return command.run(parser, fuzz, rows.path, seconds=min(options.seconds, 0.1 * len(numbers)))


def _run(numbers: Sequence[int], rows: Rows, workers: int, seconds: float, output: Path) -> None:
    """Gives numbers to worker processes; a case that ends its process is a row like any other."""
    end = time.monotonic() + seconds
    remaining = iter(numbers)
    with (
        tempfile.TemporaryDirectory() as name,
        command.progress(desc="cases", total=len(numbers), unit="case") as bar,
    ):
        templates = Path(name) / "templates"
        running = [_Worker(templates, Path(name) / str(i)) for i in range(workers)]
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
        finally:
            for worker in running:
                worker.stop()


class _Worker:
    """A process that runs one case at a time, and another one when it ended."""

    def __init__(self, templates: Path, folder: Path) -> None:
        self.templates, self.folder = templates, folder
        self.number: int | None = None
        self.since = 0.0
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, other = context.Pipe()
        self.process = context.Process(
            target=_work, args=(other, self.templates, self.folder), daemon=True
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
        if fault is None and time.monotonic() - self.since > _HANGS:
            self.process.kill()
            fault = f"took more than {_HANGS:g} s"
        if fault is None:
            return None
        self.number = None
        self._start()
        return {"case": number, "kind": "?", "code": None, "seconds": _HANGS, "fault": fault}

    def stop(self) -> None:
        self.process.kill()
        self.process.join()


def _work(connection: Connection, templates: Path, folder: Path) -> None:
    """What a worker process does: a row for every number that it is sent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends it
    _quick_compilation()
    from scripts.tools.fuzz.templates import write_templates
    from scripts.tools.fuzz.verdict import run_case

    while True:
        number = connection.recv()
        if number is None:
            templates.mkdir()
            write_templates(templates)
            connection.send(True)
        else:
            connection.send(run_case(number, templates, folder))


def _quick_compilation() -> None:
    import jax

    # As the command itself does, but for programs that are compiled more often than run.
    jc.enable_x64()
    command.keep_compiled()
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    command.compile_quickly()


def _show(number: int, output: Path) -> int:
    """Runs one case, and keeps its files."""
    _quick_compilation()
    from scripts.tools.fuzz.cases import case
    from scripts.tools.fuzz.templates import write_templates
    from scripts.tools.fuzz.verdict import run_case

    folder = output.absolute() / f"case {number}"
    with tempfile.TemporaryDirectory() as name:
        write_templates(Path(name))
        row = run_case(number, Path(name), folder)
        again = Path(name) / "again"
        again.mkdir()
        line = shlex.join(case(number, Path(name), again).arguments)
    line = line.replace(str(again), str(folder))
    print(f"jaxcslc {line}\n{row}\nits files are in {folder}")
    return int(row["fault"] is not None)


def _report(rows: Rows, cases: int) -> int:
    done = sorted((row for row in rows.all() if row["case"] < cases), key=lambda row: row["case"])
    wrong = [row for row in done if row["fault"]]
    for row in wrong:
        print(f"case {row['case']} ({row['kind']}): {row['fault']}")
    slowest = max(done, key=lambda row: row["seconds"], default=None)
    kinds = Counter(row["kind"] for row in done)
    good = sum(row["code"] == 0 for row in done)
    print(
        f"{len(done)} cases ({', '.join(f'{kinds[kind]} {kind}' for kind in sorted(kinds))}):"
        f" {good} with a result, {len(done) - good} with an error line, {len(wrong)} wrong"
    )
    if slowest:
        print(f"slowest: case {slowest['case']}, {slowest['seconds']:.1f} s")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
