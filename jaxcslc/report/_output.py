"""Files of reports: a folder of them, all or none; CSV and JSON."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .._plain_data import plain
from .._scratch import all_or_nothing
from .._text_table import csv_line
from ._page import render


if TYPE_CHECKING:
    from ._report import AbstractReport


_RECORDINGS = ("training", "validation")
_FILES = ("index.html", "coefficients.csv", "identification.json")
# Samples whose numbers are Python's objects at a time: those of 600,000 would take 0.4 GB.
_ROWS = 1 << 14


def write_report(
    folder: Path, report: "AbstractReport[Any]", *, pictures: bool
) -> tuple[Path, ...]:
    """Writes a report into a folder: all of its files or, if writing fails, none.

    Files of an earlier report that this one does not have are removed.

    **Returns** the files to look at: without those of drawings. **Raises** as `Report.save`.
    """
    known = [path.name for path in replaced_files(folder)]
    with all_or_nothing(folder, earlier=known) as scratch:
        page = render(report.page(charts=pictures))
        (scratch / "index.html").write_text(page, encoding="utf-8", errors="backslashreplace")
        for section in report.sections:
            for name, rows in section.tables(report).items():
                write_csv(scratch / name, rows)
        identification, *drawings = report.documents(charts=pictures).items()
        write_json(scratch / identification[0], identification[1])
        for name, entries in drawings:  # nobody reads these numbers
            text = json.dumps(entries, separators=(",", ":"), allow_nan=False)
            (scratch / name).write_text(text, encoding="utf-8", errors="backslashreplace")
        for name in report.patterns:
            _write_torque(scratch / _torque_file(name, report.model.output_quantity), report, name)
        written = {path.name for path in scratch.iterdir()}
    ordered = [*known, *sorted(written - {*known})]
    shown = written - {name for name, _ in drawings}
    return tuple(folder / name for name in ordered if name in shown)


def _torque_file(recording: str, quantity: str) -> str:
    return f"{quantity.replace(' ', '_')}_{recording}.csv"


def replaced_files(folder: Path) -> list[Path]:
    """Return the files of a folder that a report written into it may replace or remove."""
    of_recordings = [
        name
        for recording in _RECORDINGS
        for name in (
            f"errors_{recording}.csv",
            *(_torque_file(recording, quantity) for quantity in ("torque", "known sides")),
        )
    ]
    return [folder / name for name in (*_FILES, *of_recordings, "charts.json")]


def _write_torque(path: Path, report: "AbstractReport[Any]", recording: str) -> None:
    """Writes measured and predicted torque of every sample, and what is masked."""
    patterns, labels = report.patterns[recording], report.model.output_labels
    header = [f"{name}_{label}" for name in ("measured", "predicted", "mask") for label in labels]
    numbers = np.concatenate(
        [
            np.asarray(patterns.time)[:, None],
            np.asarray(patterns.torque),
            report.predicted(recording),
        ],
        axis=1,
    )
    # As `numpy.savetxt` writes them, in half of the time; a mask is one character.
    row = "%.10g," * numbers.shape[1] + "%s"
    mask = np.asarray(patterns.mask)
    masks = np.full((len(mask), 2 * mask.shape[1]), ord(","), np.uint8)
    masks[:, ::2] = np.where(mask, ord("1"), ord("0"))
    masks[:, -1] = ord("\n")
    ends = masks.view(f"S{masks.shape[1]}").ravel()
    with path.open("w", encoding="utf-8", errors="backslashreplace", newline="\n") as file:
        file.write(csv_line(["time", *header]) + "\n")
        for start in range(0, len(numbers), _ROWS):
            part = slice(start, start + _ROWS)
            pairs = zip(numbers[part].tolist(), ends[part].astype(str).tolist(), strict=True)
            file.writelines(row % (*values, end) for values, end in pairs)


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Rows as CSV, numbers in full precision."""
    with path.open("w", newline="", encoding="utf-8", errors="backslashreplace") as file:
        names = list(rows[0])
        lines = (names, *([row.get(name, "") for name in names] for row in rows))
        file.writelines(f"{csv_line(line)}\r\n" for line in lines)


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """A document as JSON; numbers that JSON cannot represent become null."""
    text = json.dumps(plain(document), indent=2, ensure_ascii=False, allow_nan=False)
    path.write_text(f"{text}\n", encoding="utf-8", errors="backslashreplace")
