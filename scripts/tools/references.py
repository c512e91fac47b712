"""Writes reference outputs of the command `jaxcslc`, and compares two sets of them.

A change that must not change any number is made between two sets: one of the code before it, one of
the code after it. Each reference is a folder with all that some commands write and print: robots
identified from simulated and real recordings, robot files and C code of them, a derivation, a
check, a designed motion. Only the command line is used, so that the same references can be had of
different code.

    python -m scripts.tools.references write build/before
    python -m scripts.tools.references write build/after --code ../changed --inputs build/before
    python -m scripts.tools.references compare build/before build/after

Commands get a recording by the same relative path in every set, and print no time of theirs: two
sets of the same code are equal. Real recordings are read from `../shared/data` beside the
repository; references of those that are missing are left out, and named.

**Numbers.** Coefficients differ in their standard errors (`DIRECT`, or `SEARCHED` where a search
with a tolerance has found them); other numbers by a part of themselves, and in text by one more
unit of the last digit printed. Numbers that are nearly zero beside others of their array or column
are taken as a part of `FLOOR` times the greatest. Everything else must be equal: words, counts,
keys and files. Keys and files that only the new set has are listed and are no difference.
"""

import argparse
import csv
import json
import math
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float


ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data"
FLOOR = 1e-5
_INPUTS = "inputs"
_ABOUT = "about.json"
_SHOWN = 10  # differences of a reference that are listed


class Limits(NamedTuple):
    """What two numbers may differ by: coefficients in standard errors, others relatively."""

    errors: float
    relative: float


DIRECT = Limits(1e-9, 1e-7)
SEARCHED = Limits(1e-3, 1e-3)


class Reference(NamedTuple):
    """Commands that are run one after another in a folder of their own.

    **Attributes**

    - `name`: of the folder.
    - `commands`: lines for `jaxcslc`.
    - `limits`: of numbers in what they write.
    - `real`: folder of the real recordings that they read, if any.
    """

    name: str
    commands: tuple[str, ...]
    limits: Limits = DIRECT
    real: str | None = None


_A = "identify puma560 ../inputs/puma_a.csv"
_VALIDATE_A = "--validate ../inputs/puma_a_validation.csv"
_ARM = "../inputs/{0}.toml ../inputs/{0}.csv"

