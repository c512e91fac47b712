import contextlib
import json
import os
import sys
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Annotated, Literal

import jax
import typer
from rich.console import Console

from . import __version__
from .assessment import (
    all_or_nothing,
    coefficient_rows,
    coefficient_text,
    compare,
    derivation_document,
    identification_report,
    write_csv,
    write_json,
)
from .learning import Settings, choose_settings, settings_from
from .manipulator import Manipulator, RobotError, load_robot, panda, puma560
from .motion import RecordingError, load_recording
from .network import CSLC, derive


app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Derive a robot's inverse dynamics, and identify its coefficients from recordings.",
)
_BUNDLED = {"puma560": puma560, "panda": panda}

Lengths = Literal["auto", "symbolic", "numeric"]
RobotArgument = Annotated[
    str, typer.Argument(metavar="ROBOT", help="A robot file (.toml), or puma560 or panda.")
]
LengthsOption = Annotated[
    Lengths,
    typer.Option(
        help="Keep lengths as symbols or put their values in; auto: symbols up to 6 joints."
    ),
]


def main() -> None:
    """Run the command; wrong input ends it with one line and exit code 2."""
    jax.config.update("jax_enable_x64", True)  # identification is float64 work
    cache = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    jax.config.update("jax_compilation_cache_dir", str(Path(cache) / "jaxcslc" / "jax"))
    # Keep even the quickest compilations: there are dozens of them, and a second run has none.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    app()


def _version(asked: bool) -> bool:
    if asked:
        typer.echo(__version__)
        raise typer.Exit
    return asked


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print it.")
    ] = False,
) -> None:
    del version


@app.command("derive")
def derive_command(
    robot: RobotArgument,
    lengths: LengthsOption = "auto",
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder for the tables, as files.")
    ] = None,
) -> None:
    """Derive a robot's inverse dynamics: its inputs, links and named coefficients."""
    with _one_line_errors():
        network = _network(_robot(robot), lengths)
        typer.echo(network)
        counts = network.counts
        for name in ("mass", "velocity", "gravity"):
            count = counts[name]
            typer.echo(
                f"{name}: {count['inputs']} inputs, {count['links']} links,"
                f" {count['coefficients']} coefficients"
            )
        per_joint = ", ".join(str(order) for order in network.order_per_joint)
        typer.echo(f"network order {network.order}; per joint {per_joint}\n")
        rows = coefficient_rows(network)
        typer.echo(coefficient_text(rows))
        if output is not None:
            _usable(output)
            with all_or_nothing(output) as folder:
                write_csv(folder / "coefficients.csv", rows)
                write_json(folder / "tables.json", derivation_document(network))
            typer.echo(f"\nwrote {output / 'coefficients.csv'} and {output / 'tables.json'}")


@app.command("identify")
def identify_command(
    robot: RobotArgument,
    train: Annotated[Path, typer.Argument(metavar="TRAIN", help="Recording to learn from.")],
    validate: Annotated[
        Path | None, typer.Option(help="Recording to judge on; nothing is learnt from it.")
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the results.")] = Path(
        "identified"
    ),
    lengths: LengthsOption = "auto",
    settings: Annotated[
        Path | None,
        typer.Option(
            help="Settings from an earlier run's identification.json, or written by hand;"
            " chosen by cross-validation within TRAIN if omitted."
        ),
    ] = None,
) -> None:
    """Identify a robot's coefficients from a recording of positions and torques."""
    with _one_line_errors(), _progress("reading") as step:
        _usable(output)
        network = _network(_robot(robot), lengths)
        recording = load_recording(train, joints=network.joint_count)
        held_out = None if validate is None else load_recording(validate, network.joint_count)
        if settings is None:
            step("choosing smoothing and masks by cross-validation")
            chosen = choose_settings(network, recording).settings
        else:
            chosen = _settings(settings)
        step("preparing patterns")
        patterns = {"training": chosen.patterns(recording)}
        if held_out is not None:
            patterns["validation"] = chosen.patterns(held_out)
        step("solving")
        fit = chosen.fit(network, patterns["training"])
        step("writing")
        errors = {name: compare(network, p, {"fit": fit.k}) for name, p in patterns.items()}
        with all_or_nothing(output) as folder:
            written = identification_report(folder, network, fit, patterns, errors, chosen)
    typer.echo(f"{network}\nsettings: {chosen}\n")
    typer.echo(coefficient_text(coefficient_rows(network, fit)))
    for sentence in fit.unidentifiable:
        typer.echo(f"not determined: {sentence}")
    typer.echo(f"\nrank {int(fit.rank)} of {network.size}, condition {float(fit.condition):.4g}")
    for name, table in errors.items():
        typer.echo(f"\ntorque error, {name} recording\n{table}")
    typer.echo("\nwrote " + ", ".join(str(output / path.name) for path in written))


def _robot(name: str) -> Manipulator:
    return _BUNDLED[name]() if name in _BUNDLED else load_robot(name)


def _network(robot: Manipulator, lengths: Lengths) -> CSLC:
    if lengths == "auto":
        lengths = "symbolic" if robot.joint_count <= 6 else "numeric"
    return derive(robot, lengths=lengths)


def _settings(path: Path) -> Settings:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise ValueError(f"{path}: not valid JSON: {error}") from None
    if not isinstance(document, dict):
        raise ValueError(f"{path}: expected settings as a JSON object")
    try:
        return settings_from(document.get("settings", document))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _usable(output: Path) -> None:
    if output.exists() and not output.is_dir():
        raise ValueError(f"{output}: expected a folder for the results, this is a file")


@contextlib.contextmanager
def _one_line_errors() -> Generator[None]:
    """What a user can set right is one line on standard error, and exit code 2."""
    try:
        yield
    except BrokenPipeError:  # the reader has seen enough, as `head` has; typer ends quietly
        raise
    except (RobotError, RecordingError, ValueError, RuntimeError, OSError) as error:
        message = " ".join(str(error).split()) or type(error).__name__
        print(f"jaxcslc: {message}", file=sys.stderr)
        raise typer.Exit(2) from None


@contextlib.contextmanager
def _progress(first: str) -> Generator[Callable[[str], None]]:
    """A line on standard error that says what is being done, on a terminal only."""
    console = Console(stderr=True)
    with console.status(first) as status:
        yield lambda text: status.update(text)
