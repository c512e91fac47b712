"""What the thesis contains, entry by entry, as the TOML files of this folder list it."""

import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any


FOLDER = Path(__file__).parent
_LAST = re.compile(r"-(\d+)$")


@dataclass(frozen=True)
class Entry:
    """A section, an equation or several of one kind, or a figure, and what carries it over.

    **Attributes**

    - `numbers`: as the thesis numbers it; a range for several equations.
    - `title`: a section's heading, or what an equation or figure shows.
    - `by`: public names, files and pages that carry it over.
    - `drawn`: the command and the file that is drawn now; of figures.
    - `exposition`: what it is, if there is nothing to carry.
    - `left_out`: what was not carried over, and why.
    - `note`: what differs.
    """

    numbers: str
    title: str
    by: tuple[str, ...] = ()
    drawn: tuple[str, ...] = ()
    exposition: str = ""
    left_out: str = ""
    note: str = ""

    def __post_init__(self) -> None:
        if not (self.by or self.exposition or self.left_out):
            raise ValueError(f"{self.numbers}: expected by, exposition or left_out")
        if self.drawn and len(self.drawn) != 2:
            raise ValueError(f"{self.numbers}: drawn is {self.drawn}; expected command and file")

    @property
    def each_number(self) -> list[str]:
        """Every single number of a range; one otherwise."""
        first, to, last = self.numbers.partition(" to ")
        if not to:
            return [first]
        start, stop = (_LAST.search(number) for number in (first, last))
        if not (start and stop and first[: start.start()] == last[: stop.start()]):
            raise ValueError(f"{self.numbers}: expected a range within one section")
        section = first[: start.start()]
        return [f"{section}-{i}" for i in range(int(start[1]), int(stop[1]) + 1)]

    @property
    def chapter(self) -> str:
        """The first part of its number: a chapter, or the letter of an appendix."""
        return self.numbers.partition(".")[0]


@dataclass(frozen=True)
class Quantity:
    """A number that the thesis reports, or several, and how it is computed now.

    **Attributes**

    - `where`: section or figure.
    - `then`: the thesis's number, numbers or words.
    - `now`: name of a function, and its arguments.
    """

    where: str
    what: str
    then: float | str | Sequence[float]
    now: tuple[str, ...]
    unit: str = ""
    note: str = ""


@dataclass(frozen=True)
class Symbol:
    """A symbol of Appendix A, and the public name of what it means now."""

    symbol: str
    means: str
    now: str
    note: str = ""


@dataclass(frozen=True)
class Thesis:
    """All entries, in the thesis's order."""

    sections: tuple[Entry, ...]
    equations: tuple[Entry, ...]
    figures: tuple[Entry, ...]
    quantities: tuple[Quantity, ...]
    symbols: tuple[Symbol, ...]


def read(folder: Path = FOLDER) -> Thesis:
    """Reads the TOML files.

    **Raises**

    - `ValueError`: an entry has a key that none has, or says nothing, or repeats a number.
    """
    return Thesis(
        _entries(folder, "section", "number", "title"),
        _entries(folder, "equation", "numbers", "says"),
        _entries(folder, "figure", "number", "shows"),
        tuple(_quantity(row) for row in _rows(folder, "quantity", "quantities")),
        tuple(_made(Symbol, row.get("symbol", "?"), row) for row in _rows(folder, "symbol")),
    )


def _rows(folder: Path, kind: str, name: str = "") -> list[dict[str, Any]]:
    text = (folder / f"{name or kind + 's'}.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)[kind]


def _entries(folder: Path, kind: str, number: str, title: str) -> tuple[Entry, ...]:
    entries: list[Entry] = []
    for row in _rows(folder, kind):
        values = {name: tuple(x) if isinstance(x, list) else x for name, x in row.items()}
        values = {"numbers": values.pop(number, "?"), "title": values.pop(title, ""), **values}
        entries.append(_made(Entry, f"{kind} {values['numbers']}", values))
    numbers = [number for entry in entries for number in entry.each_number]
    if repeated := sorted({number for number in numbers if numbers.count(number) > 1}):
        raise ValueError(f"{kind}s {', '.join(repeated)}: listed more than once")
    return tuple(entries)


def _quantity(row: dict[str, Any]) -> Quantity:
    return _made(Quantity, row.get("what", "?"), {**row, "now": tuple(row.get("now", ()))})


def _made(cls: Any, name: str, values: dict[str, Any]) -> Any:
    try:
        return cls(**values)
    except TypeError as error:
        raise ValueError(f"{name}: {error}") from error