REFERENCES = (
    Reference(
        "puma_a",
        (
            f"{_A} {_VALIDATE_A} -o identified",
            "export puma560 identified -o robot.toml",
            "export puma560 identified --c -o model.c",
        ),
    ),
    Reference(
        "puma_b",
        (
            "identify puma560 ../inputs/puma_b.csv --validate ../inputs/puma_b_validation.csv"
            " -o identified",
            "export puma560 identified -o robot.toml",
            "export puma560 identified --c -o model.c",
        ),
    ),
    Reference(
        "puma_b_mjcf",
        (
            "identify ../inputs/puma560.xml ../inputs/puma_b.csv -o identified",
            "export ../inputs/puma560.xml identified -o robot.xml",
            "export ../inputs/puma560.xml identified --no-motors -o robot_without_motors.xml",
            "export ../inputs/puma560.xml identified --c -o model.c",
        ),
    ),
    Reference(
        "kr300",
        (
            "identify ../inputs/kuka_kr300/kr300.toml ../inputs/kuka_kr300/A.csv"
            " --validate ../inputs/kuka_kr300/B.csv -o identified",
            "export ../inputs/kuka_kr300/kr300.toml identified -o robot.toml",
            "export ../inputs/kuka_kr300/kr300.toml identified --c -o model.c",
        ),
        real="kuka_kr300",
    ),
    Reference(
        "panda",
        (
            "identify panda ../inputs/franka_panda/training.csv"
            " --validate ../inputs/franka_panda/validation.csv"
            " --columns ../inputs/franka_panda/columns.toml --friction viscous,dry,offset"
            " --measured -o identified",
            "export panda identified -o robot.toml",
            "export panda identified --c -o model.c",
        ),
        real="franka_panda",
    ),
    Reference(
        "tx40",
        (
            "identify tx40 ../inputs/staubli_tx40/training.csv"
            " --validate ../inputs/staubli_tx40/validation.csv --measured -o identified",
            "export tx40 identified -o robot.toml",
            "export tx40 identified --c -o model.c",
        ),
        SEARCHED,
        real="staubli_tx40",
    ),
    Reference(
        "lwr4",
        (
            "identify ../inputs/kuka_lwr4/kuka_lwr4.urdf ../inputs/kuka_lwr4/hw1.csv"
            " --validate ../inputs/kuka_lwr4/hw3.csv -o identified",
            "export ../inputs/kuka_lwr4/kuka_lwr4.urdf identified -o robot.urdf",
            "export ../inputs/kuka_lwr4/kuka_lwr4.urdf identified --no-motors"
            " -o robot_without_motors.urdf",
            "export ../inputs/kuka_lwr4/kuka_lwr4.urdf identified --c -o model.c",
        ),
        real="kuka_lwr4",
    ),
    Reference(
        "lwr4_prior",
        (
            "identify ../inputs/kuka_lwr4/kuka_lwr4.urdf ../inputs/kuka_lwr4/hw1.csv"
            " --validate ../inputs/kuka_lwr4/hw3.csv --prior ../inputs/kuka_lwr4/prior.toml"
            " -o identified",
        ),
        real="kuka_lwr4",
    ),
    Reference(
        "several",
        (
            f"{_A} ../inputs/puma_a_second.csv {_VALIDATE_A} --offsets -o identified",
            "export puma560 identified -o robot.toml",
        ),
    ),
    Reference(
        "likelihood",
        (
            f"{_A} {_VALIDATE_A} --estimator maximum-likelihood -o identified",
            "export puma560 identified -o robot.toml",
        ),
        SEARCHED,
    ),
    Reference(
        "instruments", (f"{_A} --estimator instrumental-variables -o identified",), SEARCHED
    ),
    Reference(
        "pre_sliding",
        (
            f"identify {_ARM.format('pre_sliding')} --friction auto --horizon -o identified",
            "export ../inputs/pre_sliding.toml identified -o robot.toml",
            "export ../inputs/pre_sliding.toml identified --c -o model.c",
        ),
        SEARCHED,
    ),
    Reference(
        "load_friction",
        (
            f"identify {_ARM.format('load_friction')} -o identified",
            "export ../inputs/load_friction.toml identified --c -o model.c",
        ),
        SEARCHED,
    ),
    Reference(
        "static_friction",
        (f"{_A} {_VALIDATE_A} --friction viscous,dry,static -o identified",),
        SEARCHED,
    ),
    Reference(
        "coupled",
        (
            f"identify {_ARM.format('coupled')} -o identified",
            "export ../inputs/coupled.toml identified -o robot.toml",
            "export ../inputs/coupled.toml identified --c -o model.c",
        ),
    ),
    Reference(
        "reidentified",
        (
            f"{_A} -o identified",
            "identify puma560 ../inputs/puma_a_second.csv --reidentify viscous,dry"
            " --previous identified -o friction",
            "compare identified friction -o comparison.html",
        ),
    ),
    Reference(
        "payload",
        (
            f"{_A} -o identified",
            "payload puma560 ../inputs/puma_a_loaded.csv --previous identified/identification.json"
            " --unloaded ../inputs/puma_a_second.csv -o payload",
        ),
    ),
    Reference(
        "system",
        (
            "derive ../inputs/cart_pole.toml -o derived",
            f"identify {_ARM.format('cart_pole')} -o identified",
        ),
    ),
    Reference(
        "searched_system",
        (f"identify {_ARM.format('tank')} -o identified",),
        SEARCHED,
    ),
    Reference("derived_puma560", ("derive puma560 -o derived",)),
    Reference("derived_panda", ("derive panda -o derived",)),
    Reference("checked", ("check puma560 ../inputs/puma_a.csv ../inputs/puma_a_loaded.csv",)),
    Reference(
        "designed",
        ("excite ../inputs/pre_sliding.toml -o motion.csv --duration 2 --rate 100 --starts 1"
         " --limits ../inputs/limits.toml",),
        SEARCHED,
    ),
)  # fmt: skip
"""All references, in the order in which they are written."""

_PANDA_COLUMNS = """\
[time]
columns = "t_s"

[position]
columns = "q{number}"

[torque]
columns = "tau_J_{number}"
"""
_LWR4_PRIOR = """\
[coefficients]
kv2 = { value = 10.0, error = 5.0 }
kd3 = { low = 0.0 }
"""
_LIMITS = """\
[joints]
position = [-1.5, 1.5]
velocity = 2.0
torque = [40.0, 20.0]
"""
_TWO_LINKS = """\
gravity = [0, -9.81, 0]
{robot}
[[joint]]
[[joint]]
a = 0.3
"""
_CART_POLE = """\
name = "cart with a driven pole"

[variables]
x = { unit = "m" }
theta = { unit = "rad" }
force = { unit = "N" }
torque = { unit = "N m" }

[constants]
M = { unit = "kg", sign = "positive" }
m = { unit = "kg", sign = "positive" }
l = { unit = "m", sign = "positive" }
b = { unit = "N s/m" }
g = { unit = "m/s²", value = 9.81 }

[equations]
cart = "force = (M + m)*ddot(x) + m*l*(ddot(theta)*cos(theta) - dot(theta)^2*sin(theta)) + b*dot(x)"
pole = "torque = m*l^2*ddot(theta) + m*l*ddot(x)*cos(theta) - m*g*l*sin(theta)"

[units]
cart = "N"
pole = "N m"
"""
_TANK = """\
name = "tank"

[variables]
level = { unit = "m" }
inflow = { unit = "m³/s" }

[constants]
area = { unit = "m²", sign = "positive" }
outlet = { sign = "positive" }
n = { bounds = [0.2, 1.0] }

[equations]
volume = "inflow = area*dot(level) + outlet*level^n"

[units]
volume = "m³/s"
"""


