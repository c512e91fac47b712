"""Figures that studies have stored: for evidence pages, of the demo, and of benchmarks.

A figure is named by where it stands:

- `payload/disturbances | mass after 2 s [%] | all disturbances`: table of `docs/results`, row,
  column;
- `puma_a_b.md # Effect on the torque | PUMA | A | all`: a page that a program writes whole,
  heading, first cell of the table's head, row, column;
- `demo/errors_a.csv | mean ε | Ar+LS`: table of `scripts/tools/thesis/results`, row, column;
- `benchmark urdf.identify`: a metric of `scripts/benchmarks/stored`, of each machine.

A row is named by its first cell, or by its first cells with ` & ` between them; an empty cell has
the text of the cell above.
"""

import csv
import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from scripts.studies.stored import table


ROOT = Path(__file__).parents[2]
_NUMBER = re.compile(r"-?\d[\d,]*\.?\d*(?:e-?\d+)?")


def stored(reference: str) -> list[float]:
    """Return the figure of a reference; of a benchmark, one per machine.

    **Raises** `ValueError` if there is no such figure.

    >>> stored("demo/peaks.csv | 2 | PUMA A [N m]")[0] > 0
    True
    """
    if reference.startswith("benchmark "):
        figures = list(_benchmarks(reference.removeprefix("benchmark ").strip()))
    else:
        figures = [numbers_of(cell_named(reference))[0]]
    if not figures:
        raise ValueError(f"{reference}: there is no such figure")
    return figures


def numbers_of(cell: str) -> list[float]:
    """Return the numbers of a cell.

    >>> numbers_of("**1,250.5** (3)")
    [1250.5, 3.0]
    """
    found = _NUMBER.findall(cell.replace("−", "-"))
    if not found:
        raise ValueError(f"{cell!r}: expected a number")
    return [float(number.replace(",", "")) for number in found]


def cell_named(reference: str) -> str:
    """Return the cell that a reference names, of a table of text.

    **Raises** `ValueError` if there is no such cell.

    >>> cell_named("payload/disturbances | picked up, detected after [s] | all disturbances")
    '1.5, 0.45, 0.32'
    """
    place, *keys = (part.strip() for part in reference.split("|"))
    *head, row, column = keys
    for rows in _tables(place, *head):
        names, *body = ([_plain(cell) for cell in cells] for cells in rows)
        if column not in names:
            continue
        above = [""] * len(names)
        for cells in body:
            above = [cell or before for cell, before in zip(cells, above, strict=True)]
            parts = row.split(" & ")
            if above[: len(parts)] == parts:
                return cells[names.index(column)]
    raise ValueError(f"{reference}: there is no such cell")


def _tables(place: str, head: str = "") -> Iterator[Sequence[Sequence[str]]]:
    """Tables that a reference may mean, each with its head first."""
    page, hash_sign, heading = place.partition("#")
    if hash_sign:
        for title, rows in _tables_of_page(page.strip()):
            if title == heading.strip() and _plain(rows[0][0]) == head:
                yield rows
    elif place.endswith(".csv"):
        path = ROOT / "scripts" / "tools" / "thesis" / "results" / place
        with path.open(encoding="utf-8", newline="") as file:
            yield list(csv.reader(file))
    else:
        yield table(place)


def _tables_of_page(page: str) -> Iterator[tuple[str, list[list[str]]]]:
    """Heading and rows of every table of a page of docs/."""
    title, block = "", list[list[str]]()
    for line in [*(ROOT / "docs" / page).read_text("utf-8").splitlines(), ""]:
        if line.startswith("|"):
            block.append(re.split(r"(?<!\\)\|", line.strip()[1:-1]))
            continue
        if block:
            yield title, [block[0], *block[2:]]
        block = []
        if line.startswith("#"):
            title = line.lstrip("#").strip()


def _plain(cell: str) -> str:
    return cell.strip().replace("**", "").replace("\\|", "|")


def measurements() -> list[dict[str, Any]]:
    """Return the stored benchmarks: each with its group, machine, date and metrics."""
    return json.loads(
        (ROOT / "scripts" / "benchmarks" / "stored" / "results.json").read_text("utf-8")
    )


def _benchmarks(name: str) -> Iterator[float]:
    for measurement in measurements():
        for metric in measurement["metrics"]:
            if metric["name"] == name:
                yield metric["value"]
