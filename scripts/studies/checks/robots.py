"""Six arms of the spoiler study, from robot files of others, and their recordings by Pinocchio.

An arm differs from its file as arms do: masses and inertias by 20 %, centres of gravity by some
centimetres. It has motors, friction of which the model lacks the Stribeck effect, encoders with
steps, and noisy torques.
"""

import dataclasses
import xml.etree.ElementTree as ET
from functools import cache
from importlib.metadata import files
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pinocchio
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc.manipulator import Manipulator


_EXAMPLES = Path(jc.__file__).parent / "examples" / "robots"


@dataclasses.dataclass(frozen=True)
class ArmFile:
    """Robot file of an arm.

    - `path`: of the URDF.
    - `other`: arm of as many joints whose file is the wrong one.
    - `fix`: joints that are no part of the arm.
    """

    path: Path
    other: str
    fix: tuple[str, ...] = ()


def _data(name: str) -> Path:
    """Return the path of a robot file of the package example-robot-data."""
    (path,) = [path for path in files("example-robot-data") or [] if path.name == name]
    return Path(str(path.locate()))


FILES = {
    "UR5": ArmFile(_data("ur5_robot.urdf"), "UR10"),
    "UR3": ArmFile(_data("ur3_robot.urdf"), "UR5"),
    "Panda": ArmFile(_EXAMPLES / "panda.urdf", "xArm7"),
    "xArm7": ArmFile(_data("xarm7.urdf"), "Panda"),
    "Gen2": ArmFile(_data("kinova.urdf"), "UR3"),
    "Z1": ArmFile(_data("z1.urdf"), "Gen2", ("jointGripper",)),
    "UR10": ArmFile(_data("ur10_robot.urdf"), "UR5"),
}
ARMS = ("UR5", "Panda", "Gen2", "xArm7", "Z1", "UR3")

# How far an arm is from its file: masses and inertias as a part, centres in metres.
_MASS_ERROR, _CENTRE_ERROR = 0.2, 0.01
# Coulomb and viscous friction (at 1 rad/s) as parts of a joint's torque, and inertia of its motor
# [s²]; the least torque of a joint, as part of the arm's largest.
_COULOMB, _VISCOUS, _MOTOR, _LEAST_TORQUE = 0.15, 0.1, 0.015, 0.05
# An excess of Coulomb friction at low speed that no model of the study has, and its speed [rad/s].
_STRIBECK, _STRIBECK_SPEED = 0.1, 0.05
_RAMP = 0.005  # rad/s within which Coulomb friction changes its sign
_HARMONICS, _BASE_FREQUENCY = 5, 0.1  # of the motion [Hz]


@dataclasses.dataclass(frozen=True)
class Conditions:
    """Conditions of a recording.

    - `duration`, `rate`: of the recording [s, Hz].
    - `noise`: of torques, as part of each joint's RMS.
    - `ticks`: of the encoders per turn.
    - `friction`: factor of friction.
    - `speed`: greatest speed [rad/s].
    """

    duration: float = 20.0
    rate: float = 250.0
    noise: float = 0.01
    ticks: float = 2.0**18
    friction: float = 1.0
    speed: float = 1.2


@dataclasses.dataclass(frozen=True)
class Fault:
    """Fault of the arm itself.

    - `tilt`: of its base, about the horizontal axes [rad].
    - `drift`: growth of friction from the start to the end, as a part of it.
    - `tool`: mass that the arm takes up halfway [kg].
    - `push`: downward force on the last link for 4 s [N].
    - `stop`: joint, from 0, and the part of its range from which a stop keeps it.
    - `wrapped`: joint, from 0, that moves about π.
    """

    tilt: tuple[float, float] = (0.0, 0.0)
    drift: float = 0.0
    tool: float = 0.0
    push: float = 0.0
    stop: tuple[int, float] | None = None
    wrapped: int | None = None


@dataclasses.dataclass(frozen=True)
class Run:
    """A recording and what it consists of, all (samples, n).

    - `recording`: as the arm's sensors have it.
    - `q`, `qd`, `qdd`: motion.
    - `gravity`, `motion`, `friction`, `noise`: parts of the recorded torque [N m].
    """

    recording: jc.Recording
    q: Float[np.ndarray, "samples joints"]
    qd: Float[np.ndarray, "samples joints"]
    qdd: Float[np.ndarray, "samples joints"]
    gravity: Float[np.ndarray, "samples joints"]
    motion: Float[np.ndarray, "samples joints"]
    friction: Float[np.ndarray, "samples joints"]
    noise: Float[np.ndarray, "samples joints"]