def write_inputs(folder: Path, data: Path) -> None:
    """Write what the commands read: recordings, robots and files of settings.

    **Arguments**

    - `data`: folder of real recordings; those that are missing are left out.
    """
    folder.mkdir(parents=True, exist_ok=True)
    _write_simulated(folder)
    shutil.copy(ROOT / "tests" / "data" / "puma560.xml", folder)
    (folder / "limits.toml").write_text(_LIMITS, encoding="utf-8")
    for name, (robot, torque) in _TWO_LINK_ARMS.items():
        text = _TWO_LINKS.format(robot=robot)
        (folder / f"{name}.toml").write_text(text, encoding="utf-8")
        _write_two_links(folder / f"{name}.csv", torque)
    _write_systems(folder)
    for name, copy in _REAL.items():
        if (data / name).is_dir():
            (folder / name).mkdir(exist_ok=True)
            copy(data / name, folder / name)


def _write_simulated(folder: Path) -> None:
    """Recordings of PUMA A and PUMA B with every disturbance of theirs."""
    import dataclasses

    import jaxcslc as jc
    import sim

    ball = jc.LinkParameters(1.5, np.array([0.0, 0.0, 0.1]), np.diag([0.006, 0.006, 0.006]))
    for name, machine in (("puma_a", sim.puma_a()), ("puma_b", sim.puma_b())):
        training = sim.training(samples=1500, robot=machine.robot)
        loaded = dataclasses.replace(training, loads=(sim.Load(0.0, ball),))
        trajectories = {
            "": (training, 1),
            "_second": (training, 2),
            "_validation": (sim.comparison(), 3),
            "_loaded": (loaded, 4),
        }
        for suffix, (trajectory, seed) in trajectories.items():
            recording, _ = sim.simulate(machine, trajectory, seed=seed)
            jc.save_recording(recording, folder / f"{name}{suffix}.csv")


_Motion = tuple[np.ndarray, np.ndarray, np.ndarray]
_Torque = Callable[[_Motion, np.ndarray], np.ndarray]


def _coupled(motion: _Motion, rigid: np.ndarray) -> np.ndarray:
    """Friction of both joints, and a shaft that turns with both."""
    _, velocity, acceleration = motion
    shaft = velocity.sum(axis=1)
    shared = 0.2 * shaft + 0.3 * np.sign(shaft)
    return (
        rigid
        + 0.05 * acceleration[:, ::-1]
        + 0.3 * velocity
        + 0.4 * np.sign(velocity)
        + shared[:, None]
    )


def _load_friction(motion: _Motion, rigid: np.ndarray) -> np.ndarray:
    """Dry friction that rises with the torque of the links."""
    _, velocity, _ = motion
    return rigid + 0.3 * velocity + np.sign(velocity) * (0.4 + 0.1 * np.abs(rigid))


def _pre_sliding(motion: _Motion, rigid: np.ndarray) -> np.ndarray:
    """Dry friction that yields over 0.04 rad before it slides."""
    position, velocity, _ = motion
    state = np.zeros_like(position)
    for row, change in enumerate(np.diff(position, axis=0), start=1):
        sign = np.sign(change)
        state[row] = sign + (state[row - 1] - sign) * np.exp(-np.abs(change) / 0.04)
    return rigid + 0.3 * velocity + 0.4 * state


_TWO_LINK_ARMS: Mapping[str, tuple[str, _Torque]] = {
    "coupled": ("coupled = [[1, 2]]", _coupled),
    "load_friction": ('friction = ["viscous", "dry", "load"]', _load_friction),
    "pre_sliding": ("", _pre_sliding),
}


