"""Write docs/command.md, the reference of the command, from the command itself.

python -m scripts.tools.command_page
"""

import re
from pathlib import Path
from typing import Any

import typer

from jaxcslc.cli._app import app


PAGE = Path(__file__).parents[2] / "docs" / "command.md"
_TYPES = {"Path": "FILE", "int": "NUMBER", "float": "NUMBER", "str": "TEXT"}


def command_page() -> str:
    """Return the page, in Markdown."""
    group: Any = typer.main.get_command(app)
    parts = [
        "# The command\n",
        "`jaxcslc COMMAND --help` prints the same. `python -m jaxcslc` is the same program."
        " This page is written by `python -m scripts.tools.command_page`.\n",
    ]
    for name, command in group.commands.items():
        arguments = [p for p in command.params if p.param_type_name == "argument"]
        options = [p for p in command.params if p.param_type_name == "option" and not p.hidden]
        usage = " ".join(["jaxcslc", name, *map(_argument, arguments), "[OPTIONS]"])
        rows = [(_argument(p), _text(p.help), "") for p in arguments]
        rows += [(_option(p), _text(p.help), _default(p)) for p in options]
        parts.append(f"## {name}\n\n{_text(command.help)}\n\n```text\n{usage}\n```\n")
        parts.append("| argument or option | | default |\n|---|---|---|")
        parts.append("\n".join(f"| `{a}` | {b} | {c} |" for a, b, c in rows) + "\n")
    return "\n".join(parts)


def _argument(parameter: Any) -> str:
    shown = parameter.metavar or parameter.name.upper()
    shown += "..." * (parameter.nargs == -1 and not shown.endswith("..."))
    return shown if parameter.required else f"[{shown}]"


def _option(parameter: Any) -> str:
    names = ", ".join(parameter.opts)
    if parameter.secondary_opts:
        names += " / " + ", ".join(parameter.secondary_opts)
    if parameter.is_flag:
        return names
    kind = getattr(parameter.type_descriptor.annotation, "__name__", "")
    return f"{names} {parameter.metavar or _TYPES.get(kind, 'VALUE')}".replace("|", "\\|")


def _default(parameter: Any) -> str:
    shown = parameter.default
    if shown is None or isinstance(shown, bool) or callable(shown):
        return ""
    return f"`{shown}`"


def _text(text: str | None) -> str:
    return re.sub(r"\s+", " ", text or "").strip().replace("|", "\\|")


if __name__ == "__main__":
    PAGE.write_text(command_page(), encoding="utf-8")
    print(f"wrote {PAGE}")
