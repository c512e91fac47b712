"""Cases by number: a command line, and the files that it is about, in a folder of their own."""

import json
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from scripts.tools.fuzz.mutations import (
    NUMBERS,
    WORDS,
    mutated_bytes,
    mutated_document,
    mutated_text,
)
from scripts.tools.fuzz.templates import BINARIES, ROBOTS, TABLES


class Case(NamedTuple):
    """A command line that the fuzzer tries.

    **Attributes**

    - `number`: that it follows from.
    - `kind`: what is mutated, a key of `KINDS`.
    - `arguments`: of the command `jaxcslc`.
    """

    number: int
    kind: str
    arguments: list[str]


def case(number: int, templates: Path, folder: Path) -> Case:
    """The case of a number; its files are written into an empty folder.

    The same number makes the same case, whatever was run before.
    """
    kind = kind_of(number)
    arguments = KINDS[kind][1](random.Random(f"case {number}"), templates, folder)
    return Case(number, kind, [str(argument) for argument in arguments])


def kind_of(number: int) -> str:
    """What the case of a number mutates."""
    shares = [share for share, _ in KINDS.values()]
    return random.Random(f"kind {number}").choices(list(KINDS), shares)[0]


Arguments = list[object]


def _robot(draw: random.Random, templates: Path, folder: Path) -> Arguments:
    """A robot file, derived, with some of the options of parts."""
    name = draw.choice(ROBOTS)
    path = _mutated(draw, templates, folder, name)
    options: Arguments = []
    if draw.random() < 0.3:
        parts = ("upper", "lower", "finger", "grip", "elbow", "*", "world", "none", "")
        options += [draw.choice(("--tip", "--fix", "--base")), draw.choice(parts)]
    elif name == "arm.urdf":
        options += draw.choice((["--fix", "grip"], ["--mimic", "couple"], ["--mimic", "fix"]))
    if draw.random() < 0.2:
        options += ["--lengths", draw.choice(("numeric", "symbolic", "auto", "a1", "b,,", ""))]
    if draw.random() < 0.2:
        options += ["-o", folder / "out"]
    return ["derive", path, *options]


def _system(draw: random.Random, templates: Path, folder: Path) -> Arguments:
    path = _mutated(draw, templates, folder, "system.toml")
    options: Arguments = ["-o", folder / "out"] if draw.random() < 0.3 else []
    return ["derive", path, *options]


def _table(draw: random.Random, templates: Path, folder: Path) -> Arguments:
    """A recording of text, checked."""
    path = _mutated(draw, templates, folder, draw.choice(TABLES))
    return ["check", templates / "arm.toml", path, *_reading(draw)]


def _binary(draw: random.Random, templates: Path, folder: Path) -> Arguments:
    """A recording of bytes, checked."""
    path = _mutated(draw, templates, folder, draw.choice(BINARIES))
    return ["check", templates / "arm.toml", path, *_reading(draw)]


def _mapping(draw: random.Random, templates: Path, folder: Path) -> Arguments:
    path = _mutated(draw, templates, folder, "mapping.toml")
    return ["check", templates / "arm.toml", templates / "log.csv", "--columns", path]


def _settings(draw: random.Random, templates: Path, folder: Path) -> Arguments:
    """Settings, with which a recording is identified."""
    path = _mutated(draw, templates, folder, "settings.json")
    recording = templates / "log.csv"
    if draw.random() < 0.1:
        recording = _mutated(draw, templates, folder, "log.csv")
    quick = ["--no-check", "--no-systematic"] if draw.random() < 0.8 else []
    arguments: Arguments = ["identify", templates / "arm.toml", recording, "--settings", path]
    return [*arguments, *quick, "-o", folder / "out"]


def _result(draw: random.Random, templates: Path, folder: Path) -> Arguments:
    """An identification, which other commands go on with."""
    path = _mutated(draw, templates, folder, "result/identification.json")
    arm, log, out = templates / "arm.toml", templates / "log.csv", folder / "out"
    lines: tuple[Arguments, ...] = (
        ["export", arm, path, "-o", folder / "out.toml"],
        ["export", arm, path, "--c", "-o", folder / "out.c"],
        ["compare", path, templates / "result", "-o", folder / "out.html"],
        ["identify", arm, log, "--settings", path, "--no-check", "--no-systematic", "-o", out],
        ["identify", arm, log, "--previous", path, "--reidentify", "viscous", "-o", out],
        ["payload", arm, log, "--previous", path, "-o", out],
    )
    return draw.choices(lines, (6, 2, 4, 1, 2, 2))[0]


def _limits(draw: random.Random, templates: Path, folder: Path) -> Arguments:
    """Limits, within which a motion is designed."""
    arguments: Arguments = ["excite", templates / "arm.toml", *_SHORT_SEARCH]
    if draw.random() < 0.5:
        arguments += ["--family", draw.choice(("splines", "fourier", "periodic", "moves", "x"))]
    arguments += ["--limits", _mutated(draw, templates, folder, "limits.toml")]
    return [*arguments, "-o", folder / "motion.csv"]


