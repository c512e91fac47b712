import os
import warnings
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import jax
import typer

from ._check import check_command
from ._compare import compare_command
from ._constants import constants_command
from ._derive import derive_command
from ._excite import excite_command
from ._export import export_command
from ._identify import identify_command
from ._payload import payload_command


app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # it takes [s] for markup, and leaves it out
    help="Derive a robot's inverse dynamics, and identify its coefficients from recordings.",
)
app.command("derive")(derive_command)
app.command("check")(check_command)
app.command("identify")(identify_command)
app.command("compare")(compare_command)
app.command("excite")(excite_command)
app.command("export")(export_command)
app.command("payload")(payload_command)
app.command("constants")(constants_command)


def run() -> None:
    """Run the command in this process, whose settings of JAX it changes."""
    # Overflow inside a computation is no news for a user: the report judges what comes out.
    warnings.filterwarnings("ignore", category=RuntimeWarning)
    jax.config.update("jax_enable_x64", True)  # identification is float64 work
    cache = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    jax.config.update("jax_compilation_cache_dir", str(Path(cache) / "jaxcslc" / "jax"))
    # Keep even the quickest compilations: there are dozens of them, and a second run has none.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    app()


def _version(asked: bool) -> bool:
    if asked:
        typer.echo(version("jaxcslc"))
        raise typer.Exit
    return asked


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print it.")
    ] = False,
) -> None:
    del version
