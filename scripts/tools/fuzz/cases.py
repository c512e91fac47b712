"""Cases by number: command lines, and the files that they are about, in a folder of their own."""

import functools
import html
import json
import random
import shutil
import string
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq

from scripts.tools.fuzz.mutations import (
    NAMES,
    NUMBERS,
    WORDS,
    formula,
    mutated_bytes,
    mutated_document,
    mutated_text,
    renamed,
)
from scripts.tools.fuzz.templates import BINARIES, ROBOTS, TABLES


Arguments = list[Any]
Lines = list[Arguments]


class Case(NamedTuple):
    """Command lines that the fuzzer tries one after the other, until one of them fails.

    **Attributes**

    - `number`: that they follow from, and `seed`.
    - `kind`: what is mutated, a key of `KINDS`.
    - `lines`: arguments of the command `jaxcslc`.
    """

    number: int
    kind: str
    lines: list[list[str]]


def case(number: int, templates: Path, folder: Path, seed: int = 0) -> Case:
    """The case of a number; its files are written into an empty folder.

    The same number and seed make the same case, whatever was run before.
    """
    kind = kind_of(number, seed)
    lines = KINDS[kind][1](random.Random(f"case {seed} {number}"), templates, folder)
    return Case(number, kind, [[str(argument) for argument in line] for line in lines])


def kind_of(number: int, seed: int = 0) -> str:
    """What the case of a number mutates."""
    shares = [share for share, _ in KINDS.values()]
    return random.Random(f"kind {seed} {number}").choices(list(KINDS), shares)[0]


def _robot(draw: random.Random, templates: Path, folder: Path) -> Lines:
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
    return [["derive", path, *options, *_json(draw)]]


def _system(draw: random.Random, templates: Path, folder: Path) -> Lines:
    """A file of another system, derived, or identified."""
    path = _mutated(draw, templates, folder, "system.toml")
    if draw.random() < 0.3:
        log = templates / "system.csv"
        return [["identify", path, log, "-o", folder / "out", *_json(draw)]]
    options: Arguments = ["-o", folder / "out"] if draw.random() < 0.3 else []
    return [["derive", path, *options, *_json(draw)]]


def _formula(draw: random.Random, templates: Path, folder: Path) -> Lines:
    """A formula: of a system's equation, or of an angle or a length of a robot."""
    if draw.random() < 0.7:
        text = formula(draw, ("x", "m", "b", "c", "force", "dot(x)", "ddot(x)"))
        whole = f"force = m*ddot(x) + {text}" if draw.random() < 0.7 else text
        path = _replaced(
            templates, folder, "system.toml", "force = m*ddot(x) + b*dot(x) + c*x", whole
        )
    else:
        old, symbols = draw.choice((("-pi/2", ("pi",)), ("a1", ("a1", "a2"))))
        text = formula(draw, symbols, 3)
        path = _replaced(
            templates, folder, "every_key.toml", f'"{old}"', _toml_text(text), raw=True
        )
    return [["derive", path]]


def _table(draw: random.Random, templates: Path, folder: Path) -> Lines:
    """A recording of text, checked."""
    path = _mutated(draw, templates, folder, draw.choice(TABLES))
    return [["check", templates / "arm.toml", path, *_reading(draw), *_json(draw)]]


def _binary(draw: random.Random, templates: Path, folder: Path) -> Lines:
    """A recording of bytes, checked."""
    path = _mutated(draw, templates, folder, draw.choice(BINARIES))
    return [["check", templates / "arm.toml", path, *_reading(draw)]]


def _mapping(draw: random.Random, templates: Path, folder: Path) -> Lines:
    path = _mutated(draw, templates, folder, "mapping.toml")
    log = templates / draw.choice(("log.csv", "log.csv", "log.parquet", "log.npz", "bag.bag"))
    return [["check", templates / "arm.toml", log, "--columns", path]]


def _settings(draw: random.Random, templates: Path, folder: Path) -> Lines:
    """Settings, with which a recording is identified."""
    path = _mutated(draw, templates, folder, "settings.json")
    recording = templates / "log.csv"
    if draw.random() < 0.1:
        recording = _mutated(draw, templates, folder, "log.csv")
    quick = _QUICK if draw.random() < 0.8 else []
    arguments: Arguments = ["identify", templates / "arm.toml", recording, "--settings", path]
    return [[*arguments, *quick, "-o", folder / "out", *_json(draw)]]


