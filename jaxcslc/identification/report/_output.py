import contextlib
import csv
import json
import math
import os
from collections.abc import Generator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Array

from ..._scratch import scratch_folder


def check_output_folder(folder: Path) -> None:
    """**Raises** `ValueError` if the results cannot go there: a file, or no right to write."""
    for path in (folder, *folder.absolute().parents):
        if path.exists():
            if not path.is_dir():
                raise ValueError(f"{path}: expected a folder for the results, this is a file")
            if not os.access(path, os.W_OK | os.X_OK):
                raise ValueError(f"{path}: expected a folder that can be written to")
            return


@contextlib.contextmanager
def all_or_nothing(folder: Path) -> Generator[Path]:
    """A scratch folder whose files move into `folder` when all of them are written.

    If writing fails, the files of `folder` stay as they were. Files of other names are not touched.
    What a process that was killed left behind is removed.

    **Raises** as `check_output_folder`.
    """
    check_output_folder(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with scratch_folder(folder.parent, folder.name) as scratch:
        yield scratch
        folder.mkdir(exist_ok=True)
        for path in sorted(scratch.iterdir()):
            os.replace(path, folder / path.name)


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Rows as CSV, numbers in full precision."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """A document as JSON; numbers that JSON cannot represent become null."""
    path.write_text(_text(document, "\n") + "\n", encoding="utf-8")


def _text(value: Any, line: str) -> str:
    """A value as `json.dumps` writes it with an indent of 2, which is slow for many numbers.

    - `line`: the end of a line, and the indent of the next one.
    """
    inner = line + "  "
    if isinstance(value, float):
        return float.__repr__(value) if math.isfinite(value) else "null"
    if isinstance(value, Mapping):
        names = (json.dumps(str(name), ensure_ascii=False) for name in value)
        entries = [
            f"{name}: {_text(entry, inner)}"
            for name, entry in zip(names, value.values(), strict=True)
        ]
        return f"{{{inner}{f',{inner}'.join(entries)}{line}}}" if entries else "{}"
    if isinstance(value, list | tuple):
        entries = [_text(entry, inner) for entry in value]
        return f"[{inner}{f',{inner}'.join(entries)}{line}]" if entries else "[]"
    if isinstance(value, np.ndarray | np.generic | Array):
        return _text(np.asarray(value).tolist(), line)
    return json.dumps(value, ensure_ascii=False, allow_nan=False)
