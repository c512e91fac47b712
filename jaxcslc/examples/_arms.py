"""Small arms with exact motions, and whole arms with robot files and logs for `jaxcslc example`.

The log of a whole arm differs from its robot file as a real one does. The true links are not those
of the file, joints have friction, encoders have ticks, torques have noise. The truth is written
next to them.
"""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ._servo_arm import SERVO_ARM, write_servo_example


if TYPE_CHECKING:
    from ..manipulator import Manipulator
    from ..network import CSLC
    from ..recordings import Patterns, Recording
    from ..systems import System, SystemRecording


def pendulum(*friction: str) -> Manipulator:
    """Return a link that swings about a horizontal axis.

    `friction` are its friction terms, viscous and dry ones where none is named.

    >>> import jaxcslc as jc
    >>> jc.derive(jc.examples.pendulum(), lengths="numeric").names
    ('kB1', 'kB2', 'kB3', 'kv1', 'kd1')
    """
    return _arm([(0, 0, 0, 0)], (0, -9.81, 0), friction)


def turntable(*friction: str) -> Manipulator:
    """Return a link that turns about a vertical axis, so that gravity does not load it.

    `friction` are its friction terms, viscous and dry ones where none is named.

    >>> import jaxcslc as jc
    >>> jc.derive(jc.examples.turntable("viscous"), lengths="numeric").names
    ('kB1', 'kv1')
    """
    return _arm([(0, 0, 0, 0)], (0, 0, -9.81), friction)


def planar_arm(*friction: str) -> Manipulator:
    """Return an arm of two links of 0.5 m in a vertical plane.

    `friction` are the terms of both joints, viscous and dry ones where none is named.

    >>> import jaxcslc as jc
    >>> jc.examples.planar_arm().joint_count
    2
    """
    return _arm([(0, 0, 0, 0), (0, 0.5, 0, 0)], (0, -9.81, 0), friction)


def swing(
    network: CSLC,
    k: Sequence[float] | np.ndarray,
    *,
    samples: int = 1000,
    time_step: float = 0.01,
    torque_noise: float = 0.0,
) -> Patterns:
    """Return patterns of a sinusoidal motion with the torques of coefficients `k`.

    Joint i (from 0) moves by sin((1 + 0.3 i) t + 0.5 i) rad, for `samples` samples, `time_step`
    apart [s]. All pairs count. Torques are exact, or have normal noise of standard deviation
    `torque_noise` [N m].

    >>> import jaxcslc as jc
    >>> network = jc.derive(jc.examples.pendulum(), lengths="numeric")
    >>> patterns = jc.examples.swing(network, [0.5, 0.3, -0.1, 0.2, 0.05])
    >>> jc.LeastSquares().fit(network, patterns).k.round(6).tolist()
    [0.5, 0.3, -0.1, 0.2, 0.05]
    """
    from ..recordings import Patterns

    t = np.arange(samples)[:, None] * time_step
    joint = np.arange(network.joint_count)
    rate = 1 + 0.3 * joint
    phase = rate * t + 0.5 * joint
    q, qd, qdd = np.sin(phase), rate * np.cos(phase), -(rate**2) * np.sin(phase)
    torque = np.asarray(network.torque(np.asarray(k, dtype=float), q, qd, qdd))
    torque = torque + torque_noise * np.random.default_rng(0).normal(size=q.shape)
    pairs = np.ones(q.shape, dtype=bool)
    return Patterns(t[:, 0], q, qd, qdd, torque, pairs, pairs)


def swing_recording(
    network: CSLC, k: Sequence[float] | np.ndarray, *, samples: int = 1000, time_step: float = 0.01
) -> Recording:
    """Return the recording of the motion of `swing`, without noise or quantisation.

    >>> import jaxcslc as jc
    >>> network = jc.derive(jc.examples.pendulum(), lengths="numeric")
    >>> recording = jc.examples.swing_recording(network, [0.5, 0.3, -0.1, 0.2, 0.05])
    >>> recording.position.shape
    (1000, 1)
    """
    from ..recordings import Recording

    patterns = swing(network, k, samples=samples, time_step=time_step)
    return Recording(patterns.time, patterns.q, patterns.torque)


