"""Writes docs/thesis.md: what carries over each section, equation, figure and number of the thesis.

    .venv/bin/python -m scripts.tools.thesis.page
    .venv/bin/python -m scripts.tools.thesis.page --collect build

The entries are in the TOML files beside this one. Every reference is resolved, and every number of
now is computed here or read from results/, where `--collect` copies the tables of long studies from
their folders. A test fails when the page and the code disagree.
"""

import argparse
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import jaxcslc as jc
import sim
from scripts.tools.thesis import computed, results
from scripts.tools.thesis.entries import Entry, Quantity, Symbol, Thesis, read
from scripts.tools.thesis.references import ROOT, link


jc.enable_x64()

PAGE = ROOT / "docs" / "thesis.md"
_CHAPTERS = {
    "1": "Introduction",
    "2": "The motion of robotic manipulators",
    "3": "Adaptive networks",
    "4": "Analysis of training in analogue output networks",
    "5": "The context sensitive linear combiner network for inverse dynamics",
    "6": "Proportional error allocation",
    "7": "Coefficient identification for a PUMA 560",
    "8": "Conclusion",
    "A": "Table of unique terms",
    "B": "Terms and values for the PUMA 560 CSLC network",
    "C": "Technical summary",
}

_INTRODUCTION = """\
# The thesis, entry by entry

- Every section, numbered equation and figure of the thesis has an entry.
- Entries link the code that implements them. What is not carried over is named.
- Measurements are on simulated machines. Compare them in kind, not in value.

![Bars: sections, equations and figures that are carried over](images/evidence/thesis.svg)

The method comes from a doctoral thesis, "Identification of robotic manipulators' inverse dynamics
coefficients via model-based adaptive networks". This page lists its sections, numbered equations
and figures. The thesis counts tables as figures. Each entry links the code that implements it. The
numbers that the thesis reports are compared with ours.

{summary}
The thesis's two PUMA 560s were real. Ours are simulated, with every disturbance of Section 7.2.
Their coefficients are the physically consistent ones nearest to the thesis's ([PUMA A and
B](puma_a_b.md)). Their gears, motors and static friction are our choice. Compare measurements on a
machine in kind, not in value. Results of the network's form are the same, or a note says why not.

`scripts/tools/thesis/page.py` writes this page. It resolves every reference. It computes every
number, or reads it from the tables of a study: {studies}.
"""


def page(thesis: Thesis) -> str:
    """The page as text.

    **Raises**

    - `ValueError`: a reference leads nowhere, or a function of now does not exist.
    """
    parts = [_introduction(thesis)]
    parts.append("## Numbers then and now\n")
    parts.append(_quantities(thesis.quantities))
    for chapter, title in _CHAPTERS.items():
        name = f"{'Chapter' if chapter.isdigit() else 'Appendix'} {chapter}"
        parts.append(f"## {name}: {title}\n")
        for heading, entries in (
            ("section", thesis.sections),
            ("equation", thesis.equations),
            ("figure", thesis.figures),
        ):
            of_chapter = [entry for entry in entries if entry.chapter == chapter]
            if of_chapter:
                parts.append(_entries(heading, of_chapter))
        if chapter == "A":
            parts.append(_symbols(thesis.symbols))
    parts.append("## Coefficients of Appendix B\n")
    parts.append(_COEFFICIENTS)
    for machine in ("A", "B"):
        parts.append(f"### PUMA {machine}\n")
        parts.append(_coefficients(machine))
    parts.append("## What was not carried over\n")
    parts.append(_left_out(thesis))
    return "\n".join(parts)


_COEFFICIENTS = """\
The tables correspond to Figs. B.1-1 to B.5-2. They have the thesis's coefficients and the true ones
of the simulated machine. The identified ones come from `make demo`, with standard and [systematic
errors](uncertainty.md#systematic-errors). The last columns are the output sensitivities of both. If
the simulated machine is far from the thesis's, no machine can have the printed value
([why](puma_a_b.md#contradictions-of-the-printed-coefficients)).
"""


def _introduction(thesis: Thesis) -> str:
    rows: list[list[str]] = []
    for name, entries in (
        ("sections", thesis.sections),
        ("numbered equations", thesis.equations),
        ("figures and tables", thesis.figures),
    ):
        sizes = [
            sum(len(entry.each_number) for entry in entries if test(entry))
            for test in _KINDS.values()
        ]
        rows.append([name, *map(str, [sum(sizes), *sizes])])
    studies = ", ".join(f"`{command}`" for command, _ in results.STUDIES.values())
    summary = _table(["", "in all", *_KINDS], rows, text=1)
    return _INTRODUCTION.format(summary=summary, studies=studies)


_KINDS: dict[str, Callable[[Entry], bool]] = {
    "carried over": lambda entry: bool(entry.by and not entry.left_out),
    "in part": lambda entry: bool(entry.by and entry.left_out),
    "exposition": lambda entry: bool(entry.exposition and not entry.by),
    "not carried over": lambda entry: not (entry.by or entry.exposition),
}


