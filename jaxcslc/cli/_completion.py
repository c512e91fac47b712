"""The command `jaxcslc completion`."""

import argparse
from pathlib import Path
from typing import Annotated, Any, Literal

from .._environment import require
from ._common import Context, Output, command
from ._options import add_options, argument


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
    from ._app import COMMANDS, SUMMARIES, command_named

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