def _prior(draw: random.Random, templates: Path, folder: Path) -> Lines:
    """What is known before a fit."""
    path = _mutated(draw, templates, folder, "prior.toml")
    return [[*_identify(templates), "--prior", path, "-o", folder / "out", *_json(draw)]]


def _result(draw: random.Random, templates: Path, folder: Path) -> Lines:
    """An identification, which other commands go on with."""
    path = _mutated(draw, templates, folder, "result/identification.json")
    arm, log, out = templates / "arm.toml", templates / "log.csv", folder / "out"
    lines: tuple[Arguments, ...] = (
        ["export", arm, path, "-o", folder / "out.toml", "--force"],
        ["export", arm, path, "--c", "-o", folder / "out.c"],
        ["compare", path, templates / "result", "-o", folder / "out.html"],
        ["identify", arm, log, "--settings", path, *_QUICK, "-o", out],
        ["identify", arm, log, "--previous", path, "--reidentify", "viscous", "-o", out],
        ["payload", arm, log, "--previous", path, "-o", out],
        [
            *("excite", arm, "--previous", path, "--limits", templates / "limits.toml"),
            *(*_SHORT_SEARCH, "-o", folder / "motion.csv"),
        ],
    )
    return [[*draw.choices(lines, (6, 2, 4, 1, 2, 2, 1))[0], *_json(draw)]]


def _limits(draw: random.Random, templates: Path, folder: Path) -> Lines:
    """Limits, within which a motion is designed."""
    arguments: Arguments = ["excite", templates / "arm.toml", *_SHORT_SEARCH]
    if draw.random() < 0.5:
        arguments += ["--family", draw.choice(("splines", "fourier", "periodic", "moves", "x"))]
    arguments += ["--limits", _mutated(draw, templates, folder, "limits.toml")]
    return [[*arguments, "-o", folder / "motion.csv", *_json(draw)]]


def _project(draw: random.Random, templates: Path, folder: Path) -> Lines:
    """A project file in the folder where commands run."""
    for name in ("arm.toml", "log.csv", "settings.json"):
        shutil.copy(templates / name, folder)
    _mutated(draw, templates, folder, "jaxcslc.toml")
    lines: tuple[Arguments, ...] = (
        ["check", "log.csv"],
        ["derive"],
        ["identify", "log.csv", *_QUICK, "-o", "out"],
        ["excite", *_SHORT_SEARCH],
        ["init", "arm.toml", "log.csv", "--overwrite"],
    )
    return [[*draw.choice(lines), *_json(draw)]]


def _init(draw: random.Random, templates: Path, folder: Path) -> Lines:
    """A project file that is made of a robot and a log, and used."""
    robot, log = templates / "arm.toml", templates / draw.choice(TABLES)
    if draw.random() < 0.5:
        robot = _mutated(draw, templates, folder, draw.choice(ROBOTS))
    else:
        log = _mutated(draw, templates, folder, draw.choice((*TABLES, *BINARIES)))
    return [["init", robot, log, *_json(draw)], ["check", log]]


def _constants(draw: random.Random, templates: Path, folder: Path) -> Lines:
    """Torque constants, of recordings without and with a payload."""
    log, other = templates / "log.csv", templates / "log.npz"
    if draw.random() < 0.5:
        log = _mutated(draw, templates, folder, "log.csv")
    mass: Arguments = ["--mass", draw.choice((*NUMBERS, "1", "2"))]
    settings: Arguments = ["--settings", templates / "settings.json"]
    return [
        ["torque-constants", templates / "arm.toml", log, other, *mass, *settings, *_json(draw)]
    ]


def _servo(draw: random.Random, templates: Path, folder: Path) -> Lines:
    """An arm of position servos."""
    arm, log = templates / "servos.toml", templates / "servos.csv"
    if draw.random() < 0.5:
        arm = _mutated(draw, templates, folder, arm.name)
    else:
        log = _mutated(draw, templates, folder, log.name)
    servo = [arm, log, "--drive", "servo", *_json(draw)]
    return [["check", *servo], ["identify", *servo, "-o", folder / "out"]]


