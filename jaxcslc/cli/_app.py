"""Command line of all commands, and its run in this process."""

import sys
import warnings
from collections.abc import Iterable
from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Annotated

import jax
import typer

from .._cache import cache_folder
from ._process import collect_garbage


if TYPE_CHECKING:
    app: typer.Typer

# The module of each command: imported when it is typed, or when all commands are listed.
_COMMANDS = {
    "example": "_example",
    "derive": "_derive",
    "check": "_check",
    "identify": "_identify",
    "compare": "_compare",
    "excite": "_excite",
    "export": "_export",
    "payload": "_payload",
    "constants": "_payload",
}


def application(commands: Iterable[str] = _COMMANDS) -> typer.Typer:
    """Return the command line with some of its commands."""
    made = typer.Typer(
        add_completion=False,
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,  # it takes [s] for markup, and leaves it out
        help="Derive a robot's inverse dynamics, and identify its coefficients from recordings.",
    )
    made.callback()(_common)
    for name in commands:
        module = import_module(f".{_COMMANDS[name]}", __package__)
        made.command(name)(getattr(module, f"{name}_command"))
    return made


def __getattr__(name: str) -> typer.Typer:
    """Return `app`, the command line with all commands."""
    if name != "app":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return globals().setdefault("app", application())


def run() -> None:
    """Run the command in this process, whose settings of JAX it changes."""
    # Overflow inside a computation is no news for a user: the report judges what comes out.
    warnings.filterwarnings("ignore", category=RuntimeWarning)
    jax.config.update("jax_enable_x64", True)  # identification is float64 work
    if (cache := cache_folder()) is not None:
        jax.config.update("jax_compilation_cache_dir", str(cache / "jax"))
    # Keep even the quickest compilations: there are dozens of them, and a second run has none.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    typed = "".join(sys.argv[1:2])
    command = application(
        [typed] if typed in _COMMANDS else () if typed == "--version" else _COMMANDS
    )
    collect_garbage()
    command()


def _version(asked: bool) -> bool:
    if asked:
        typer.echo(version("jaxcslc"))
        raise typer.Exit
    return asked


def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    del version