def tank(samples: int = 1000) -> tuple[System, SystemRecording]:
    """Return a tank that drains by the root of its level, and an exact recording of it.

    Its area is 3 m², its outlet 0.5. The level moves by sin(t), `samples` samples 0.05 s apart.

    >>> import jaxcslc as jc
    >>> tank, recording = jc.examples.tank()
    >>> tank.network.names, sorted(recording.columns)
    (('area', 'outlet'), ['inflow', 'level'])
    """
    import sympy
    from sympy.physics.mechanics import dynamicsymbols

    from ..systems import Constant, System, SystemRecording, Variable

    level, inflow = dynamicsymbols("level inflow")
    area, outlet = sympy.symbols("area outlet")
    balance = sympy.Eq(inflow, area * level.diff() + outlet * sympy.sqrt(level))
    variables = (Variable(level, "m"), Variable(inflow, "m³/s"))
    constants = (Constant(area, "m²", sign="positive"), Constant(outlet))
    time = np.arange(samples) * 0.05
    height = 2.0 + np.sin(time)
    columns = {"level": height, "inflow": 3.0 * np.cos(time) + 0.5 * np.sqrt(height)}
    return System("tank", {"volume": balance}, variables, constants), SystemRecording(time, columns)


def _arm(
    rows: Sequence[Sequence[float | int]],
    gravity: Sequence[float | int],
    friction: Sequence[str],
) -> Manipulator:
    from ..manipulator import Manipulator

    arm = Manipulator.from_modified_dh(rows, gravity=gravity)
    return arm.with_friction(*friction) if friction else arm


if TYPE_CHECKING:
    from ..manipulator import LinkParameters, Manipulator
    from ..network import CSLC

# Largest errors of the masses and inertias in the robot file, relative, and of its centres of
# gravity [m]. Identified Pandas and their files differ by such amounts (docs/real_robots.md).
_MASS_ERROR, _CENTRE_ERROR = 0.15, 0.01

# Harmonics of each joint's motion, in periods per recording; the highest is 0.7 Hz.
_HARMONICS = np.array([2, 3, 5, 9, 14])
_DURATION = 20.0  # of a recording [s]
_RAMP = 1.5  # in which the motion starts, and ends [s]
# Parts of the joint's range and of its speed limit that the motion uses at most.
_RANGE_PART, _SPEED_PART = 0.7, 0.6
_LARGEST_AMPLITUDE, _LARGEST_SPEED = 1.3, 3.0  # of joints without such limits [rad, rad/s]


@dataclass(frozen=True)
class Arm:
    """An arm of `jaxcslc example`.

    **Attributes**

    - `file`: name of the robot file.
    - `pose`: about which it moves [rad].
    - `rate`: samples per second [Hz].
    - `tick`: of the encoders, at the joints [rad].
    - `torque_noise`: standard deviation per joint [N m].
    - `viscous`, `coulomb`: friction per joint [N m s/rad, N m].
    - `columns`: gives the log's columns, under the names and in the units of its format.
    """

    file: str
    pose: tuple[float, ...]
    rate: float
    tick: float
    torque_noise: tuple[float, ...]
    viscous: tuple[float, ...]
    coulomb: tuple[float, ...]
    columns: Callable[[Log], dict[str, np.ndarray]]


@dataclass(frozen=True)
class Log:
    """A simulated log in SI units, time `(samples,)`, the rest `(samples, joints)`."""

    time: Float[np.ndarray, " samples"]
    position: Float[np.ndarray, "samples joints"]
    velocity: Float[np.ndarray, "samples joints"]
    torque: Float[np.ndarray, "samples joints"]


@dataclass(frozen=True)
class Example:
    """The files that `write_example` wrote.

    **Attributes**

    - `robot`: the robot file.
    - `train`, `validation`: two logs of different motion.
    - `truth`: JSON with the true coefficients by name, and the true links and friction; of servos,
      the true parameters of the drives.
    """

    robot: Path
    train: Path
    validation: Path
    truth: Path


def _universal_robots(log: Log) -> dict[str, np.ndarray]:
    """The columns of Universal Robots' RTDE log."""
    stems = {
        "actual_q": log.position,
        "actual_qd": log.velocity,
        "actual_current_as_torque": log.torque,
    }
    return {"timestamp": 1000.0 + log.time, **_numbered(stems, "{stem}_{index}")}


def _franka(log: Log) -> dict[str, np.ndarray]:
    """The columns of libfranka's log; its clock counts milliseconds."""
    stems = {"state.q": log.position, "state.dq": log.velocity, "state.tau_J": log.torque}
    return {"time": 5000 + 1000 * log.time, **_numbered(stems, "{stem}[{index}]")}


def _own(log: Log) -> dict[str, np.ndarray]:
    """The columns of jaxcslc's own tables."""
    stems = {"position": log.position, "torque": log.torque}
    return {"time": log.time, **_numbered(stems, "{stem}_{number}")}


def _numbered(stems: Mapping[str, np.ndarray], form: str) -> dict[str, np.ndarray]:
    return {
        form.format(stem=stem, index=index, number=index + 1): values[:, index]
        for stem, values in stems.items()
        for index in range(values.shape[1])
    }