def _names(draw: random.Random, templates: Path, folder: Path) -> Lines:
    """A hostile name wherever a name can stand, and all that goes on with it."""
    kinds: tuple[Callable[..., Lines], ...] = (
        *(_named_robot, _named_robot, _named_robot),
        *(_named_table, _named_system, _named_file, _named_knowledge),
    )
    return draw.choice(kinds)(draw, templates, folder)


def _named_robot(draw: random.Random, templates: Path, folder: Path) -> Lines:
    name = draw.choice(ROBOTS)
    own = {
        "arm.urdf": ["arm", "floor", "upper", "lower", "finger", "shoulder", "elbow", "grip"],
        "arm.xml": ["arm", "upper", "lower", "shoulder", "elbow"],
    }.get(name, ["arm", "shoulder", "elbow", "a1"])
    quote = _toml_inside if name.endswith("toml") else functools.partial(html.escape, quote=True)
    text = (templates / name).read_text("utf-8")
    for _ in range(draw.choice((1, 1, 2, 4))):
        text = renamed(text, draw.choice(own), draw, quote)
    path = folder / name
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    fixed: Arguments = ["--mimic", "fix"] if name == "arm.urdf" else []
    out, log = folder / "out", templates / "log.csv"
    result: Arguments = ["identify", path, log, "--settings", templates / "settings.json", *_QUICK]
    ends: tuple[Lines, ...] = (
        [["export", path, out, "--c", "-o", folder / "code.c", "--force"]],
        [["export", path, out, "-o", folder / f"new{path.suffix}", "--force"]],
        [["export", path, out, "--c", "--force"]],
        [["compare", out, out, "-o", folder / "page.html"]],
        [["excite", path, "--previous", out, *_SHORT_SEARCH, *_within(templates, draw)]],
        [["payload", path, log, "--previous", out, "-o", folder / "payload"]],
    )
    if draw.random() < 0.3:
        return [["derive", path, *fixed, "-o", folder / "tables", *_json(draw)]]
    return [[*result, *fixed, "-o", out, *_json(draw)], *draw.choice(ends)]


def _named_table(draw: random.Random, templates: Path, folder: Path) -> Lines:
    """Names of columns, joints in them included, of tables of any kind."""
    table = pacsv.read_csv(templates / draw.choice(TABLES))
    names = list(table.column_names)
    for _ in range(draw.choice((1, 1, 3))):
        place, other = draw.randrange(len(names)), draw.choice(NAMES)
        names[place] = draw.choice(
            (other, f"position_{other}", f"q_{other} [deg]", names[place][:3])
        )
    kind = draw.choice((".csv", ".parquet", ".npz"))
    path = folder / f"log{kind}"
    columns = [np.asarray(column) for column in table.columns]
    if kind == ".csv":
        header = ",".join(f'"{n.replace(chr(34), 2 * chr(34))}"' for n in names)
        np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="")
    elif kind == ".parquet":
        pq.write_table(pa.Table.from_arrays([pa.array(c) for c in columns], names=names), path)
    else:
        pairs = zip(names, columns, strict=True)
        entries: dict[str, Any] = {n.replace("/", "|") or "x": c for n, c in pairs}
        with path.open("wb") as file:
            np.savez(file, **entries)
    line: Arguments = draw.choice(
        (["check", templates / "arm.toml"], ["init", templates / "arm.toml"])
    )
    return [[*line, path, *_json(draw)]]


def _named_system(draw: random.Random, templates: Path, folder: Path) -> Lines:
    text = (templates / "system.toml").read_text("utf-8")
    for _ in range(draw.choice((1, 2))):
        own = draw.choice(("mass on a spring", "x", "force", "m", "b", "c", "motion", "N/m"))
        text = renamed(text, own, draw, _toml_inside)
    path = folder / "system.toml"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    out = folder / "out"
    return [["derive", path, "-o", out], ["identify", path, templates / "system.csv", "-o", out]]