def _write_two_links(path: Path, torque: _Torque) -> None:
    """A recording of 10 s of an arm of two links in a vertical plane."""
    t = np.arange(2000) * 0.005
    q1, q2 = (_multisine(t, seed, 0.5) for seed in (1, 2))
    mass_1, mass_2, moment = 0.5, 0.12, 0.18  # inertias [kg m²], and mass times both lengths
    c, s = moment * np.cos(q2[0]), moment * np.sin(q2[0])
    upper = 9.81 * 1.4 * np.cos(q1[0])
    lower = 9.81 * 0.6 * np.cos(q1[0] + q2[0])
    coriolis = s * (2 * q1[1] * q2[1] + q2[1] ** 2)
    rigid = np.stack(
        [
            (mass_1 + mass_2 + 2 * c) * q1[2] + (mass_2 + c) * q2[2] - coriolis + upper + lower,
            (mass_2 + c) * q1[2] + mass_2 * q2[2] + s * q1[1] ** 2 + lower,
        ],
        axis=1,
    )
    motion = (*(np.stack(pair, axis=1) for pair in zip(q1, q2, strict=True)),)
    position, velocity, acceleration = motion
    noise = 0.02 * np.random.default_rng(0).normal(size=rigid.shape)
    measured = torque((position, velocity, acceleration), rigid) + noise
    columns = {
        "time": t,
        **{f"position_{i + 1}": np.round(position[:, i], 5) for i in range(2)},
        **{f"torque_{i + 1}": measured[:, i] for i in range(2)},
    }
    _write_columns(path, columns)


def _write_systems(folder: Path) -> None:
    """Systems that are no manipulators, and recordings of theirs."""
    t = np.arange(2000) * 0.01
    rng = np.random.default_rng(0)
    x, angle = (_multisine(t, seed, 0.5) for seed in (3, 4))
    c, s = np.cos(angle[0]), np.sin(angle[0])
    force = 1.25 * x[2] + 0.075 * (angle[2] * c - angle[1] ** 2 * s) + 0.6 * x[1]
    torque = 0.0225 * angle[2] + 0.075 * (x[2] * c - 9.81 * s)
    (folder / "cart_pole.toml").write_text(_CART_POLE, encoding="utf-8")
    columns = {
        "time": t,
        "x": x[0] + 2e-5 * rng.normal(size=t.shape),
        "theta": angle[0] + 5e-5 * rng.normal(size=t.shape),
        "force": force + 0.02 * rng.normal(size=t.shape),
        "torque": torque + 0.005 * rng.normal(size=t.shape),
    }
    _write_columns(folder / "cart_pole.csv", columns)

    wave = _multisine(t, 5, 0.4)
    inflow = 3.0 * wave[1] + 0.5 * np.sqrt(2 + wave[0])
    (folder / "tank.toml").write_text(_TANK, encoding="utf-8")
    columns = {
        "time": t,
        "level": 2 + wave[0] + 1e-5 * rng.normal(size=t.shape),
        "inflow": inflow + 1e-3 * rng.normal(size=t.shape),
    }
    _write_columns(folder / "tank.csv", columns)


def _multisine(t: np.ndarray, seed: int, size: float) -> _Motion:
    """A motion of five sines of 0.1 to 1 Hz, and its first two derivatives."""
    rng = np.random.default_rng(seed)
    rates = 2 * np.pi * np.linspace(0.1, 1.0, 5) * rng.uniform(0.9, 1.1, 5)
    phases = t[:, None] * rates + rng.uniform(0, 2 * np.pi, 5)
    sizes = size / np.sqrt(np.arange(1, 6))
    return (
        np.sin(phases) @ sizes,
        np.cos(phases) @ (sizes * rates),
        -np.sin(phases) @ (sizes * rates**2),
    )


def _write_columns(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)


def _copy_panda(source: Path, folder: Path) -> None:
    """Every fifth row: two thirds to fit, one to judge."""
    header, *rows = (source / "panda_exciting_traj1.csv").read_text("utf-8").splitlines(True)
    cut = 2 * len(rows) // 3
    (folder / "training.csv").write_text(header + "".join(rows[:cut:5]), encoding="utf-8")
    (folder / "validation.csv").write_text(header + "".join(rows[cut::5]), encoding="utf-8")
    (folder / "columns.toml").write_text(_PANDA_COLUMNS, encoding="utf-8")


def _copy_tx40(source: Path, folder: Path) -> None:
    """Joint positions and torques of every tenth row."""
    motor, torque = (
        np.loadtxt(source / name, delimiter=",", skiprows=1)
        for name in ("pos_read_data.csv", "curr_data.csv")
    )
    gears = np.diag([32.0, 32.0, 45.0, -48.0, 45.0, 32.0])
    gears[5, 4] = 32.0
    zero = np.array([0, -np.pi / 2, np.pi / 2, 0, 0, 0])
    position = np.linalg.solve(gears, motor.T).T + zero
    joint_torque = torque @ gears
    t = np.arange(len(motor)) / 5000
    for name, rows in (("training", slice(0, 24_750, 10)), ("validation", slice(29_250, None, 10))):
        columns = {
            "time": t[rows],
            **{f"position_{i + 1}": position[rows, i] for i in range(6)},
            **{f"torque_{i + 1}": joint_torque[rows, i] for i in range(6)},
        }
        _write_columns(folder / f"{name}.csv", columns)


