"""Runs a case in this process, and says what is wrong with how the command ended."""

import contextlib
import ctypes
import json
import os
import re
import shutil
import tempfile
import time
import traceback
import warnings
from collections.abc import Generator
from pathlib import Path
from typing import Any

from jaxcslc._scratch import MARKER
from scripts.tools.fuzz.cases import case
from scripts.tools.invoke import Result, invoke


MOST_SECONDS, MOST_MEMORY = 10.0, 3 << 30
"""That a case may take [s], and need in addition to what its process has before [bytes]."""

_NOT_FINITE = re.compile(r"(?<![\w.'\"-])[-+]?(nan|inf|infinity)(?![\w'\"])", re.IGNORECASE)

Row = dict[str, Any]


def run_case(number: int, templates: Path, folder: Path, seed: int = 0) -> Row:
    """Makes the case of a number in an emptied folder, and runs its lines.

    **Returns** its number, kind, the exit code of the last line, seconds of the longest, the
    largest memory [MB] and, where something is wrong, `fault`: what, with the command's last words.
    """
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    example = case(number, templates, folder, seed)
    row: Row = {"seed": seed, "case": number, "kind": example.kind, "code": 0, "fault": None}
    longest, largest = 0.0, 0
    for line in example.lines:
        row["code"], seconds, memory, row["fault"] = _run_line(line, folder)
        longest, largest = max(longest, seconds), max(largest, memory)
        if row["code"] or row["fault"]:
            break
    return {**row, "seconds": round(longest, 3), "memory": largest >> 20}


def _run_line(line: list[str], folder: Path) -> tuple[int, float, int, str | None]:
    """Runs a command: its exit code, its seconds, its memory [bytes], and what is wrong."""
    before = {path: path.read_bytes() for path in _files(folder)}
    here = _memory(reset=True)
    start, worked = time.monotonic(), time.process_time()
    with _in(folder), warnings.catch_warnings(), _library_output() as printed:
        warnings.filterwarnings("ignore", category=RuntimeWarning)  # as the command itself does
        result = invoke(*line)
    # The lesser: threads work side by side, and others may keep the machine busy.
    seconds = min(time.monotonic() - start, time.process_time() - worked)
    memory = max(_memory() - here, 0)
    fault = _fault(line, result, folder, before, seconds)
    if fault is None and printed:
        fault = f"a library printed {printed[0][-300:]!r}"
    if fault is None and memory > MOST_MEMORY:
        fault = f"took {memory >> 20} MB"
    return result.exit_code, seconds, memory, fault


def _memory(*, reset: bool = False) -> int:
    """The largest memory of this process, since it was reset [bytes]."""
    process = Path("/proc/self")
    if not process.exists():
        return 0
    if reset:
        (process / "clear_refs").write_text("5")
    (peak,) = re.findall(r"VmHWM:\s*(\d+) kB", (process / "status").read_text())
    return 1024 * int(peak)


def _fault(
    line: list[str], result: Result, folder: Path, before: dict[Path, bytes], seconds: float
) -> str | None:
    """What is wrong with how a command ended; None if nothing is."""
    error = result.exception
    if error is not None:
        last = traceback.extract_tb(error.__traceback__)[-1]
        at = f"{Path(last.filename).name}, line {last.lineno}"
        return f"traceback: {type(error).__name__}: {' '.join(str(error).split())[:300]} ({at})"
    looks_wrong = result.exit_code == 1 and line[:1] == ["check"]
    if result.exit_code not in (0, 2) and not looks_wrong:
        return f"exit code {result.exit_code}: {result.output[-300:]}"
    if seconds > MOST_SECONDS:
        return f"took {seconds:.1f} s"
    if _CONTROLS.search(result.output):
        return f"printed what a terminal obeys: {result.output[-300:]!r}"
    lines = [line for line in result.stderr.splitlines() if line.strip()]
    if result.exit_code == 2:
        if len(lines) != 1 or not lines[0].startswith("jaxcslc: "):
            return f"expected one line, got {result.stderr[-500:]!r}"
        if result.stdout.strip():
            return f"printed before it failed: {result.stdout[-300:]!r}"
    elif [text for text in lines if not text.startswith("note: ") and " s so far" not in text]:
        return f"succeeded, but standard error has {result.stderr[-300:]!r}"
    new = [path for path in _files(folder) if path not in before]
    return _fault_of_files(line, result, folder, before, new)


def _fault_of_files(
    line: list[str],
    result: Result,
    folder: Path,
    before: dict[Path, bytes],
    new: list[Path],
) -> str | None:
    changed = [path for path, data in before.items() if _content(path) != data]
    own = [path for path in changed if path.name == MARKER or _is_listed(path, before)]
    if line[:1] == ["init"] and "--overwrite" in line:
        own += [path for path in changed if path.name == "jaxcslc.toml"]
    if lost := [path for path in changed if path not in own]:
        return f"changed its input {lost[0].name}"
    if result.exit_code == 2:
        if new or own:
            names = [str(path.relative_to(folder)) for path in (*new, *own)]
            return f"failed, and left {', '.join(names)}"
        return None
    if hidden := [path for path in new if path.name.startswith(".") and path.name != MARKER]:
        return f"left {hidden[0].name}"
    text = re.sub("(?m)^With jaxcslc.toml, this is: .*$", "", result.stdout)  # options as they are
    if found := _NOT_FINITE.search(text):
        return f"printed {found[0]}: {text[max(found.start() - 150, 0) :][:300]!r}"
    for path in (*new, *own):
        if found := _not_finite(path):
            return f"wrote {found} into {path.name}"
    return None


# As `printable` escapes them, by their classes.
_CONTROLS = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


def _is_listed(path: Path, before: dict[Path, bytes]) -> bool:
    """Whether a file is an output of an earlier line, which a later one may replace."""
    marker = before.get(path.parent / MARKER)
    return marker is not None and path.name in json.loads(marker)["files"]


def _not_finite(path: Path) -> str | None:
    """What of a file that was written is no finite number."""
    text = path.read_bytes().decode("utf-8", "replace")
    if path.suffix == ".json":
        found: list[str] = []
        json.loads(text, parse_constant=found.append)
        return found[0] if found else None
    if path.suffix in (".csv", ".c", ".h", ".toml", ".urdf", ".xml", ".yaml"):
        match = _NOT_FINITE.search(text)
        return None if match is None else match[0]
    return None


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