def _named_file(draw: random.Random, templates: Path, folder: Path) -> Lines:
    """Hostile names of files and folders: read, and written."""
    usable = [name for name in NAMES if "/" not in name and name.strip(". ") and len(name) < 200]
    name = draw.choice(usable)
    here = folder / name
    here.mkdir()
    log = here / f"{name}.csv"
    arm = here / f"{name}.toml"
    shutil.copy(templates / "log.csv", log)
    shutil.copy(templates / "arm.toml", arm)
    settings: Arguments = ["--settings", templates / "settings.json"]
    out = here / draw.choice(usable)
    ends: tuple[Lines, ...] = (
        [["export", arm, out, "-o", here / "x" / f"{draw.choice(usable)}.toml", "--force"]],
        [["export", arm, out, "--c", "-o", here / f"{draw.choice(usable)}.c", "--force"]],
        [["compare", out, out, "-o", here / f"{draw.choice(usable)}.html"]],
        [["identify", arm, log, *settings, *_QUICK, "-o", out]],
        [["example", draw.choice(("ur5", name)), "-o", here / draw.choice(usable)]],
        [["completion", draw.choice(("bash", "zsh", "fish", name))]],
        [["derive", arm, "-o", out]],
        [["derive", arm, "-o", here]],
        [["derive", arm, "-o", arm]],
    )
    return [["identify", arm, log, *settings, *_QUICK, "-o", out], *draw.choice(ends)]


def _named_knowledge(draw: random.Random, templates: Path, folder: Path) -> Lines:
    """Names in mappings, limits and priors."""
    name, own = draw.choice(
        (
            ("mapping.toml", ("shoulder", "elbow", "time", "position_1", "deg", "A")),
            ("limits.toml", ("shoulder", "elbow", "joints", "boxes", "floor")),
            ("prior.toml", ("kv1", "shoulder", "mass", "links", "coefficients")),
        )
    )
    text = renamed((templates / name).read_text("utf-8"), draw.choice(own), draw, _toml_inside)
    path = folder / name
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    arm, log, out = templates / "arm.toml", templates / "log.csv", folder / "out"
    return {
        "mapping.toml": [["check", arm, log, "--columns", path]],
        "limits.toml": [["excite", arm, *_SHORT_SEARCH, "--limits", path, "-o", folder / "m.csv"]],
        "prior.toml": [[*_identify(templates), "--prior", path, "-o", out]],
    }[name]


def _line(draw: random.Random, templates: Path, folder: Path) -> Lines:
    """A command line of files that are whole, with options and values that may not belong."""
    names = (*ROBOTS, *TABLES, *BINARIES, "system.toml", "mapping.toml", "settings.json", "result")
    values: tuple[object, ...] = (
        *(templates / name for name in names),
        *NUMBERS,
        *WORDS,
        *(name for name in NAMES if name[:1] not in ("/", ".", "~")),  # within the case's folder
        *("puma560", "panda", folder / "out", folder, "-", "--", "~", "/dev/null", "viscous,dry"),
        *("always", "never", "0.1", "fix", "couple", "auto", "maximum-likelihood"),
        *("instrumental-variables", "bash", "ur5", "servo", "degrees", "normalised"),
        *("splines", "moves", "error", "D", "likelihood", "regression", "kv1"),
        *("1,2", "1,2,-1", "inf,2", "1,1", "0,1", "0,9", "5,1", "numeric", "huber", "static"),
    )
    command = draw.choice(COMMANDS)
    arm, log, result = templates / "arm.toml", templates / "log.csv", templates / "result"
    whole: dict[str, Arguments] = {
        "derive": [arm],
        "check": [arm, log],
        "identify": _identify(templates)[1:],
        "compare": [result, result],
        "export": [arm, result / "identification.json"],
        "payload": [arm, log, "--previous", result / "identification.json"],
        "excite": [arm, "--limits", templates / "limits.toml", *_SHORT_SEARCH],
        "init": [arm, log],
        "torque-constants": [arm, log, templates / "log.npz", "--mass", "1"],
        "example": ["ur5"],
        "completion": ["bash"],
    }
    line = whole[command]
    if draw.random() < 0.4:
        line[draw.randrange(len(line))] = draw.choice(values)
    for _ in range(draw.choice((0, 1, 1, 2))):
        line += [draw.choice(OPTIONS), draw.choice(values)]
    if command in ("identify", "export", "payload", "excite", "example"):
        line += ["-o", folder / _OUTPUT.get(command, "out")]
    if draw.random() < 0.1:
        draw.shuffle(line)
    return [[draw.choices((command, "jaxcslc", ""), (97, 1, 2))[0], *line]]


