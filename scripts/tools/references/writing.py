"""Runs the commands of references, and keeps what they write and print."""

import json
import os
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from scripts.tools.references.commands import REFERENCES, Reference


ROOT = Path(__file__).resolve().parents[3]
DATA = ROOT.parent / "shared" / "data"
_WRITER = Path(__file__).with_name("inputs.py")
_INPUTS = "inputs"
_ABOUT = "about.json"


def write(
    folder: Path,
    *,
    code: Path = ROOT,
    only: Sequence[str] = (),
    inputs: Path | None = None,
    data: Path = DATA,
) -> int:
    """Write references, each into a folder of its name that it replaces.

    **Arguments**

    - `code`: the tree whose `jaxcslc` runs.
    - `only`: names; all references by default.
    - `inputs`: another set, whose inputs are used; those that the code simulates by default.
    - `data`: folder of real recordings.

    **Returns** 1 if a command failed.
    """
    environment = _environment(code)
    about: dict[str, Any] = {"code": str(code), "commit": _commit(code), "seconds": {}}
    folder.mkdir(parents=True, exist_ok=True)
    if inputs is None:
        shutil.rmtree(folder / _INPUTS, ignore_errors=True)
        # -P, so that the folder of this file is no place of modules.
        line = [sys.executable, "-P", str(_WRITER), str(folder / _INPUTS), "--data", str(data)]
        subprocess.run(line, env=environment, check=True)
    elif inputs.resolve() != folder.resolve():
        shutil.rmtree(folder / _INPUTS, ignore_errors=True)
        shutil.copytree(inputs / _INPUTS, folder / _INPUTS)
    failed = False
    for reference in REFERENCES:
        if only and reference.name not in only:
            continue
        if reference.real and not (folder / _INPUTS / reference.real).is_dir():
            print(f"{reference.name}: left out, for there is no {data / reference.real}")
            continue
        start = time.monotonic()
        problems = list(_run(reference, folder / reference.name, environment))
        about["seconds"][reference.name] = round(time.monotonic() - start, 1)
        print(f"{reference.name}: {about['seconds'][reference.name]} s", flush=True)
        for problem in problems:
            print(f"  {problem}")
        failed = failed or bool(problems)
    (folder / _ABOUT).write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")
    return int(failed)


def _environment(code: Path) -> dict[str, str]:
    """Variables under which the code of a tree is run.

    **Raises** `ValueError` if another tree's code would run.
    """
    environment = {**os.environ, "PYTHONPATH": str(code.resolve()), "COLUMNS": "100"}
    line = [sys.executable, "-P", "-c", "import jaxcslc; print(jaxcslc.__file__)"]
    result = subprocess.run(line, env=environment, capture_output=True, text=True)
    file = result.stdout.strip()
    if not file or not Path(file).is_relative_to(code.resolve()):
        raise ValueError(f"{code}: its jaxcslc does not run, but {file or result.stderr}")
    return environment


def _commit(code: Path) -> str:
    line = ["git", "-C", str(code), "describe", "--always", "--dirty"]
    return subprocess.run(line, capture_output=True, text=True).stdout.strip()


def _run(reference: Reference, folder: Path, environment: Mapping[str, str]) -> Iterator[str]:
    """Runs the commands of a reference, and keeps what they print; yields what fails."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for number, text in enumerate(reference.commands, start=1):
        name = text.partition(" ")[0]
        line = [sys.executable, "-P", "-m", "jaxcslc", *shlex.split(text)]
        result = subprocess.run(line, cwd=folder, env=environment, capture_output=True, text=True)
        printed = f"{result.stdout}\nexit status {result.returncode}\n"
        (folder / f"{number}_{name}.txt").write_text(printed, encoding="utf-8")
        # 1 of a check: something looks wrong with a recording.
        if result.returncode not in ((0, 1) if name == "check" else (0,)):
            last = (result.stderr.strip().splitlines() or ["no message"])[-1]
            yield f"{name} ended with {result.returncode}: {last}"
