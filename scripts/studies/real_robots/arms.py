"""Recordings of real arms, each divided once and for all into what is fitted and what is judged."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

import jaxcslc as jc
from jaxcslc.manipulator import tx40
from jaxcslc.recordings import Recording, resample


DATA = Path(__file__).resolve().parents[4] / "shared" / "data"
# Of 1 kHz and 5 kHz recordings, one of so many samples is used, by every method.
PANDA_STEP, TX40_STEP = 5, 10
PANDA_PERIOD, TX40_INTERVAL = 0.001, 1 / 5000  # [s] of the controllers
# Rows of the TX40 that are fitted, and judged: those of figaroh-examples.
TX40_FITTED, TX40_JUDGED = slice(0, 24_750), slice(29_250, 45_000)
# Its gear ratios. The motor of joint 6 turns with joint 5: its position is of both, and its torque
# works on both.
_RATIOS, _WRIST = (32.0, 32.0, 45.0, -48.0, 45.0, 32.0), 32.0
_ZERO = (0.0, -np.pi / 2, np.pi / 2, 0.0, 0.0, 0.0)  # joint positions at the encoders' zero [rad]


class Arm(NamedTuple):
    """A robot, the recording to fit, and recordings to judge by name.

    - `source`: where the recordings are published.
    - `split`: in words.
    - `typed`: what the command is told of the robot: a file, or a name.
    - `ends`: what is not judged of a recording, at either end [s].
    """

    robot: jc.Manipulator
    training: Recording
    tests: Mapping[str, Recording]
    source: str
    split: str
    typed: str = ""
    ends: float = 0.0


def kr300(folder: Path) -> Arm:
    """KUKA Quantec Ultra KR300: motor positions and torques of three motions of 10 s."""
    first, second, third = (jc.load_recording(folder / f"{name}.csv") for name in "ABC")
    return Arm(
        jc.load_robot(folder / "kr300.toml"),
        first,
        {"B": second, "C": third},
        "JonasWeigand/Robot_Identification, MIT licence",
        "motion A is fitted, B and C are judged; 2,501 samples at 250 Hz each",
        str(folder / "kr300.toml"),
    )


def lwr4(folder: Path) -> Arm:
    """KUKA LWR4+: joint positions and joint torques; its URDF has inertial parameters."""
    first, second, third = (jc.load_recording(folder / f"hw{number}.csv") for number in (1, 2, 3))
    return Arm(
        jc.load_robot(folder / "kuka_lwr4.urdf"),
        first,
        {"hw3": third, "hw2": second},
        "kjyv/FloBaRoID, LGPL-3.0",
        "hw1 is fitted, hw3 (faster) and hw2 (the same motion again) are judged except 0.2 s at"
        " either end; 5,027 samples at 200 Hz each",
        str(folder / "kuka_lwr4.urdf"),
        ends=0.2,
    )


def panda(folder: Path) -> Arm:
    """Franka Emika Panda: joint positions and torques of joint sensors."""
    table = np.genfromtxt(folder / "panda_exciting_traj1.csv", delimiter=",", names=True)
    columns = [
        np.stack([table[f"{name}{joint}"] for joint in range(1, 8)], axis=1)
        for name in ("q", "tau_J_")
    ]
    even = resample(Recording(table["t_s"], *columns, torque_measured=True), PANDA_PERIOD)
    every = slice(None, None, PANDA_STEP)
    end = float(even.time[-1] - even.time[0])
    cut = 2 * end / 3
    return Arm(
        jc.panda().with_friction("viscous", "dry", "offset"),
        even.between(0.0, cut).rows(every),
        {"last third": even.between(cut, end).rows(every)},
        "marcocognetti/FrankaEmikaPandaDynModel, GPL-3.0",
        "the first two thirds of 21 s are fitted, the last third is judged; resampled to 200 Hz",
        "panda",
    )


def tx40_recording(folder: Path) -> Recording:
    """Joint positions [rad] and joint torques [N m] of the TX40's log of motors, at 5 kHz."""
    motor, torque = (
        np.loadtxt(folder / name, delimiter=",", skiprows=1)
        for name in ("pos_read_data.csv", "curr_data.csv")
    )
    gears = np.diag(_RATIOS)
    gears[5, 4] = _WRIST
    position = np.linalg.solve(gears, motor.T).T + np.array(_ZERO)
    time = np.arange(len(motor)) * TX40_INTERVAL
    return Recording(time, position, torque @ gears, torque_measured=True)


def staubli(folder: Path) -> Arm:
    """Stäubli TX40: motor positions in encoder counts and motor torques, a coupled wrist."""
    recording = tx40_recording(folder)
    every = slice(None, None, TX40_STEP)
    return Arm(
        tx40(),
        recording.rows(TX40_FITTED).rows(every),
        {"last third": recording.rows(TX40_JUDGED).rows(every)},
        "thanhndv212/figaroh-examples, Apache-2.0",
        "rows 0 to 24,750 are fitted, 29,250 to 45,000 judged; every tenth, 500 Hz",
        "tx40",
    )


READERS: Mapping[str, tuple[str, Callable[[Path], Arm]]] = {
    "KUKA KR300": ("kuka_kr300", kr300),
    "KUKA LWR4+": ("kuka_lwr4", lwr4),
    "Franka Panda": ("franka_panda", panda),
    "Stäubli TX40": ("staubli_tx40", staubli),
}


def read(name: str, data: Path = DATA) -> Arm:
    """An arm of `READERS`.

    **Raises** `ValueError` if its folder is missing or does not hold its recordings.
    """
    folder, reader = READERS[name]
    if not (data / folder).is_dir():
        raise ValueError(f"{data / folder}: no such folder; expected the recordings of a {name}")
    return reader(data / folder)
