"""Writes what the commands of references read: recordings, robots and settings.

    python -P scripts/tools/references/inputs.py FOLDER [--data FOLDER]

The code that `PYTHONPATH` names simulates the PUMA 560s; all else is computed by NumPy alone.
"""

import argparse
import csv
import dataclasses
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

import jaxcslc as jc
import sim


ROOT = Path(__file__).resolve().parents[3]
DATA = ROOT.parent / "shared" / "data"

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


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--data", type=Path, default=DATA, help="folder of real recordings")
    options = parser.parse_args()
    write_inputs(options.folder, options.data)