def _copy_all(source: Path, folder: Path) -> None:
    for pattern in ("*.csv", "*.toml", "*.urdf"):
        for path in sorted(source.glob(pattern)):
            shutil.copyfile(path, folder / path.name)


def _copy_lwr4(source: Path, folder: Path) -> None:
    _copy_all(source, folder)
    (folder / "prior.toml").write_text(_LWR4_PRIOR, encoding="utf-8")


_REAL: Mapping[str, Callable[[Path, Path], None]] = {
    "kuka_kr300": _copy_all,
    "franka_panda": _copy_panda,
    "staubli_tx40": _copy_tx40,
    "kuka_lwr4": _copy_lwr4,
}


def write(
    folder: Path,
    *,
    code: Path = ROOT,
    only: Sequence[str] = (),
    inputs: Path | None = None,
    data: Path = DATA,
) -> int:
    """Write references, each into a folder of its name that it replaces.

    **Arguments**

    - `code`: the tree whose `jaxcslc` runs.
    - `only`: names; all references by default.
    - `inputs`: another set, whose inputs are used; those that the code simulates by default.
    - `data`: folder of real recordings.

    **Returns** 1 if a command failed.
    """
    environment = _environment(code)
    about: dict[str, Any] = {"code": str(code), "commit": _commit(code), "seconds": {}}
    folder.mkdir(parents=True, exist_ok=True)
    if inputs is None:
        shutil.rmtree(folder / _INPUTS, ignore_errors=True)
        # -P, so that the folder of this file is no place of modules.
        line = [
            sys.executable,
            "-P",
            __file__,
            "inputs",
            str(folder / _INPUTS),
            "--data",
            str(data),
        ]
        subprocess.run(line, env=environment, check=True)
    elif inputs.resolve() != folder.resolve():
        shutil.rmtree(folder / _INPUTS, ignore_errors=True)
        shutil.copytree(inputs / _INPUTS, folder / _INPUTS)
    failed = False
    for reference in REFERENCES:
        if only and reference.name not in only:
            continue
        if reference.real and not (folder / _INPUTS / reference.real).is_dir():
            print(f"{reference.name}: left out, for there is no {data / reference.real}")
            continue
        start = time.monotonic()
        problems = list(_run(reference, folder / reference.name, environment))
        about["seconds"][reference.name] = round(time.monotonic() - start, 1)
        print(f"{reference.name}: {about['seconds'][reference.name]} s", flush=True)
        for problem in problems:
            print(f"  {problem}")
        failed = failed or bool(problems)
    (folder / _ABOUT).write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")
    return int(failed)


def _environment(code: Path) -> dict[str, str]:
    """Variables under which the code of a tree is run.

    **Raises** `ValueError` if another tree's code would run.
    """
    environment = {**os.environ, "PYTHONPATH": str(code.resolve()), "COLUMNS": "100"}
    line = [sys.executable, "-P", "-c", "import jaxcslc; print(jaxcslc.__file__)"]
    result = subprocess.run(line, env=environment, capture_output=True, text=True)
    found = result.stdout.strip()
    if not found or not Path(found).is_relative_to(code.resolve()):
        raise ValueError(f"{code}: its jaxcslc does not run, but {found or result.stderr}")
    return environment


def _commit(code: Path) -> str:
    line = ["git", "-C", str(code), "describe", "--always", "--dirty"]
    return subprocess.run(line, capture_output=True, text=True).stdout.strip()


