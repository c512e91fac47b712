"""Runs a case in this process, and says what is wrong with how the command ended."""

import contextlib
import ctypes
import os
import shutil
import tempfile
import time
import traceback
import warnings
from collections.abc import Generator
from pathlib import Path
from typing import Any

from jaxcslc._scratch import MARKER
from scripts.tools.fuzz.cases import Case, case
from scripts.tools.invoke import Result, invoke


MOST_SECONDS = 10.0

Row = dict[str, Any]


def run_case(number: int, templates: Path, folder: Path) -> Row:
    """Makes the case of a number in an emptied folder, and runs it.

    **Returns** its number, kind, exit code, seconds and, where something is wrong, `fault`: what,
    with the command's last words.
    """
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    example = case(number, templates, folder)
    before = {path: path.read_bytes() for path in _files(folder)}
    start, worked = time.monotonic(), time.process_time()
    with _in(folder), warnings.catch_warnings(), _library_output() as printed:
        warnings.filterwarnings("ignore", category=RuntimeWarning)  # as the command itself does
        result = invoke(*example.arguments)
    # The lesser: threads work side by side, and others may keep the machine busy.
    seconds = min(time.monotonic() - start, time.process_time() - worked)
    fault = _fault(example, result, folder, before, seconds)
    if fault is None and printed:
        fault = f"a library printed {printed[0][-300:]!r}"
    return {
        "case": number,
        "kind": example.kind,
        "code": result.exit_code,
        "seconds": round(seconds, 3),
        "fault": fault,
    }


def _fault(
    example: Case, result: Result, folder: Path, before: dict[Path, bytes], seconds: float
) -> str | None:
    """What is wrong with how a command ended; None if nothing is."""
    error = result.exception
    if error is not None:
        last = traceback.extract_tb(error.__traceback__)[-1]
        at = f"{Path(last.filename).name}, line {last.lineno}"
        return f"traceback: {type(error).__name__}: {' '.join(str(error).split())[:300]} ({at})"
    looks_wrong = result.exit_code == 1 and example.arguments[:1] == ["check"]
    if result.exit_code not in (0, 2) and not looks_wrong:
        return f"exit code {result.exit_code}: {result.output[-300:]}"
    if seconds > MOST_SECONDS:
        return f"took {seconds:.1f} s: {' '.join(example.arguments)}"
    lines = [line for line in result.stderr.splitlines() if line.strip()]
    if result.exit_code == 2:
        if len(lines) != 1 or not lines[0].startswith("jaxcslc: "):
            return f"expected one line, got {result.stderr[-500:]!r}"
        if result.stdout.strip():
            return f"printed before it failed: {result.stdout[-300:]!r}"
    if result.exit_code != 2 and lines:
        return f"succeeded, but standard error has {result.stderr[-300:]!r}"
    changed = [path for path, data in before.items() if _content(path) != data]
    if changed:
        return f"changed its input {changed[0].name}"
    new = [path for path in _files(folder) if path not in before]
    if result.exit_code == 2 and new:
        return f"failed, and left {', '.join(str(path.relative_to(folder)) for path in new)}"
    hidden = [path for path in new if path.name.startswith(".") and path.name != MARKER]
    return f"left {hidden[0].name}" if hidden else None


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def _content(path: Path) -> bytes | None:
    return path.read_bytes() if path.is_file() else None


@contextlib.contextmanager
def _library_output() -> Generator[list[str]]:
    """What libraries in C and Fortran print, past Python's streams; empty if nothing."""
    printed: list[str] = []
    library = ctypes.CDLL(None)
    library.fflush(None)
    before = [os.dup(stream) for stream in (1, 2)]
    with tempfile.TemporaryFile() as file:
        for stream in (1, 2):
            os.dup2(file.fileno(), stream)
        try:
            yield printed
        finally:
            library.fflush(None)
            for stream, copy in zip((1, 2), before, strict=True):
                os.dup2(copy, stream)
                os.close(copy)
            file.seek(0)
            if text := file.read().decode(errors="replace").strip():
                printed.append(text)


@contextlib.contextmanager
def _in(folder: Path) -> Generator[None]:
    with contextlib.chdir(folder):
        yield
