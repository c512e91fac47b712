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
    path.write_text(
        json.dumps(_plain(document), indent=2, ensure_ascii=False, allow_nan=False) + "\n",
        encoding="utf-8",
    )


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, np.ndarray | np.generic | Array):
        return _plain(np.asarray(value).tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value
