"""What the command lines of studies share: options, their limits, errors and interruptions."""

import argparse
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import jax
from tqdm import tqdm

import sim


_ROOT = Path(__file__).parents[2]


def new_parser(description: str | None, output: str) -> argparse.ArgumentParser:
    """A parser with `-o`, described by a study's docstring.

    **Arguments**

    - `description`: the docstring, printed by `--help` as it is.
    - `output`: the folder below `build` that tables and pictures are written into by default.
    """
    parser = argparse.ArgumentParser(
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("build") / output, help="folder of the results"
    )
    return parser


def parse(
    parser: argparse.ArgumentParser, arguments: Sequence[str] | None, **quick: Any
) -> argparse.Namespace:
    """The options, with `--quick` for a trial run of about a minute.

    **Arguments**

    - `arguments`: of the command line; the program's if none.
    - `quick`: defaults that `--quick` replaces; options beside it still count.
    """
    parser.add_argument("--quick", action="store_true", help="a trial run of about a minute")
    options = parser.parse_args(arguments)
    if options.quick:
        parser.set_defaults(**quick)
        options = parser.parse_args(arguments)
    if options.quick and getattr(options, "store", False):
        parser.error("--store is for full runs; expected no --quick")
    return options


def add_store(parser: argparse.ArgumentParser) -> None:
    """Adds `--store`, for `stored.store`."""
    parser.add_argument(
        "--store", action="store_true", help="keep the tables in docs/results, for evidence pages"
    )


def add_seeds(parser: argparse.ArgumentParser, count: int) -> None:
    """Adds `--seeds` and `--first`, for `seeds_of`.

    - `count`: of seeds, by default.
    """
    parser.add_argument("--seeds", type=int, default=count, help="how many")
    parser.add_argument("--first", type=int, default=0, help="the first seed")


def seeds_of(options: argparse.Namespace) -> range:
    """The seeds of a study's rows."""
    return range(options.first, options.first + options.seeds)


def require_least(
    parser: argparse.ArgumentParser, options: argparse.Namespace, **least: float
) -> None:
    """Ends the program with one line if an option is below its least value."""
    for name, lowest in least.items():
        value = getattr(options, name)
        if value < lowest:
            shown = name.replace("_", "-")
            parser.error(f"--{shown} is {value}; expected {lowest:g} or more")


def require_between(
    parser: argparse.ArgumentParser,
    options: argparse.Namespace,
    **limits: tuple[float, float],
) -> None:
    """Ends the program with one line if an option is not strictly between its limits."""
    for name, (low, high) in limits.items():
        value = getattr(options, name)
        if not low < value < high:
            shown = name.replace("_", "-")
            parser.error(f"--{shown} is {value}; expected more than {low:g} and less than {high:g}")


def require_some_of(
    parser: argparse.ArgumentParser, kind: str, names: list[str], allowed: tuple[str, ...]
) -> None:
    """Ends the program with one line if a name is not among the known ones."""
    for name in names:
        if name not in allowed:
            parser.error(f"no {kind} is called {name!r}; expected some of {', '.join(allowed)}")


def keep_compiled() -> None:
    """Keeps compiled programs in the repository's `.cache` for later runs."""
    jax.config.update("jax_compilation_cache_dir", str(_ROOT / ".cache" / "jax"))
    # Keep even the quickest compilations: there are hundreds of them.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def compile_quickly() -> None:
    """Compiles with fewer optimisations: for trial runs that compile longer than they compute."""
    jax.config.update("jax_disable_most_optimizations", True)


def duration_text(seconds: float) -> str:
    """A duration in words, to two digits at most."""
    for unit, length in (("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 1.5 * length:
            return f"{float(f'{seconds / length:.2g}'):g} {unit}"
    return f"{float(f'{max(seconds, 1.0):.1g}'):g} seconds"


def progress(
    items: Iterable[Any] | None = None, *, desc: str, unit: str = "it", **options: Any
) -> "tqdm[Any]":
    """A progress bar on standard error: in a terminal as usual, in a file twice a minute."""
    interval = 0.1 if sys.stderr.isatty() else 30.0
    return tqdm(items, desc=desc, unit=unit, mininterval=interval, maxinterval=interval, **options)


def run(
    parser: argparse.ArgumentParser,
    study: Callable[[], int],
    rows: Path | None = None,
    *,
    seconds: float | None = None,
) -> int:
    """Runs a study; bad values and failed simulations end it with one line.

    **Arguments**

    - `study`: returns an exit status.
    - `rows`: where finished rows are kept, if anywhere.
    - `seconds`: how long it takes on two cores, from the start; printed first.

    **Returns** the exit status; 130 after Ctrl-C.
    """
    if seconds is not None:
        kept = f"; finished parts are kept in {rows}" if rows else ""
        print(f"about {duration_text(seconds)} on two cores{kept}", flush=True)
    keep_compiled()
    try:
        return study()
    except KeyboardInterrupt:
        print("\ninterrupted" + (f"; the same command goes on from {rows}" if rows else ""))
        return 130
    except (sim.MachineError, sim.SimulationError, ValueError, RuntimeError) as error:
        parser.error(" ".join(str(error).split()))
