"""Texts of help: of the program, of a command, and of a group of its options."""

import shutil
import sysconfig
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path

from ._options import Parameter, UsageError, did_you_mean, usage_of


ALL = "all"
"""The group that stands for all of them."""

_LEFT, _LEFT_OF_COMMANDS = 26, 20  # columns of names
_WIDEST = 100
_PAGES = "share/doc/jaxcslc"  # as in pyproject.toml


def page_address(page: str) -> str:
    """Return a path that opens a page of the documentation, by the page's name.

    It is relative in a checkout's root, and absolute elsewhere: in the checkout whose sources run,
    or in the folder where the installed package has a copy of the pages.
    """
    address = Path("docs", f"{page}.md")
    schemes = (sysconfig.get_default_scheme(), sysconfig.get_preferred_scheme("user"))
    installed = [Path(sysconfig.get_path("data", scheme), _PAGES) for scheme in schemes]
    folders = [address.parent, Path(__file__).parents[2] / "docs", *installed]
    places = [folder / address.name for folder in folders]
    return str(next((place for place in places if place.is_file()), address))


def program_text(commands: Mapping[str, Mapping[str, str]]) -> str:
    """Return the help of the program: commands by what they are for, each with its summary."""
    width = _width()
    parts = [
        "usage: jaxcslc COMMAND ...",
        "Identify a robot arm's dynamic parameters from recordings of its motion.",
    ]
    for title, entries in commands.items():
        parts.append(_section(title, list(entries.items()), width, _LEFT_OF_COMMANDS))
    lines = [
        "jaxcslc COMMAND --help describes a command; jaxcslc --version prints the version",
        f"documentation: {page_address('index')}, {page_address('command')}",
    ]
    return "\n\n".join([*parts, "\n".join(lines)])


def help_text(
    name: str,
    about: str,
    parameters: Sequence[Parameter],
    examples: Sequence[str],
    page: str,
    group: str = "",
) -> str:
    """Return the help of a command.

    **Arguments**

    - `about`: what it does.
    - `parameters`: arguments and options.
    - `examples`: command lines.
    - `page`: of the documentation.
    - `group`: whose options are shown: empty for those of everybody, or `ALL`.

    **Raises** `UsageError` for an unknown group.
    """
    width = _width()
    arguments = [some for some in parameters if some.option.positional]
    groups = grouped(parameters)
    if group not in ("", ALL, *groups):
        known = [name for name in groups if name]
        meant = did_you_mean(group, known)
        raise UsageError(f"--help: expected {', '.join(known)}, got {group!r}{meant}")
    usage = " ".join(["usage: jaxcslc", name, *map(usage_of, arguments), "[OPTIONS]"])
    parts = [usage]
    if group in ("", ALL):
        paragraphs = (" ".join(part.split()) for part in about.split("\n\n"))
        parts += [textwrap.fill(text, width, break_on_hyphens=False) for text in paragraphs]
        if arguments:
            rows = [(some.metavar, described(some)) for some in arguments]
            parts.append(_section("arguments", rows, width))
    for title, options in groups.items():
        if group in (ALL, title):
            rows = [(option_text(some), described(some)) for some in options]
            parts.append(_section(f"options: {title}" if title else "options", rows, width))
    if group == "" and any(groups):
        rows = [
            (title, ", ".join(some.typed.removeprefix("--") for some in options))
            for title, options in groups.items()
            if title
        ]
        parts.append(_section("more options: --help GROUP, or --help-all", rows, width))
    if examples and group in ("", ALL):
        parts.append("\n".join(["examples", *(f"  jaxcslc {line}" for line in examples)]))
    return "\n\n".join([*parts, f"documentation: {page_address(page)}"])


def grouped(parameters: Sequence[Parameter]) -> dict[str, list[Parameter]]:
    """Return the options by their groups, those for everybody first, under an empty name."""
    groups: dict[str, list[Parameter]] = {"": []}
    for parameter in parameters:
        if not parameter.option.positional:
            groups.setdefault(parameter.option.group, []).append(parameter)
    return {title: options for title, options in groups.items() if options}


def option_text(parameter: Parameter) -> str:
    """Return an option as help shows it: `-o, --output FOLDER`."""
    names = ", ".join([*parameter.short_names, parameter.typed])
    return f"{names} {parameter.metavar}".rstrip()


def described(parameter: Parameter) -> str:
    """Return what help says about a parameter, with its default."""
    text, default = parameter.option.help, parameter.default
    if parameter.required or default is None or isinstance(default, bool):
        return text
    return f"{text} [{default}]"


def _section(title: str, rows: Sequence[tuple[str, str]], width: int, column: int = _LEFT) -> str:
    """Return a title above rows whose right texts begin in one column."""
    lines = [title]
    for left, right in rows:
        texts = textwrap.wrap(right, width - column, break_on_hyphens=False) or [""]
        if len(left) > column - 4:
            lines.append(f"  {left}")
            left = ""
        lines.append(f"  {left:<{column - 2}}{texts[0]}")
        lines += [" " * column + text for text in texts[1:]]
    return "\n".join(lines)


def _width() -> int:
    return min(shutil.get_terminal_size().columns, _WIDEST)
