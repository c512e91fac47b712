"""Results of studies that evidence pages show, and the tables of the pages.

`docs/results` has one file for each run of a study: the command, the date, the recordings or
seeds, and tables of text. A page has a marked block where a table stands:

    <!-- table: payload/disturbances -->
    <!-- end -->

`python -m scripts.tools.evidence` fills the blocks and draws the charts. A test fails if a page
has another table than its stored results.
"""

import argparse
import datetime
import json
import re
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path


RESULTS = Path(__file__).parents[2] / "docs" / "results"
_BLOCK = re.compile(r"(<!-- table: (.+) -->\n)(?:(?!<!-- table).*\n)*?(<!-- end -->)")


@dataclass(frozen=True)
class Results:
    """Tables of one run of a study.

    - `command`: of the run; empty if no program makes these tables.
    - `date`: of the run; "by" a date, if only the day on which the figures were committed is known.
    - `sample`: what the figures are of: seeds, recordings, machines.
    - `tables`: rows by a table's name, the head first.
    """

    command: str
    date: str
    sample: str
    tables: Mapping[str, Sequence[Sequence[str]]]


def load(run: str) -> Results:
    """Return the results of a run, by the name of its file.

    **Raises** `ValueError` if there are none.

    >>> load("payload").tables["disturbances"][0][1]
    'quantised encoders'
    """
    path = RESULTS / f"{run}.json"
    if not path.is_file():
        raise ValueError(f"{run}: there are no such results in {RESULTS}")
    return Results(**json.loads(path.read_text("utf-8")))


def table(name: str) -> Sequence[Sequence[str]]:
    """Return the rows of a table, the head first.

    - `name`: of the run and of its table, `payload/disturbances`.

    **Raises** `ValueError` if there is no such table.
    """
    run, _, one = name.partition("/")
    tables = load(run).tables
    if one not in tables:
        raise ValueError(f"{name}: there is no such table; {run} has {', '.join(tables)}")
    return tables[one]


def save(run: str, results: Results) -> None:
    """Write the results of a run, a row a line.

    **Raises** `ValueError` if a table's rows differ in length.
    """
    for name, rows in results.tables.items():
        if len({len(row) for row in rows}) != 1:
            raise ValueError(f"{run}/{name}: expected rows of one length")
    head = {name: getattr(results, name) for name in ("command", "date", "sample")}
    tables = ",\n".join(
        f"    {_json(name)}: [\n"
        + ",\n".join(f"      {_json(list(row))}" for row in rows)
        + "\n    ]"
        for name, rows in results.tables.items()
    )
    lines = [f"  {_json(name)}: {_json(value)},\n" for name, value in head.items()]
    text = "{\n" + "".join(lines) + f'  "tables": {{\n{tables}\n  }}\n}}\n'
    (RESULTS / f"{run}.json").write_text(text, encoding="utf-8")


def _json(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)


def measured_by(words: Sequence[str]) -> list[str]:
    """Return the words of a command line that figures depend on.

    Folders, the number of processes and `--store` are not among them.

    >>> measured_by(["-o", "build/x", "--arms", "ur5", "--jobs", "2", "--store"])
    ['--arms', 'ur5']
    """
    left: list[str] = []
    after = False
    for word in words:
        dropped = after or word == "--store"
        after = word in ("-o", "--output", "--data", "--jobs")
        left += [] if dropped or after else [word]
    return left


def store(
    options: argparse.Namespace,
    run: str,
    sample: str,
    tables: Mapping[str, Sequence[Sequence[str]]],
) -> None:
    """Save what the running program measured today, with its command, if it has `--store`.

    **Arguments**

    - `options`: of a parser with `command.add_store`.
    - `run`: name of the file.
    - `sample`: what the figures are of: seeds, recordings, machines.
    - `tables`: rows of text, the head first.
    """
    if not options.store:
        return
    spec = sys.modules["__main__"].__spec__
    module = spec.name if spec else Path(sys.argv[0]).stem
    save(
        run,
        Results(
            shlex.join(["python", "-m", module, *measured_by(sys.argv[1:])]),
            datetime.date.today().isoformat(),
            sample,
            tables,
        ),
    )
    print(f"stored in docs/results/{run}.json; python -m scripts.tools.evidence fills the pages")


def filled(page: str) -> str:
    """Return a page with the stored table in each marked block.

    **Raises** `ValueError` if a block names no stored table, or has no end.
    """
    if page.count("<!-- table: ") != len(_BLOCK.findall(page)):
        raise ValueError("a table's block has no end: expected <!-- end -->")
    return _BLOCK.sub(lambda match: f"{match[1]}\n{markdown(match[2])}\n{match[3]}", page)


def markdown(name: str) -> str:
    """Return a table in Markdown, with the date, the sample and the command below it."""
    head, *rows = table(name)
    lines = [
        "".join(f"| {cell} " if cell else "| " for cell in _escaped(row)) + "|"
        for row in (head, *rows)
    ]
    lines.insert(1, "|---" * len(head) + "|")
    results = load(name.partition("/")[0])
    command = f": `{results.command}`" if results.command else ""
    return "\n".join([*lines, "", f"*Measured {results.date}, {results.sample}*{command}", ""])


def _escaped(row: Sequence[str]) -> list[str]:
    return [cell.replace("|", r"\|") for cell in row]
