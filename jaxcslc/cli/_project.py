"""The project file `jaxcslc.toml`: the robot, its part, and what its recordings need, said once.

Every command about a robot reads it from the current folder. Options on the command line win.
"""

import dataclasses
import functools
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from .._plain_data import toml_document
from .._text_table import printable
from ._options import Parameter, UsageError, Values


FILE = "jaxcslc.toml"
_ROBOT_FILES = (".toml", ".urdf", ".xml", ".mjcf")
_TABLES = ("columns", "limits", "prior")  # tables of the file, or names of other files
_QUANTITIES = ("time", "position", "velocity", "acceleration", "torque", "command", "current")


@dataclasses.dataclass(frozen=True)
class Project:
    """Values that a project file states, by the names of parameters; empty without a file."""

    values: Mapping[str, Any]

    @classmethod
    def here(cls) -> "Project":
        """Read the project file of the current folder.

        **Raises** `ValueError`: an unknown entry, or a value that it does not take; one line.
        """
        if not Path(FILE).is_file():
            return cls({})
        document = toml_document(FILE, "project file", ValueError)
        known = project_parameters()
        if unknown := sorted(document.keys() - known.keys()):
            table = f"[columns.{unknown[0]}]"
            meant = f"did you mean {table}? " if unknown[0] in _QUANTITIES else ""
            expected = ", ".join(known)
            raise ValueError(f"{FILE}: unknown entry {unknown[0]!r}; {meant}expected {expected}")
        return cls({name: _value(known[name], value) for name, value in document.items()})

    def applied(self, words: Sequence[str]) -> tuple[Values, list[str]]:
        """Return the values for a command, and the words that are its arguments, the robot first.

        A command about another robot has none of the values: they are about the file's robot.
        """
        from ._inputs import BUNDLED  # imports what commands on robots need

        robot = self.values.get("robot")
        others = {name: value for name, value in self.values.items() if name != "robot"}
        if words and (words[0] in BUNDLED or Path(words[0]).suffix.lower() in _ROBOT_FILES):
            same = robot is None or Path(words[0]).absolute() == Path(robot).absolute()
            if not same:
                note = f"note: {FILE} is about {robot}; not used for {words[0]}"
                print(printable(note), file=sys.stderr)
            return (others if same else {}), list(words)
        if robot is None and words:
            raise UsageError(
                f"{words[0]}: expected a robot first, as {', '.join(_ROBOT_FILES)} or a name, or"
                f" robot = ... in {FILE}"
            )
        return others, [*([] if robot is None else [robot]), *words]


def remedies_in_project(text: str) -> str:
    """Return the text of a check whose remedies change the project file's columns.

    >>> remedies_in_project('Remedy: [torque] unit = "mN m" in a mapping file (--columns)')
    'Remedy: [columns.torque] unit = "mN m" in jaxcslc.toml'
    """
    tables = rf"\[({'|'.join(_QUANTITIES)})\] "
    return re.sub(
        r"Remedy: [^\n]*? in a mapping file \(--columns\)",
        lambda remedy: (
            re.sub(tables, r"[columns.\1] ", remedy[0])
            .replace("Remedy: joints = ", "Remedy: [columns] joints = ")
            .replace("a mapping file (--columns)", FILE)
        ),
        text,
    )


@functools.cache
def project_parameters() -> Mapping[str, Parameter]:
    """Return the entries of a project file by name."""
    from ._inputs import PROJECT_PARAMETERS

    return {parameter.name: parameter for parameter in PROJECT_PARAMETERS}


def _value(parameter: Parameter, stated: Any) -> Any:
    """Return the value of an entry, as the command line would have it."""
    name = parameter.name
    if isinstance(stated, dict) and name in _TABLES:
        return Path(f"{FILE}#{name}")  # as a file: `toml_document` reads the table
    if parameter.item is bool:
        if not isinstance(stated, bool):
            raise ValueError(f"{FILE}, {name}: expected true or false, got {stated!r}")
        return stated
    entries = stated if parameter.many and isinstance(stated, list) else [stated]
    try:
        parsed = [parameter.parsed(_text(entry)) for entry in entries]
    except UsageError as error:
        expected = str(error).removeprefix(f"{parameter.shown_name}: ")
        raise ValueError(f"{FILE}, {name}: {expected}") from None
    return parsed if parameter.many else parsed[0]


def _text(value: Any) -> str:
    """Return a value of TOML as the command line has it: lists with commas."""
    if isinstance(value, list):
        return ",".join(map(_text, value))
    if isinstance(value, dict | bool):
        raise UsageError(f"expected a text, a number or a list, got {value!r}")
    return str(value)
