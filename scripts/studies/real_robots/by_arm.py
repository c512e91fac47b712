"""Studies of real arms that print one table: their command line, and the rows of arm after arm."""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxcslc._text_table import text_table
from scripts.studies import command
from scripts.studies.real_robots.arms import DATA, READERS, Arm, read
from scripts.studies.stored import store
from scripts.studies.tables import grouped


def new_parser(description: str | None, output: str) -> argparse.ArgumentParser:
    """A study's parser (`command.new_parser`) with `--arms` and `--data`."""
    parser = command.new_parser(description, output)
    parser.add_argument("--arms", nargs="+", default=list(READERS), help=", ".join(READERS))
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the arms' folders")
    return parser


def parse(
    parser: argparse.ArgumentParser, argv: Sequence[str] | None, **quick: Any
) -> argparse.Namespace:
    """The options, `--quick` among them (`command.parse`); arms that there are."""
    command.add_store(parser)
    options = command.parse(parser, argv, **quick)
    command.require_some_of(parser, "arm", options.arms, tuple(READERS))
    return options


def print_table(
    options: argparse.Namespace,
    rows_of: Callable[[str, Arm], list[list[str]]],
    header: Sequence[str],
    *,
    fitted: float = 1.0,
) -> list[list[str]]:
    """Prints one table of all arms, and returns it, the head first.

    **Arguments**

    - `options`: with `arms` and `data`.
    - `rows_of`: of an arm's name and recordings.
    - `header`: of the first columns; those behind them are joints, counted from 1.
    - `fitted`: the part of each training recording that is fitted, from its beginning.
    """
    rows: list[list[str]] = []
    for name in command.progress(options.arms, desc="arms", unit="arm"):
        arm = read(name, options.data)
        if fitted < 1.0:
            end = fitted * float(np.ptp(arm.training.time))
            arm = arm._replace(training=arm.training.between(0.0, end))
        rows += rows_of(name, arm)
    width = max(map(len, rows))
    rows = [row + [""] * (width - len(row)) for row in rows]
    head = [*header, *(str(joint + 1) for joint in range(width - len(header)))]
    print(text_table(head, rows, left=header[:2]))
    return [head, *rows]


def store_table(
    options: argparse.Namespace,
    run: str,
    table: Sequence[Sequence[str]],
    name: str = "changes",
) -> int:
    """Keeps a table of `print_table` among those of a run. **Returns** 0, the exit status."""
    store(options, run, "one recording of each motion", {name: grouped(table)})
    return 0


def print_held_out(
    description: str | None,
    output: str,
    rows_of: Callable[[str, Arm], list[list[str]]],
    argv: Sequence[str] | None,
    *,
    quick: Sequence[str],
) -> int:
    """Runs a study of held-out errors, whose rows begin with arm and motion.

    **Arguments**

    - `description`, `output`: as of `new_parser`.
    - `rows_of`: as of `print_table`.
    - `quick`: the arms of `--quick`, which fits two fifths of their training recordings.

    **Returns** the exit status.
    """
    parser = new_parser(description, output)
    options = parse(parser, argv, arms=list(quick))
    fitted = 0.4 if options.quick else 1.0
    return command.run(
        parser,
        lambda: store_table(
            options, output, print_table(options, rows_of, ["arm", "motion"], fitted=fitted)
        ),
        seconds=30.0 * len(options.arms),
    )