def _entries(heading: str, entries: Iterable[Entry]) -> str:
    rows = [[_numbers(entry), entry.title, _carried(entry)] for entry in entries]
    return _table([heading, "", "carried over by"], rows)


def _numbers(entry: Entry) -> str:
    return entry.numbers.replace(" to ", " to<br>")


def _carried(entry: Entry) -> str:
    parts = [", ".join(link(reference) for reference in entry.by)]
    if entry.drawn:
        command, file = entry.drawn
        if command.endswith(".py"):
            link(command)
            command = f"python -m {command.removesuffix('.py').replace('/', '.')}"
        parts.append(f"Now: `{file}` of `{command}`.")
    if entry.exposition:
        parts.append(f"*{entry.exposition}*")
    if entry.note:
        parts.append(entry.note)
    if entry.left_out:
        parts.append(f"**Not carried over:** {entry.left_out}")
    return "<br>".join(part for part in parts if part)


def _quantities(quantities: Sequence[Quantity]) -> str:
    rows: list[list[str]] = []
    for quantity in quantities:
        now = value_now(quantity)
        digits = _digits(quantity.then)
        values = [_text(quantity.then, digits), _text(now, digits)]
        cells = [quantity.where, quantity.what, quantity.unit, *values]
        cells[1] += f"<br>*{quantity.note}*" if quantity.note else ""
        rows.append(cells)
    return _table(["where", "what", "unit", "thesis", "now"], rows)


def value_now(quantity: Quantity) -> Any:
    """What the function that a quantity names returns.

    **Raises**

    - `ValueError`: neither `computed` nor `results` has such a function.
    """
    name, *arguments = quantity.now
    for module in (computed, results):
        if not name.startswith("_") and hasattr(module, name):
            return getattr(module, name)(*arguments)
    raise ValueError(f"{quantity.what}: no function {name} in computed.py or results.py")


def _text(value: Any, digits: int = 4) -> str:
    """A number, several, or a text."""
    if isinstance(value, str):
        return value.replace("|", "\\|")
    if isinstance(value, Sequence):
        return ", ".join(_text(item, digits) for item in value)
    return str(value) if isinstance(value, int) else f"{value:.{digits}g}"


def _digits(value: Any) -> int:
    """Significant digits of what the thesis prints; three at least."""
    if isinstance(value, Sequence) and not isinstance(value, str):
        return max(map(_digits, value))
    figures = "" if isinstance(value, str) else str(value).replace(".", "").lstrip("0")
    return max(3, len(figures))


def _coefficients(machine: str) -> str:
    thesis = sim.thesis_coefficients(machine)
    table = results.rows("demo", f"coefficients_{machine.lower()}.csv")
    printed = zip(thesis.coefficients.tolist(), thesis.sensitivity.tolist(), strict=True)
    rows: list[list[str]] = []
    for row, (value, sensitivity) in zip(table, printed, strict=True):
        names = ("true", "value", "standard_error", "systematic_error")
        cells = [value, *(float(row[name]) for name in names)]
        ours = float(row["sensitivity"])
        rows.append([row["name"], row["unit"], *map(_text, [*cells, sensitivity, ours])])
    heads = ["", "unit", "thesis", "simulated machine", "identified"]
    heads += ["standard error", "systematic error", "sensitivity, thesis", "sensitivity, now"]
    return _table(heads, rows, text=2)


def _symbols(symbols: Sequence[Symbol]) -> str:
    rows = [
        [symbol.symbol, symbol.means, link(symbol.now) + (symbol.note and f": {symbol.note}")]
        for symbol in symbols
    ]
    return _table(["symbol", "meaning", "now"], rows)


def _left_out(thesis: Thesis) -> str:
    rows = [
        [_numbers(entry), entry.title, entry.left_out]
        for entries in (thesis.sections, thesis.equations, thesis.figures)
        for entry in entries
        if entry.left_out
    ]
    return _table(["", "", "what, and why"], rows)


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]], *, text: int | None = None) -> str:
    """A Markdown table; columns behind the first `text` ones hold numbers."""
    text = len(heads) if text is None else text
    rule = ["---"] * text + ["---:"] * (len(heads) - text)
    return "".join(f"| {' | '.join(row)} |\n" for row in (heads, rule, *rows))


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, default=PAGE, help="docs/thesis.md")
    parser.add_argument(
        "--collect", type=Path, metavar="BUILD", help="first copy the tables of studies from here"
    )
    options = parser.parse_args(argv)
    try:
        if options.collect:
            for path in results.collect(options.collect):
                print(f"copied {path.relative_to(ROOT)}")
        options.output.write_text(page(read()), encoding="utf-8")
    except ValueError as error:
        parser.error(str(error))
    print(f"wrote {options.output}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