# Friction, ticks and noise are of the order seen on real arms of these kinds, not of one arm.
ARMS: Mapping[str, Arm] = {
    "panda": Arm(
        file="panda.urdf",
        pose=(0.0, -0.3, 0.0, -1.8, 0.0, 1.8, 0.0),
        rate=500.0,
        tick=2e-5,
        torque_noise=(0.08, 0.08, 0.06, 0.06, 0.03, 0.03, 0.03),
        viscous=(0.4, 0.6, 0.4, 0.6, 0.3, 0.2, 0.2),
        coulomb=(0.5, 0.7, 0.4, 0.6, 0.4, 0.3, 0.3),
        columns=_franka,
    ),
    "puma560": Arm(
        file="puma560.toml",
        pose=(0.0, -0.8, 0.8, 0.0, 0.5, 0.0),
        rate=250.0,
        tick=1e-4,
        torque_noise=(0.3, 0.3, 0.15, 0.05, 0.05, 0.05),
        viscous=(4.0, 5.0, 2.5, 0.1, 0.1, 0.05),
        coulomb=(6.0, 7.0, 4.0, 0.8, 0.8, 0.7),
        columns=_own,
    ),
    "ur5": Arm(
        file="ur5.urdf",
        pose=(0.0, -1.2, 1.2, -1.2, -1.0, 0.0),
        rate=125.0,
        tick=5e-5,
        torque_noise=(0.3, 0.3, 0.25, 0.08, 0.08, 0.08),
        viscous=(8.0, 10.0, 6.0, 1.2, 1.2, 1.0),
        coulomb=(5.0, 6.0, 4.0, 1.0, 1.0, 0.8),
        columns=_universal_robots,
    ),
}
"""Arms of `jaxcslc example` by name."""


def write_example(arm: str, folder: str | Path, *, overwrite: bool = False) -> Example:
    """Write an arm's robot file, two simulated logs and the truth into a new folder.

    Into one that it wrote before, too: files that were not changed since are replaced. The logs
    are in the format of the arm's own software: RTDE (`ur5`), libfranka (`panda`), or a table of
    jaxcslc (`puma560`). Those of `so101`, an arm of position servos, have commands and positions
    and no torques. All are the same in every run.

    **Arguments**

    - `arm`: a key of `ARMS`, or `so101`.
    - `folder`: new or empty.
    - `overwrite`: whether to replace files that it did not write, too.

    **Raises**

    - `ValueError`: if there is no such arm.
    - `FileExistsError`: if the folder has other files.

    >>> import tempfile, jaxcslc as jc
    >>> example = jc.examples.write_example("ur5", tempfile.mkdtemp())
    >>> jc.load_recording(example.train, joints=6).position.shape
    (2500, 6)
    """
    from .._scratch import all_or_nothing, check_replaceable

    if arm not in (*ARMS, SERVO_ARM):
        listed = ", ".join((*ARMS, SERVO_ARM))
        raise ValueError(f"there is no example {arm!r}; expected one of {listed}")
    folder = Path(folder)
    robot = f"{SERVO_ARM}.urdf" if arm == SERVO_ARM else ARMS[arm].file
    names = (robot, "train.csv", "validation.csv", "truth.json")
    check_replaceable(folder, names, overwrite=overwrite)
    with all_or_nothing(folder) as scratch:
        result = Example(*(scratch / name for name in names))
        if arm == SERVO_ARM:
            write_servo_example(result)
        else:
            _write_files(arm, result)
    return Example(*(folder / name for name in names))


def _write_files(arm: str, result: Example) -> None:
    from ..manipulator import load_robot, puma560
    from ..network import derive

    chosen = ARMS[arm]
    source = files("jaxcslc") / ("manipulator/robots" if arm == "puma560" else "examples/robots")
    with as_file(source / chosen.file) as path:
        shutil.copyfile(path, result.robot)
    robot = puma560() if arm == "puma560" else load_robot(result.robot)
    rng = np.random.default_rng(7)
    links = [_true_link(link, rng) for link in robot.links or ()]
    network = derive(robot.with_friction("viscous", "dry"))  # coefficients as `identify` has them
    rigid = dict(zip(network.names, map(float, network.coefficients_from(links)), strict=True))
    friction = {
        name: value
        for symbol, values in (("kv", chosen.viscous), ("kd", chosen.coulomb))
        for joint, value in enumerate(values, 1)
        if (name := f"{symbol}{joint}") in rigid
    }
    truth = rigid | friction
    k = np.array([truth[name] for name in network.names])
    for path in (result.train, result.validation):
        time, q, qd, qdd = _motion(robot, chosen, rng)
        torque = np.asarray(network.torque(k, q, qd, qdd))
        torque = torque + np.array(chosen.torque_noise) * rng.normal(size=q.shape)
        ticks = np.round(q / chosen.tick) * chosen.tick
        log = Log(time, ticks, np.gradient(ticks, time, axis=0), torque)
        _write(chosen.columns(log), path)
    document = {
        "what": f"truth of the simulated {arm}: train.csv and validation.csv",
        # Torques have no offsets, which `identify` adds.
        "coefficients": truth | {f"ko{joint + 1}": 0.0 for joint in range(robot.joint_count)},
        "links": [_entries(link) for link in links],
    }
    result.truth.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")


