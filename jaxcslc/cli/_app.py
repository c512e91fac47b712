"""The program: its commands by name, a run in this process, and `jaxcslc completion`."""

import argparse
import os
import sys
import warnings
from collections.abc import Mapping, Sequence
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal

from ._common import Command, Context, Output, command, one_line_errors, show
from ._help import program_text
from ._options import UsageError, add_options, argument, did_you_mean
from ._process import collect_garbage


# Of each command: its module, imported when it is typed, and its summary.
_GROUPS: Mapping[str, Mapping[str, tuple[str, str]]] = {
    "start": {
        "example": ("_example", "Write a robot file and two logs to try the commands on."),
        "init": ("_init", "Write jaxcslc.toml, which holds the options of a robot."),
        "check": ("_check", "Check recordings for wrong units, signs, times and samples."),
    },
    "identify": {
        "identify": ("_identify", "Identify a robot's parameters from recordings."),
        "compare": ("_compare", "Compare two identifications."),
        "payload": ("_payload", "Identify a payload that the arm carries."),
        "torque-constants": ("_payload", "Identify torque constants of motor currents."),
    },
    "use": {
        "export": ("_export", "Write a robot file with identified parameters, or C code."),
        "excite": ("_excite", "Design the motion to record next."),
        "derive": ("_derive", "Derive the inverse dynamics, without a recording."),
        "completion": ("_app", "Print the completion script of a shell."),
    },
}
_MODULES = {name: module for row in _GROUPS.values() for name, (module, _) in row.items()}
COMMANDS = tuple(_MODULES)
"""Names of the commands."""
SUMMARIES = {
    title: {name: summary for name, (_, summary) in row.items()} for title, row in _GROUPS.items()
}
"""Summaries of the commands, by what they are for."""

_RENAMED = MappingProxyType({"constants": "torque-constants"})  # names of before


def command_named(name: str) -> Command:
    """Return a command.

    **Raises** `UsageError` for a name that none has.
    """
    name = _RENAMED.get(name, name)
    if name not in _MODULES:
        raise UsageError(f"no command {name!r}{did_you_mean(name, COMMANDS)}")
    module = import_module(f".{_MODULES[name]}", __package__)
    return getattr(module, f"{name.replace('-', '_')}_command")


def run(words: Sequence[str] | None = None, *, configure: bool = True) -> int:
    """Run the program in this process.

    - `words`: of the command line; by default those of the process.
    - `configure`: whether to change settings of the process and of JAX; tests have their own.

    **Returns** the status: 0, or 2 for wrong input, which is one line on standard error; 1 of
    `check` for recordings that look wrong, and where nobody reads the output.
    """
    words = sys.argv[1:] if words is None else words
    try:
        with one_line_errors() as status:
            if not words or words[0] in ("--help", "--help-all", "-h"):
                show(program_text(SUMMARIES))
            elif words[0] == "--version":
                show(version("jaxcslc"))
            else:
                command = command_named(words[0])
                if configure:
                    _configure()
                return command.run(words[1:])
        return status[0] if status else 0
    except BrokenPipeError:  # `head` closes the pipe early
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


def _configure() -> None:
    """Set JAX up for identification."""
    import jax

    from .._cache import cache_folder

    # Overflow inside a computation is no news for a user: the report judges what comes out.
    warnings.filterwarnings("ignore", category=RuntimeWarning)
    jax.config.update("jax_enable_x64", True)  # identification is float64 work
    if (cache := cache_folder()) is not None:
        jax.config.update("jax_compilation_cache_dir", str(cache / "jax"))
    # Keep even the quickest compilations: there are dozens of them, and a second run has none.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    collect_garbage()


@command(
    "command",
    "completion bash > ~/.local/share/bash-completion/completions/jaxcslc",
    "completion zsh > ~/.zfunc/_jaxcslc",
)
def completion_command(
    context: Context,
    shell: Annotated[Literal["bash", "zsh", "fish", "tcsh"], argument("SHELL", "Your shell.")],
) -> Output:
    """Print the script by which a shell completes commands, options and files.

    Write it where the shell looks for such scripts, and open a new shell. The script holds all
    names, so that completing starts no program.
    """
    from .._environment import require  # imports JAX, which `jaxcslc --help` does without

    del context
    shtab: Any = require("shtab", "completion")
    program = argparse.ArgumentParser("jaxcslc", description="Identify robot arms.")
    program.add_argument("--version", action="store_true", help="Print the version.")
    commands = program.add_subparsers()
    summaries = {name: text for row in SUMMARIES.values() for name, text in row.items()}
    for name in COMMANDS:
        known = command_named(name)
        parser = commands.add_parser(name, help=summaries[name], description=known.about)
        parser.add_argument("--help-all", action="store_true", help="Show all options.")
        for parameter, action in add_options(parser, known.parameters, old=False):
            action.choices = parameter.choices or None
            if parameter.item is Path:
                vars(action)["complete"] = shtab.FILE
        if any(parameter.option.positional for parameter in known.parameters):
            files = parser.add_argument("files", nargs="*", help="Robot and recordings.")
            vars(files)["complete"] = shtab.FILE
    return Output(shtab.complete(program, shell))
