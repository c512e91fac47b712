"""What the command lines of studies share: options, their limits, errors and interruptions."""

import argparse
from collections.abc import Callable
from pathlib import Path

import jax

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


def require_least(
    parser: argparse.ArgumentParser, options: argparse.Namespace, **least: float
) -> None:
    """Ends the program with one line if an option is below its least value."""
    for name, lowest in least.items():
        value = getattr(options, name)
        if value < lowest:
            shown = name.replace("_", "-")
            parser.error(f"--{shown} is {value}; expected {lowest:g} or more")


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
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


def run(parser: argparse.ArgumentParser, study: Callable[[], int], rows: Path | None = None) -> int:
    """Runs a study; bad values and failed simulations end it with one line.

    **Arguments**

    - `study`: returns an exit status.
    - `rows`: where finished rows are kept, if anywhere.

    **Returns** the exit status; 130 after Ctrl-C.
    """
    keep_compiled()
    try:
        return study()
    except KeyboardInterrupt:
        print("\ninterrupted" + (f"; the same command goes on from {rows}" if rows else ""))
        return 130
    except (sim.MachineError, sim.SimulationError, ValueError, RuntimeError) as error:
        parser.error(" ".join(str(error).split()))