def _run(reference: Reference, folder: Path, environment: Mapping[str, str]) -> Iterator[str]:
    """Runs the commands of a reference, and keeps what they print; yields what fails."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for number, text in enumerate(reference.commands, start=1):
        name = text.partition(" ")[0]
        line = [sys.executable, "-P", "-m", "jaxcslc", *shlex.split(text)]
        result = subprocess.run(line, cwd=folder, env=environment, capture_output=True, text=True)
        printed = f"{result.stdout}\nexit status {result.returncode}\n"
        (folder / f"{number}_{name}.txt").write_text(printed, encoding="utf-8")
        # 1 of a check: something looks wrong with a recording.
        if result.returncode not in ((0, 1) if name == "check" else (0,)):
            last = (result.stderr.strip().splitlines() or ["no message"])[-1]
            yield f"{name} ended with {result.returncode}: {last}"


# Of files' formats and of their writer, not of results.
_IGNORED_KEYS = ("version",)
_IGNORED_TEXT = re.compile(
    r"\d{4}-\d\d-\d\d(?:[T ]\d\d:\d\d(?::\d\d(?:\.\d+)?)?)?"  # dates
    r"|jaxcslc,? (?:version )?\d+(?:\.\d+)+\S*"
)
_COEFFICIENTS = ("k", "free_k", "value")
_COVARIANCES = ("covariance", "independent_covariance")
_NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.]*\w)")
_BINARY = (".npz", ".npy", ".parquet", ".png", ".gz")


@dataclass
class Findings:
    """What differs between two outputs of a reference.

    **Attributes**

    - `limits`: of numbers.
    - `ignored`: patterns of places that are not compared, as in `*.html*`.
    - `errors`: greatest difference of a coefficient, in standard errors.
    - `relative`: greatest relative difference of other numbers.
    - `different`: places where something is over the limits, missing or not equal.
    - `new`: keys and files that only the new output has.
    """

    limits: Limits
    ignored: Sequence[str] = ()
    errors: float = 0.0
    relative: float = 0.0
    different: list[str] = field(default_factory=list[str])
    new: list[str] = field(default_factory=list[str])

    def folders(self, old: Path, new: Path) -> None:
        """Compares all files of two folders."""
        first, second = (
            {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
            for folder in (old, new)
        )
        for name in sorted(first | second):
            if self._ignores(name):
                continue
            if name not in second:
                self.different.append(f"{name}: missing")
            elif name not in first:
                self.new.append(name)
            else:
                self._files(old / name, new / name, name)

    def documents(self, old: Any, new: Any, place: str, scale: Any = None) -> None:
        """Compares two values of JSON.

        - `scale`: standard errors of the coefficients, where they are known.
        """
        if self._ignores(place):
            return
        if isinstance(old, dict) and isinstance(new, dict):
            self._objects(old, new, place, scale)
            return
        first, second = _array(old), _array(new)
        if first is not None and second is not None:
            counted = isinstance(old, int) and isinstance(new, int)
            self._arrays(first, second, place, scale, counted=counted)
        elif isinstance(old, list) and isinstance(new, list):
            if len(old) != len(new):
                self.different.append(f"{place}: {len(new)} values in place of {len(old)}")
            for number, (one, other) in enumerate(zip(old, new, strict=False)):
                self.documents(one, other, f"{place}[{number}]", scale)
        elif isinstance(old, str) and isinstance(new, str):
            self.texts(old, new, place)
        elif old is not new and (type(old) is not type(new) or old != new):
            self.different.append(f"{place}: {_short(new)} in place of {_short(old)}")

    def texts(self, old: str, new: str, place: str) -> None:
        """Compares two texts: words, and numbers by as many digits as are printed."""
        lines, others = old.splitlines(), new.splitlines()
        if len(lines) != len(others):
            self.different.append(f"{place}: {len(others)} lines in place of {len(lines)}")
        for number, (line, other) in enumerate(zip(lines, others, strict=False), start=1):
            if line == other:
                continue
            where = place if len(lines) == 1 else f"{place}:{number}"
            problem = self._lines(line, other, where)
            if problem:
                self.different.append(f"{where}: {problem}")
                if len(lines) != len(others):
                    return  # lines that follow are not those that belong together

    def tables(self, old: str, new: str, place: str) -> None:
        """Compares two tables of CSV, column by column."""
        rows, others = (list(csv.reader(text.splitlines())) for text in (old, new))
        if not rows or not others or len(rows) != len(others):
            if len(rows) != len(others):
                self.different.append(f"{place}: {len(others)} rows in place of {len(rows)}")
            return
        columns, new_columns = (
            dict(zip(table[0], zip(*table[1:], strict=True), strict=False))
            for table in (rows, others)
        )
        scale = _column(columns.get("standard_error", ()))
        self.new += [f"{place}.{name}" for name in new_columns if name not in columns]
        for name, column in columns.items():
            where = f"{place}.{name}"
            if self._ignores(where):
                continue
            if name not in new_columns:
                self.different.append(f"{where}: missing")
                continue
            first, second = _column(column), _column(new_columns[name])
            if first is not None and second is not None:
                self._arrays(first, second, where, scale)
                continue
            for number, (one, other) in enumerate(
                zip(column, new_columns[name], strict=True), start=2
            ):
                self.texts(one, other, f"{where}:{number}")

    def _ignores(self, place: str) -> bool:
        return any(fnmatchcase(place, pattern) for pattern in self.ignored)

    def _files(self, old: Path, new: Path, name: str) -> None:
        one, other = old.read_bytes(), new.read_bytes()
        if one == other:
            return
        if name.endswith(_BINARY):
            self.different.append(f"{name}: other bytes")
            return
        first, second = one.decode("utf-8"), other.decode("utf-8")
        if name.endswith(".json"):
            self.documents(json.loads(first), json.loads(second), name)
        elif name.endswith(".csv"):
            self.tables(first, second, name)
        else:
            self.texts(first, second, name)

    def _objects(self, old: Any, new: Any, place: str, scale: Any) -> None:
        if "standard_error" in old:
            scale = _array(old["standard_error"])
        names = [name for name in new if name not in old]
        self.new += [f"{place}.{name}" for name in names if name not in _IGNORED_KEYS]
        for name, value in old.items():
            if name in _IGNORED_KEYS:
                continue
            if name in new:
                self.documents(value, new[name], f"{place}.{name}", scale)
            elif not self._ignores(f"{place}.{name}"):
                self.different.append(f"{place}.{name}: missing")

    def _arrays(
        self, old: np.ndarray, new: np.ndarray, place: str, scale: Any, *, counted: bool = False
    ) -> None:
        if old.shape != new.shape:
            self.different.append(f"{place}: shape {new.shape} in place of {old.shape}")
            return
        if not np.array_equal(np.isfinite(old), np.isfinite(new)):
            self.different.append(f"{place}: not finite in other places")
            return
        if np.array_equal(old, new, equal_nan=True):
            return
        with np.errstate(invalid="ignore", divide="ignore"):
            change = np.abs(new - old)
            size = np.maximum(np.maximum(np.abs(old), np.abs(new)), FLOOR * _greatest(old))
            change = np.where(np.isfinite(old), change, np.where(old == new, 0.0, np.inf))
            change = np.where(np.isnan(old) & np.isnan(new), 0.0, change)
        key = place.rpartition(".")[2]
        in_errors = np.zeros(old.shape, bool)
        if key in _COEFFICIENTS and scale is not None and scale.shape == old.shape:
            in_errors = np.isfinite(scale) & (scale > 0)
            size = np.where(in_errors, scale, size)
        elif key in _COVARIANCES and old.ndim == 2 and old.shape[0] == old.shape[1]:
            deviation = np.sqrt(np.abs(np.diag(old)))
            size = np.maximum(size, deviation[:, None] * deviation)
        with np.errstate(invalid="ignore", divide="ignore"):
            part = np.where(change == 0, 0.0, change / size)
        if in_errors.any():
            self.errors = max(self.errors, float(np.max(part[in_errors])))
        if not in_errors.all():
            self.relative = max(self.relative, float(np.max(part[~in_errors])))
        over = part > np.where(in_errors, self.limits.errors, self.limits.relative)
        if counted or over.any():
            worst = int(np.argmax(part))
            unit = "standard errors" if in_errors.flat[worst] else "relatively"
            which = f"[{worst}]" if old.size > 1 else ""
            self.different.append(
                f"{place}{which}: {new.flat[worst]:.10g} in place of {old.flat[worst]:.10g},"
                f" {part.flat[worst]:.2g} {unit}"
            )

    def _lines(self, old: str, new: str, place: str) -> str | None:
        """What differs between two lines, if anything."""
        old, new = (_IGNORED_TEXT.sub("", line) for line in (old, new))
        words, other_words = (" ".join(_NUMBER.sub("#", line).split()) for line in (old, new))
        if words != other_words:
            return f"{_excerpt(words, other_words)}"
        pairs = [*zip(_NUMBER.findall(old), _NUMBER.findall(new), strict=True)]
        numbers = [(float(one), float(other)) for one, other in pairs]
        greatest = max((abs(one) for one, _ in numbers if math.isfinite(one)), default=0.0)
        for (one, other), (first, second) in zip(pairs, numbers, strict=True):
            if one == other or first == second:
                continue
            size = max(abs(first), abs(second), FLOOR * greatest)
            # A little more, for the difference of two printed numbers is rounded.
            beyond = max(abs(second - first) - (1 + 1e-6) * _last_digit(one, other), 0.0)
            self.relative = max(self.relative, beyond / size)
            if beyond > self.limits.relative * size:
                return f"{other} in place of {one}"
        return None


def _array(value: Any) -> Float[np.ndarray, "..."] | None:
    """A number, or numbers in lists of one shape, as an array; None for anything else."""
    if not _numeric(value):
        return None
    try:
        return np.asarray(value, dtype=np.float64)  # null becomes not a number
    except ValueError:
        return None


def _numeric(value: Any) -> bool:
    if isinstance(value, list):
        return bool(value) and all(v is None or _numeric(v) for v in value)
    return isinstance(value, int | float) and not isinstance(value, bool)


def _column(cells: Sequence[str]) -> Float[np.ndarray, " rows"] | None:
    """Cells of a table as numbers; None if one is text, or there are none."""
    try:
        return np.array([float(cell or "nan") for cell in cells]) if cells else None
    except ValueError:
        return None


def _greatest(values: np.ndarray) -> float:
    finite = np.abs(values[np.isfinite(values)])
    return float(finite.max()) if finite.size else 0.0


def _last_digit(one: str, other: str) -> float:
    """What one unit of the last digit is worth that either number was printed with.

    Trailing zeros may not have been printed. Of two small counts it is nothing.

    >>> [_last_digit(*pair) for pair in (("0.25", "0.26"), ("1e3", "999"), ("12", "11"))]
    [0.01, 1.0, 0.0]
    """
    if all(
        len(number.lstrip("+-")) < 3 and number.lstrip("+-").isdigit() for number in (one, other)
    ):
        return 0.0
    units: list[float] = []
    for number in (one, other):
        digits, _, exponent = number.lower().partition("e")
        units.append(10.0 ** (int(exponent or 0) - len(digits.partition(".")[2])))
    return min(units)


def _excerpt(old: str, new: str) -> str:
    start = next((i for i, (a, b) in enumerate(zip(old, new, strict=False)) if a != b), 0)
    first = max(0, start - 20)
    return f"{_short(new[first:])} in place of {_short(old[first:])}"


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:60]}…"


def compare(old: Path, new: Path, *, ignored: Sequence[str] = ()) -> int:
    """Compare two sets of references, and print a row for each and what differs.

    - `ignored`: patterns of places, as `puma_a/identified/index.html*` or `*.json.warnings*`.

    **Returns** 1 if something is over its limits, missing or not equal.
    """
    limits = {reference.name: reference.limits for reference in REFERENCES}
    names = [path.name for path in sorted(old.iterdir()) if path.is_dir()]
    names.sort(key=lambda name: [*limits, name].index(name))
    print(f"{'reference':<18}{'standard errors':>17}{'limit':>8}{'relative':>10}{'limit':>8}")
    failed = not names
    for name in names:
        if not (new / name).is_dir():
            print(f"{name:<18}missing in {new}")
            failed = True
            continue
        of_name = [pattern.removeprefix(f"{name}/") for pattern in ignored]
        findings = Findings(limits.get(name, DIRECT), of_name)
        findings.folders(old / name, new / name)
        errors, relative = findings.limits
        verdict = "differs" if findings.different else "equal"
        print(
            f"{name:<18}{findings.errors:>17.2g}{errors:>8.0e}{findings.relative:>10.2g}"
            f"{relative:>8.0e}  {verdict}"
        )
        for kind, places in (("", findings.different), ("new: ", findings.new)):
            for place in places[:_SHOWN]:
                print(f"    {kind}{place}")
            if len(places) > _SHOWN:
                print(f"    {kind}and {len(places) - _SHOWN} more")
        failed = failed or bool(findings.different)
    for path in sorted(new.iterdir()):
        if path.is_dir() and path.name not in names:
            print(f"{path.name:<18}new")
    return int(failed)


def main(arguments: Sequence[str] | None = None) -> int:
    """Writes or compares references."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    writer = commands.add_parser("write", help="run every command, and keep what it writes")
    writer.add_argument("folder", type=Path)
    names = [reference.name for reference in REFERENCES]
    writer.add_argument("--only", nargs="+", choices=names, default=(), help="these references")
    writer.add_argument("--code", type=Path, default=ROOT, help="tree whose jaxcslc runs")
    writer.add_argument("--inputs", type=Path, help="set of references whose inputs are used")
    writer.add_argument("--data", type=Path, default=DATA, help="folder of real recordings")
    makes_inputs = commands.add_parser("inputs", help="write what the commands of `write` read")
    makes_inputs.add_argument("folder", type=Path)
    makes_inputs.add_argument("--data", type=Path, default=DATA, help="folder of real recordings")
    comparer = commands.add_parser("compare", help="compare two sets")
    comparer.add_argument("old", type=Path)
    comparer.add_argument("new", type=Path)
    comparer.add_argument(
        "--ignore", action="append", default=[], metavar="PATTERN", help="places not compared"
    )
    options = parser.parse_args(arguments)
    if options.command == "inputs":
        write_inputs(options.folder, options.data)
        return 0
    if options.command == "compare":
        for folder in (options.old, options.new):
            if not folder.is_dir():
                parser.error(f"{folder}: no such folder")
        return compare(options.old, options.new, ignored=options.ignore)
    try:
        return write(
            options.folder,
            code=options.code,
            only=options.only,
            inputs=options.inputs,
            data=options.data,
        )
    except ValueError as error:
        parser.error(str(error))


if __name__ == "__main__":
    raise SystemExit(main())