COMMANDS = (
    *("derive", "check", "identify", "compare", "export", "payload", "excite", "init"),
    *("torque-constants", "example", "completion"),
)
# So that a search ends in a second.
_SHORT_SEARCH: Arguments = ["--duration", "1", "--rate", "50", "--starts", "1"]
_QUICK: Arguments = ["--no-check", "--no-systematic"]
_OUTPUT = {"export": "out.toml", "excite": "motion.csv"}
OPTIONS = (
    *("--base", "--tip", "--fix", "--friction", "--coupled", "--lengths", "--settings", "-o"),
    *("--columns", "--between", "--every", "--period", "--drop-stale", "--despike", "--loss"),
    *("--torque-lag", "--folds", "--validate", "--offsets", "--reidentify", "--previous", "--c"),
    *("--unloaded", "--mass", "--overwrite", "--help", "--version", "--nonsense", "--force"),
    *("--json", "--quiet", "--quality", "--physical", "--decimate", "--parameters", "--target"),
    *("--ml-spacing", "--torque", "--help-all", "--recorded", "--simulate", "--drive"),
    *("--memory", "--possible", "--prior", "--no-motors", "--measured", "--no-check"),
    *("--mimic", "--estimator", "--fleet", "--horizon", "--systematic", "--limits"),
    *("--duration", "--rate", "--family", "--for", "--criterion", "--after", "--reach", "--seed"),
    *("--torque-noise", "--encoder", "--task", "--start", "--units", "--calibration", "--loaded"),
    *("--centre", "--table"),  # --starts would take as long as it says
)

KINDS: dict[str, tuple[int, Callable[[random.Random, Path, Path], Lines]]] = {
    "robot": (22, _robot),
    "system": (4, _system),
    "formula": (6, _formula),
    "names": (15, _names),
    "table": (12, _table),
    "binary": (9, _binary),
    "mapping": (5, _mapping),
    "settings": (5, _settings),
    "prior": (3, _prior),
    "project": (3, _project),
    "init": (2, _init),
    "constants": (1, _constants),
    "servo": (2, _servo),
    "result": (8, _result),
    "limits": (3, _limits),
    "line": (9, _line),
}
"""What is mutated: its share of the cases, and what makes one."""


def _identify(templates: Path) -> Arguments:
    arm, log = templates / "arm.toml", templates / "log.csv"
    return ["identify", arm, log, "--settings", templates / "settings.json", *_QUICK]


def _within(templates: Path, draw: random.Random) -> Arguments:
    return ["--limits", templates / "limits.toml"] if draw.random() < 0.8 else []


def _json(draw: random.Random) -> Arguments:
    return draw.choices(([], ["--json"], ["--quiet"]), (8, 2, 1))[0]


def _reading(draw: random.Random) -> Arguments:
    if draw.random() < 0.85:
        return []
    option = draw.choice(("--between", "--every", "--period", "--drop-stale", "--despike"))
    values = ("0,2", "1,0.5", "nan,1", "-1,1e9", "2", "3", "0.01", "0", "-1", "1e300", "1e-300")
    return [option] if option in ("--drop-stale", "--despike") else [option, draw.choice(values)]


def _toml_text(text: str) -> str:
    """A text as TOML has it, quoted."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _toml_inside(name: str) -> str:
    """A name within quotes of TOML; as it stands where it needs no escape."""
    plain = set(string.ascii_letters + string.digits + "_-")
    return name if set(name) <= plain else _toml_text(name)[1:-1]


def _replaced(
    templates: Path, folder: Path, name: str, old: str, new: str, *, raw: bool = False
) -> Path:
    """A template with another text in place of one; `raw`: which is quoted already."""
    path = folder / name
    text = (templates / name).read_text("utf-8")
    path.write_text(text.replace(old, new if raw else _toml_text(new)[1:-1]), encoding="utf-8")
    return path


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
        data = _other_names(mutated_bytes(data, draw), draw)
    elif path.suffix == ".json" and draw.random() < 0.8:
        data = json.dumps(mutated_document(json.loads(data), draw)).encode()
    else:
        data = mutated_text(data.decode("utf-8"), draw)
    path.write_bytes(data)
    return path


def _other_names(data: bytes, draw: random.Random) -> bytes:
    """Bytes with hostile names of the same length, in one of twenty."""
    if draw.random() < 0.95:
        return data
    own: Any = draw.choice((b"shoulder", b"elbow", b"position", b"/joints", b"sensor_msgs"))
    other = draw.choice(NAMES).encode()[: len(own)].ljust(len(own), b"x")
    return data.replace(own, other)