def _line(draw: random.Random, templates: Path, folder: Path) -> Arguments:
    """A command line of files that are whole, with options and values that may not belong."""
    names = (*ROBOTS, *TABLES, *BINARIES, "system.toml", "mapping.toml", "settings.json", "result")
    values: tuple[object, ...] = (
        *(templates / name for name in names),
        *NUMBERS,
        *WORDS,
        *("puma560", "panda", folder / "out", folder, "-", "--", "~", "/dev/null", "viscous,dry"),
        *("always", "never", "0.1", "fix", "couple", "auto", "maximum-likelihood", "local"),
        "instrumental-variables",
        *("splines", "moves", "error", "D", "likelihood", "regression", "kv1"),
        *("1,2", "1,2,-1", "inf,2", "1,1", "0,1", "0,9", "5,1", "numeric", "huber", "static"),
    )
    command = draw.choice(COMMANDS)
    arm, log, result = templates / "arm.toml", templates / "log.csv", templates / "result"
    settings: Arguments = ["--settings", templates / "settings.json"]
    whole: dict[str, Arguments] = {
        "derive": [arm],
        "check": [arm, log],
        "identify": [arm, log, *settings, "--no-check", "--no-systematic"],
        "compare": [result, result],
        "export": [arm, result / "identification.json"],
        "payload": [arm, log, "--previous", result / "identification.json"],
        "excite": [arm, "--limits", templates / "limits.toml", *_SHORT_SEARCH],
    }
    line = whole[command]
    if draw.random() < 0.4:
        line[draw.randrange(len(line))] = draw.choice(values)
    for _ in range(draw.choice((0, 1, 1, 2))):
        line += [draw.choice(OPTIONS), draw.choice(values)]
    if command in ("identify", "export", "payload", "excite"):
        line += ["-o", folder / _OUTPUT.get(command, "out")]
    if draw.random() < 0.1:
        draw.shuffle(line)
    return [draw.choices((command, "jaxcslc", ""), (97, 1, 2))[0], *line]


COMMANDS = ("derive", "check", "identify", "compare", "export", "payload", "excite")
# So that a search ends in a second.
_SHORT_SEARCH: Arguments = ["--duration", "1", "--rate", "50", "--starts", "1"]
_OUTPUT = {"export": "out.toml", "excite": "motion.csv"}
OPTIONS = (
    *("--base", "--tip", "--fix", "--friction", "--coupled", "--lengths", "--settings", "-o"),
    *("--columns", "--between", "--every", "--period", "--drop-stale", "--despike", "--loss"),
    *("--torque-lag", "--folds", "--validate", "--offsets", "--reidentify", "--previous", "--c"),
    *("--unloaded", "--mass", "--overwrite", "--help", "--version", "--nonsense"),
    *("--json", "--quiet", "--quality", "--physical", "--decimate", "--parameters", "--target"),
    *("--ml-spacing", "--torque", "--help-all", "--recorded", "--simulate"),
    *("--memory", "--possible", "--prior", "--no-motors", "--measured", "--no-check"),
    *("--mimic", "--estimator", "--dask", "--fleet", "--horizon", "--systematic", "--limits"),
    *("--duration", "--rate", "--family", "--for", "--criterion", "--after", "--reach", "--seed"),
    *("--torque-noise", "--encoder", "--task", "--start"),  # --starts would take as long as it says
)

KINDS: dict[str, tuple[int, Callable[[random.Random, Path, Path], Arguments]]] = {
    "robot": (34, _robot),
    "system": (5, _system),
    "table": (18, _table),
    "binary": (9, _binary),
    "mapping": (6, _mapping),
    "settings": (8, _settings),
    "result": (10, _result),
    "limits": (3, _limits),
    "line": (10, _line),
}
"""What is mutated: its share of the cases, and what makes one."""


def _reading(draw: random.Random) -> Arguments:
    if draw.random() < 0.85:
        return []
    option = draw.choice(("--between", "--every", "--period", "--drop-stale", "--despike"))
    values = ("0,2", "1,0.5", "nan,1", "-1,1e9", "2", "3", "0.01", "0", "-1", "1e300", "1e-300")
    return [option] if option in ("--drop-stale", "--despike") else [option, draw.choice(values)]


def _mutated(draw: random.Random, templates: Path, folder: Path, name: str) -> Path:
    """A mutation of a template, in the case's folder; of a bag, the whole of it."""
    source, path = templates / name, folder / Path(name).name
    data = source.read_bytes()
    if name in BINARIES:
        if source.parent != templates:
            folder = folder / source.parent.name
            shutil.copytree(source.parent, folder)
            path = folder / source.name
            if draw.random() < 0.3:  # what describes the bag
                path, source = folder / "metadata.yaml", folder / "metadata.yaml"
                path.write_bytes(mutated_text(source.read_text("utf-8"), draw))
                return folder
        data = mutated_bytes(data, draw)
    elif path.suffix == ".json" and draw.random() < 0.8:
        data = json.dumps(mutated_document(json.loads(data), draw)).encode()
    else:
        data = mutated_text(data.decode("utf-8"), draw)
    path.write_bytes(data)
    return path