def read_truth(example: Example, network: CSLC) -> Float[np.ndarray, " coefficients"]:
    """Return the true coefficients of an example, in the network's order.

    **Raises** `KeyError` if the network has coefficients that the example's truth does not name.

    >>> import tempfile, jaxcslc as jc
    >>> example = jc.examples.write_example("ur5", tempfile.mkdtemp())
    >>> network = jc.derive(jc.load_robot(example.robot))
    >>> jc.examples.read_truth(example, network).shape == (network.size,)
    True
    """
    truth = json.loads(example.truth.read_text(encoding="utf-8"))["coefficients"]
    return np.array([truth[name] for name in network.names])


def _true_link(link: LinkParameters, rng: np.random.Generator) -> LinkParameters:
    """Return a link of other mass and centre of gravity than the file's, which a body can have."""
    factor = 1 + _MASS_ERROR * rng.uniform(-1, 1)
    shift = _CENTRE_ERROR * rng.uniform(-1, 1, size=3) if float(link.mass) > 0 else np.zeros(3)
    return replace(
        link,
        mass=factor * link.mass,
        centre_of_gravity=link.centre_of_gravity + shift,
        inertia=factor * link.inertia,
    )


def _motion(robot: Manipulator, arm: Arm, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Return time, q, qd and qdd of a sum of sines within limits, from rest to rest."""
    time = np.arange(round(_DURATION * arm.rate)) / arm.rate
    phase, rate, curvature = _warp(time)
    weight = (
        rng.uniform(0.3, 1.0, (len(_HARMONICS), robot.joint_count)) / np.sqrt(_HARMONICS)[:, None]
    )
    start = rng.uniform(0, 2 * np.pi, weight.shape)
    omega = 2 * np.pi * _HARMONICS[:, None] / _DURATION
    angle = phase[:, None, None] * omega + start
    shape = np.sum(weight * np.sin(angle), axis=1)
    slope = np.sum(weight * omega * np.cos(angle), axis=1)
    bend = -np.sum(weight * omega**2 * np.sin(angle), axis=1)
    q, qd = shape, slope * rate[:, None]
    qdd = bend * rate[:, None] ** 2 + slope * curvature[:, None]
    pose = np.array(arm.pose)
    room = np.array(
        [
            min(limit.high - centre, centre - limit.low, _LARGEST_AMPLITUDE)
            for limit, centre in zip(robot.joint_limits, pose, strict=True)
        ]
    )
    speed = np.array([min(limit.speed, _LARGEST_SPEED) for limit in robot.joint_limits])
    size = np.minimum(
        _RANGE_PART * room / np.abs(q).max(axis=0), _SPEED_PART * speed / np.abs(qd).max(axis=0)
    )
    return time, pose + size * q, size * qd, size * qdd


def _warp(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the phase that runs with time but starts and ends at rest, and its derivatives."""
    end = time[-1]

    def ramp(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A rise from 0 to 1 without a jump of its slope, and the slope."""
        s = np.clip(x / _RAMP, 0, 1)
        return s**2 * (3 - 2 * s), 6 * s * (1 - s) / _RAMP

    (up, up_slope), (down, down_slope) = ramp(time), ramp(end - time)
    rate = up * down
    curvature = up_slope * down - up * down_slope
    step = np.diff(time)
    phase = np.concatenate([[0.0], np.cumsum(step * (rate[1:] + rate[:-1]) / 2)])
    return phase, rate, curvature


def _write(columns: Mapping[str, np.ndarray], path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        texts = ([f"{value:.9g}" for value in values] for values in columns.values())
        writer.writerows(zip(*texts, strict=True))


def _entries(link: LinkParameters) -> dict[str, object]:
    return {
        "mass": float(link.mass),
        "centre_of_gravity": np.asarray(link.centre_of_gravity).tolist(),
        "inertia": np.asarray(link.inertia).tolist(),
    }