@dataclasses.dataclass(frozen=True, eq=False)
class Arm:
    """An arm: its file, and what it really is.

    - `robot`, `network`: of the file.
    - `model`: Pinocchio's, with the true bodies.
    - `links`: the true bodies, in the frames of `network`.
    - `size`: (n,) torque that joints need in typical motion [N m].
    """

    name: str
    robot: Manipulator
    network: jc.CSLC
    model: "pinocchio.Model"
    links: tuple[jc.LinkParameters, ...]
    size: Float[np.ndarray, " joints"]

    @property
    def friction(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Viscous and Coulomb friction, and the motors' inertias, (n,) each."""
        return _VISCOUS * self.size, _COULOMB * self.size, _MOTOR * self.size

    def coefficients(self, friction: float = 1.0) -> np.ndarray:
        """Return the true coefficients of the network."""
        viscous, coulomb, motor = self.friction
        links = [
            dataclasses.replace(link, motor_inertia=inertia)
            for link, inertia in zip(self.links, motor.tolist(), strict=True)
        ]
        return np.asarray(
            self.network.coefficients_from(
                links, viscous=tuple(friction * viscous), dry=tuple(friction * coulomb)
            )
        )


@cache
def arm(name: str, specimen: int = 0) -> Arm:
    """Return an arm of the study: one of the specimens that have the same file."""
    file = FILES[name]
    robot = jc.load_robot(file.path, fix=file.fix)
    network = jc.derive(robot, lengths="numeric")
    tree = ET.parse(file.path)
    rng = np.random.default_rng([specimen, *map(ord, name)])
    for inertial in tree.getroot().iter("inertial"):
        factor = float(np.exp(_MASS_ERROR * rng.standard_normal()))
        mass, inertia, origin = (inertial.find(tag) for tag in ("mass", "inertia", "origin"))
        assert mass is not None and inertia is not None
        for element in (mass, inertia):
            for key, value in element.attrib.items():
                element.set(key, repr(factor * float(value)))
        # Small links have small errors.
        if origin is not None:
            centre = np.array([float(x) for x in origin.get("xyz", "0 0 0").split()])
            shift = min(_CENTRE_ERROR, 0.2 * float(np.linalg.norm(centre)))
            origin.set(
                "xyz", " ".join(map(repr, (centre + shift * rng.standard_normal(3)).tolist()))
            )
    text = ET.tostring(tree.getroot(), encoding="unicode")
    with TemporaryDirectory() as folder:
        path = Path(folder) / "true.urdf"
        path.write_text(text, encoding="utf-8")
        truth = jc.load_robot(path, fix=file.fix)
    model = pinocchio.buildModelFromXML(text)
    if file.fix:
        locked = [model.getJointId(joint) for joint in file.fix]
        model = pinocchio.buildReducedModel(model, locked, pinocchio.neutral(model))
    assert truth.links is not None
    found = Arm(name, robot, network, model, tuple(truth.links), np.ones(model.nv))
    _, q, qd, qdd = _motion(found, Conditions(), np.random.default_rng(0), None)
    size = np.sqrt(np.mean(_rigid(found, q, qd, qdd) ** 2, axis=0))
    size = np.maximum(size, _LEAST_TORQUE * np.max(size))
    return dataclasses.replace(found, size=size)


def record(name: str, conditions: Conditions, seed: int, fault: Fault | None = None) -> Run:
    """Return a recording of the specimen `seed` of an arm."""
    of, fault = arm(name, seed), fault or Fault()
    rng = np.random.default_rng(seed)
    time, q, qd, qdd = _motion(of, conditions, rng, fault.wrapped)
    pressing = np.zeros_like(q)
    if fault.stop is not None:
        q, qd, qdd, pressing = _stopped(of, *fault.stop, q, qd, qdd)
    rigid = _rigid(of, q, qd, qdd, fault.tilt)
    gravity = _rigid(of, q, 0 * q, 0 * q, fault.tilt)
    if fault.tool:
        later = time > 0.5 * time[-1]
        rigid[later] = _rigid(of, q[later], qd[later], qdd[later], fault.tilt, fault.tool)
        still = 0 * q[later]
        gravity[later] = _rigid(of, q[later], still, still, fault.tilt, fault.tool)
    viscous, coulomb, motor = of.friction
    excess = 1.0 + _STRIBECK * np.exp(-np.abs(qd) / _STRIBECK_SPEED)
    growth = 1.0 + fault.drift * (time / time[-1])[:, None]
    friction = viscous * qd + coulomb * excess * np.tanh(qd / _RAMP)
    friction *= conditions.friction * growth
    contact = _contact(of, q, time, fault.push) + pressing
    moving = rigid - gravity + motor * qdd + contact
    total = gravity + moving + friction
    noise = conditions.noise * np.sqrt(np.mean(total**2, axis=0)) * rng.standard_normal(q.shape)
    tick = 2 * np.pi / conditions.ticks
    position = tick * np.floor(q / tick + rng.uniform(size=q.shape[1]))
    recording = jc.Recording(time, position, total + noise)
    return Run(recording, q, qd, qdd, gravity, moving, friction, noise)


def _rigid(
    of: Arm,
    q: np.ndarray,
    qd: np.ndarray,
    qdd: np.ndarray,
    tilt: tuple[float, float] = (0.0, 0.0),
    tool: float = 0.0,
) -> np.ndarray:
    """Return the torque of the true bodies by Pinocchio's recursive Newton-Euler algorithm."""
    model = of.model.copy()
    turn = pinocchio.utils.rpyToMatrix(tilt[0], tilt[1], 0.0)
    model.gravity.linear = turn @ np.asarray(of.model.gravity.linear)
    if tool:
        centre = np.array([0.02, 0.0, 0.08])
        body = pinocchio.Inertia(tool, centre, 2e-3 * tool * np.eye(3))
        model.appendBodyToJoint(model.njoints - 1, body, pinocchio.SE3.Identity())
    data = model.createData()
    states = zip(_configuration(of, q), qd, qdd, strict=True)
    return np.stack([pinocchio.rnea(model, data, *state) for state in states])


def _configuration(of: Arm, q: np.ndarray) -> np.ndarray:
    """Return Pinocchio's configurations, in which an endless joint is a point on a circle."""
    columns: list[np.ndarray] = []
    for joint, values in zip(list(of.model.joints)[1:], q.T, strict=True):
        columns += [values] if joint.nq == 1 else [np.cos(values), np.sin(values)]
    return np.stack(columns, axis=1)


def _contact(of: Arm, q: np.ndarray, time: np.ndarray, push: float) -> np.ndarray:
    """Return the torques by which joints bear a force that presses on the last link for 4 s."""
    torque = np.zeros_like(q)
    if not push:
        return torque
    start = 0.4 * time[-1]
    within = np.flatnonzero((time > start) & (time < start + 4.0))
    rise = np.minimum(1.0, np.minimum(time - start, start + 4.0 - time) / 0.2)
    data = of.model.createData()
    for i, state in zip(within.tolist(), _configuration(of, q[within]), strict=True):
        frame = pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
        pinocchio.computeJointJacobians(of.model, data, state)
        jacobian = pinocchio.getJointJacobian(of.model, data, of.model.njoints - 1, frame)
        torque[i] = -rise[i] * (jacobian[:3].T @ np.array([0.4 * push, 0.0, -push]))
    return torque


def _stopped(
    of: Arm, joint: int, part: float, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return a motion that a stop of one joint ends, and the torque that presses against it."""
    end = np.quantile(q[:, joint], part)
    beyond = q[:, joint] > end
    q, qd, qdd = q.copy(), qd.copy(), qdd.copy()
    pressing = np.zeros_like(q)
    # A stiff controller presses with the torque of its error, up to what the drive has.
    pressing[:, joint] = of.size[joint] * np.clip((q[:, joint] - end) / 0.1, 0.0, 1.5)
    q[beyond, joint] = end
    qd[beyond, joint] = qdd[beyond, joint] = 0.0
    return q, qd, qdd, pressing


def _motion(
    of: Arm, conditions: Conditions, rng: np.random.Generator, wrapped: int | None
) -> tuple[np.ndarray, ...]:
    """Return times, positions and derivatives: harmonics of each joint, from rest."""
    time = np.arange(int(conditions.duration * conditions.rate)) / conditions.rate
    order = np.arange(1, _HARMONICS + 1)
    omega = 2 * np.pi * _BASE_FREQUENCY * order
    s = np.clip(time / 2.0, 0.0, 1.0)
    rise = s**3 * (10 - 15 * s + 6 * s**2)
    rising = 15 * s**2 * (1 - s) ** 2
    bend = 15 * s * (1 - s) * (1 - 2 * s)
    columns: list[np.ndarray] = []
    for index, limits in enumerate(of.robot.joint_limits):
        amplitude, phase = rng.standard_normal(_HARMONICS) / order, rng.uniform(0, 2 * np.pi, 5)
        angle = omega * time[:, None] + phase
        wave = (
            np.sin(angle) @ amplitude,
            np.cos(angle) @ (amplitude * omega),
            -np.sin(angle) @ (amplitude * omega**2),
        )
        lower, upper = max(limits.low, -np.pi), min(limits.high, np.pi)
        middle = np.pi if index == wrapped else 0.5 * (lower + upper)
        half = min(0.45 * (upper - lower), 1.6)
        x, v, a = (
            min(half / np.max(np.abs(wave[0])), conditions.speed / np.max(np.abs(wave[1]))) * part
            for part in wave
        )
        columns.append(
            np.stack(
                [middle + rise * x, rising * x + rise * v, bend * x + 2 * rising * v + rise * a]
            )
        )
    q, qd, qdd = np.stack(columns, axis=-1)
    return time, q, qd, qdd
