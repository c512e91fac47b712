"""Write docs/command.md, the reference of the command, from the command itself.

python -m scripts.tools.command_page
"""

import re
from pathlib import Path

from jaxcslc.cli._app import COMMANDS, command_named
from jaxcslc.cli._help import described, grouped, option_text, usage_of
from jaxcslc.cli._options import Parameter
from jaxcslc.cli._project import project_parameters


PAGE = Path(__file__).parents[2] / "docs" / "command.md"
_INTRODUCTION = """# The command

`jaxcslc COMMAND --help` shows the options that most people need, and the names of groups of
options. `--help GROUP` shows one group, and `--help-all` everything, as this page does.
`python -m jaxcslc` is the same program. This page is written by
`python -m scripts.tools.command_page`.

## All commands

- `--json` prints the result as JSON on standard output. `--quiet` prints errors alone.
- Wrong input ends a command with exit code 2 and one line on standard error. The line names the
  page that explains it.
- Options may stand before, between and after arguments. Lists have commas and no spaces.
- `jaxcslc completion bash` prints a script for your shell, which completes commands, options and
  files (`pip install "jaxcslc[completion]"`).
"""
_PROJECT = """## The project file

A file `jaxcslc.toml` says once what every command needs about a robot and its recordings. Commands
read it from the current folder. Options on the command line win. With `robot` in it, commands need
no `ROBOT`: `jaxcslc identify log.csv`. `jaxcslc init ROBOT LOG` writes it.

```toml
robot = "arm.urdf"
fix = ["finger_joint1", "finger_joint2"]

[columns.position]
columns = "q{number}"
unit = "deg"

[limits.surroundings]
floor = 0.0
```

| entry | meaning | as |
|---|---|---|
{rows}

`columns`, `limits` and `prior` are tables, or names of other TOML files. The tables have the
entries of those files: see [mapping columns](recordings.md#mapping-columns),
[limits](excitation.md) and [priors](uncertainty.md#priors). A command about another robot does not
use the file, and says so.
"""


def command_page() -> str:
    """Return the page, in Markdown."""
    entries = [
        f"| `{name}` | {_cell(parameter.option.help)} | `{_written(parameter)}` |"
        for name, parameter in project_parameters().items()
    ]
    parts = [_INTRODUCTION, _PROJECT.replace("{rows}", "\n".join(entries))]
    for name in COMMANDS:
        command = command_named(name)
        arguments = [some for some in command.parameters if some.option.positional]
        usage = " ".join(["jaxcslc", name, *map(usage_of, arguments), "[OPTIONS]"])
        about = "\n\n".join(" ".join(part.split()) for part in command.about.split("\n\n"))
        examples = "\n".join(f"jaxcslc {line}" for line in command.examples)
        parts.append(f"## {name}\n\n{about}\n\n```text\n{usage}\n```\n")
        parts.append(f"```sh\n{examples}\n```\n\nMore: [{command.page}.md]({command.page}.md).\n")
        if arguments:
            parts.append(_table("argument", [(some.metavar, some) for some in arguments]))
        for group, options in grouped(command.parameters).items():
            title = f"option of `{group}`" if group else "option"
            parts.append(_table(title, [(option_text(some), some) for some in options]))
    return "\n".join(parts)


def _table(title: str, rows: list[tuple[str, Parameter]]) -> str:
    lines = [f"| `{_cell(left)}` | {_cell(described(parameter))} |" for left, parameter in rows]
    return "\n".join([f"| {title} | meaning |\n|---|---|", *lines, ""])


def _written(parameter: Parameter) -> str:
    """Return how an entry is written in TOML."""
    if parameter.item is bool:
        return "true"
    if parameter.item in (int, float):
        return "number"
    if parameter.metavar in ("TERMS", "START,END", "I,J"):
        return "list" if not parameter.many else "list of lists"
    return "list" if parameter.many else "text"


def _cell(text: str) -> str:
    return re.sub(r"\s+", " ", text).strip().replace("|", "\\|")


if __name__ == "__main__":
    PAGE.write_text(command_page(), encoding="utf-8")
    print(f"wrote {PAGE}")
