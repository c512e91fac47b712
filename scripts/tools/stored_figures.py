"""Figures that studies have stored: in tables of evidence pages, of the demo, and of benchmarks.

A figure is named by where it stands:

- `real_robots.md # KUKA KR300 | B | identify | mean`: page, heading, first cell of the table's head
  (empty if it has none), row, column;
- `demo/errors_a.csv | mean ε | Ar+LS`: table of `scripts/tools/thesis/results`, row, column;
- `benchmark urdf.identify`: a metric of `scripts/benchmarks/stored`, of each machine.

A row is named by its first cell, or by its first cells with ` & ` between them; an empty cell has
the text of the cell above.
"""

import csv
import json
import re
from collections.abc import Iterator
from pathlib import Path


ROOT = Path(__file__).parents[2]
_NUMBER = re.compile(r"-?\d[\d,]*\.?\d*(?:e-?\d+)?")


def stored(reference: str) -> list[float]:
    """Return the figure of a reference; of a benchmark, one per machine.

    **Raises** `ValueError` if there is no such figure.

    >>> stored("demo/peaks.csv | 2 | PUMA A [N m]")[0] > 0
    True
    """
    place, _, rest = reference.partition("|")
    place, keys = place.strip(), [part.strip() for part in rest.split("|")]
    if place.startswith("benchmark "):
        figures = list(_benchmarks(place.removeprefix("benchmark ").strip()))
    elif place.endswith(".csv"):
        figures = [float(_demo(place, *keys))]
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
    """Return the cell of a table of docs/ that a reference names."""
    place, *keys = (part.strip() for part in reference.split("|"))
    page, _, heading = place.partition("#")
    return cell_of(page.strip(), heading.strip(), *keys)


def cell_of(page: str, heading: str, head: str, row: str, column: str) -> str:
    """Return a cell of a table of docs/."""
    for title, names, rows in tables(page):
        if title != heading or names[0] != head:
            continue
        if column not in names:
            continue
        above = [""] * len(names)
        for cells in rows:
            filled = [cell or before for cell, before in zip(cells, above, strict=True)]
            parts = row.split(" & ")
            if filled[: len(parts)] == parts:
                return cells[names.index(column)]
            above = filled
    raise ValueError(f"{page} # {heading} | {head} | {row} | {column}: there is no such cell")


def tables(page: str) -> Iterator[tuple[str, list[str], list[list[str]]]]:
    """Heading, head and rows of every table of a page of docs/."""
    title, block = "", list[str]()
    for line in [*(ROOT / "docs" / page).read_text("utf-8").splitlines(), ""]:
        if line.startswith("|"):
            block.append(line)
            continue
        if len(block) > 2:
            head, _, *body = ([_plain(cell) for cell in _cells(row)] for row in block)
            yield title, head, body
        block = []
        if line.startswith("#"):
            title = line.lstrip("#").strip()


def _cells(row: str) -> list[str]:
    return re.split(r"(?<!\\)\|", row.strip()[1:-1])


def _plain(cell: str) -> str:
    return cell.strip().replace("**", "").replace("\\|", "|")


def _demo(place: str, row: str, column: str) -> str:
    path = ROOT / "scripts" / "tools" / "thesis" / "results" / place
    with path.open(encoding="utf-8", newline="") as file:
        for cells in csv.DictReader(file):
            if next(iter(cells.values())) == row and column in cells:
                return cells[column]
    raise ValueError(f"{place} | {row} | {column}: there is no such figure")


def _benchmarks(name: str) -> Iterator[float]:
    text = (ROOT / "scripts" / "benchmarks" / "stored" / "results.json").read_text("utf-8")
    for measurement in json.loads(text):
        for metric in measurement["metrics"]:
            if metric["name"] == name:
                yield metric["value"]
