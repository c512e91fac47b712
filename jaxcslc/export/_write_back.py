"""Copy of a robot's file with physical parameters, read again and compared."""

import contextlib
import dataclasses
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from ..bodies import PhysicalParameters
from ..manipulator import Manipulator, RobotError, Source, load_robot
from ..network import CSLC, derive
from ._parameter_files import (
    STORED,
    motor_file,
    read_motor_inertias,
    with_parameters,
    write_motor_inertias,
)


States = tuple[
    Float[Array | np.ndarray, "states joints"],
    Float[Array | np.ndarray, "states joints"],
    Float[Array | np.ndarray, "states joints"],
]


@dataclass(frozen=True, eq=False)
class WrittenRobot:
    """A robot's file with identified parameters, and how well it reproduces their torque.

    - `path`: of the file.
    - `robot`: as it was read again from the file.
    - `left_out`: names of coefficients that the file cannot store.
    - `rms`, `largest`: (n,) difference between the torque that the file predicts and that of the
      parameters, those left out aside, over the states [N m or N]: rounding.
    - `motors`: the file of motor inertias beside a URDF; None if there is none.

    >>> import jaxcslc as jc
    >>> robot = jc.puma560()
    >>> zeros = np.zeros(robot.joint_count)
    >>> jc.WrittenRobot(Path("arm.toml"), robot, ("ko1",), zeros, zeros).left_out
    ('ko1',)
    """

    path: Path
    robot: Manipulator
    left_out: tuple[str, ...]
    rms: Float[np.ndarray, " joints"]
    largest: Float[np.ndarray, " joints"]
    motors: Path | None = None


def write_robot(
    network: CSLC, parameters: PhysicalParameters, path: str | Path, *, states: States | None = None
) -> WrittenRobot:
    """Writes physical parameters into a copy of the robot's file, and reads it again.

    Nothing but numbers of links and joints changes: comments, layout and all that is not dynamics
    stay byte by byte as they are. TOML, URDF and MJCF. TOML takes viscous and dry friction for all
    joints or for none: where some joint has no such term, its keys stay as they are. Slopes of
    static friction go to the TOML joints that have it. Motor inertias of a URDF's joints, for which
    it has no element, go into a file beside it (`motor_file`). A payload is no part of the robot:
    it is left out, and the file is that of the arm without it.

    **Arguments**

    - `network`: derived from a robot that was read from a file (`load_robot`).
    - `parameters`: from `physical_parameters`, with `fixed=network.robot.source.carried` for URDF
      and MJCF, so that fixed bodies keep their numbers.
    - `path`: of the file to write, of the same kind; the robot's file itself is allowed.
      Missing folders are made.
    - `states`: positions, velocities and accelerations at which the file's torques are compared,
      (states, n) each; random ones if omitted.

    **Returns**

    - The file, read again, and the difference of its torques from those of the parameters.

    **Raises**

    - `RobotError`: if the robot comes from no file, or a body or joint cannot be found in it.
    - `OSError`: if the file cannot be read or written.

    >>> import tempfile
    >>> import numpy as np, jaxcslc as jc
    >>> with tempfile.TemporaryDirectory() as name:
    ...     folder = Path(name)
    ...     _ = (folder / "arm.toml").write_text("gravity = [0, -9.81, 0]\\n[[joint]]  # hinge\\n")
    ...     network = jc.derive(jc.load_robot(folder / "arm.toml"), lengths="numeric")
    ...     t = np.linspace(0, 5, 500)[:, None]
    ...     motion, pairs = (np.sin(t), np.cos(t), -np.sin(t)), np.ones(t.shape, bool)
    ...     torque = np.asarray(network.torque(np.array([0.5, 0.3, -0.1, 0.2, 0.05]), *motion))
    ...     torque = torque + 0.01 * np.random.default_rng(0).normal(size=t.shape)
    ...     patterns = jc.Patterns(t[:, 0], *motion, torque, pairs, pairs)
    ...     parameters = jc.physical_parameters(network, jc.LeastSquares().fit(network, patterns))
    ...     written = jc.write_robot(network, parameters, folder / "identified.toml")
    ...     text = written.path.read_text()
    >>> "# hinge" in text, "mass = " in text, bool(written.largest.max() < 1e-9)
    (True, True, True)
    """
    robot, path = network.robot, Path(path)
    source = robot.source
    if source is None:
        raise RobotError(f"robot {robot.name!r} was read from no file; expected one to write to")
    original = Path(source.path)
    if path.suffix.lower() != original.suffix.lower():
        raise RobotError(f"{path}: expected a name ending in {original.suffix}, as {original.name}")

    # The file's friction model may not be that of the network.
    def load(file: Path) -> Manipulator:
        if source.format == "toml":
            return load_robot(file)
        parts: dict[str, Any] = {"base": source.base, "tip": source.tips, "fix": source.fix}
        return load_robot(file, **parts, mimic=source.mimic)

    filed = load(original)
    stored = _stored(network, filed)
    slopes = _slopes(network, filed) if source.format == "toml" else {}
    text = with_parameters(robot, parameters, original.read_bytes(), stored=stored, slopes=slopes)
    path.parent.mkdir(parents=True, exist_ok=True)
    scratch = path.with_name(f".{path.stem}.part{path.suffix}")
    with _named(scratch, path):
        try:
            scratch.write_bytes(text)
            written = load(scratch)
            if written.links is None:
                notes = "" if written.source is None else "; ".join(written.source.notes)
                raise RobotError(f"its links still have no parameters: {notes}")
            scratch.replace(path)  # whole and readable, or not at all
        finally:
            with contextlib.suppress(OSError):
                scratch.unlink(missing_ok=True)
    again = load(path)
    motors = _motors(path, source, parameters)
    q, qd, qdd = random_states(network.joint_count) if states is None else states
    file_network = derive(again, lengths=network.algebra.lengths)
    assert again.links is not None
    drives: dict[str, Any] = {
        kind: values
        for kind, values in (("viscous", again.viscous), ("dry", again.dry))
        if values is not None and kind in stored and kind in parameters.friction
    }
    links_of_file = again.links
    if motors is not None:
        inertias = read_motor_inertias(motors)
        links_of_file = tuple(
            dataclasses.replace(link, motor_inertia=inertias[joint])
            for link, joint in zip(links_of_file, source.joints, strict=True)
        )
    from_file = file_network.coefficients_from(links_of_file, **drives)
    links = parameters.links
    friction: dict[str, Any] = {
        kind: parameters.friction[kind]
        for kind in ("viscous", "dry")
        if kind in stored and kind in parameters.friction
    }
    wanted = network.coefficients_from(links, **friction)
    change = np.asarray(file_network.torque(from_file, q, qd, qdd)) - np.asarray(
        network.torque(wanted, q, qd, qdd)
    )
    return WrittenRobot(
        path,
        again,
        tuple(_left_out(network, stored)),
        np.sqrt(np.mean(change**2, axis=0)),
        np.max(np.abs(change), axis=0),
        motors,
    )


@contextlib.contextmanager
def _named(scratch: Path, path: Path) -> Generator[None]:
    """Errors name the file to be written, not the temporary one."""
    try:
        yield
    except RobotError as error:
        raise RobotError(str(error).replace(str(scratch), str(path))) from None
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None


def _stored(network: CSLC, filed: Manipulator) -> tuple[str, ...]:
    """Return the kinds of parameters that the file can store.

    For TOML, these are the kinds of every joint of both the network and the file.
    """
    assert filed.source is not None
    kinds = STORED[filed.source.format]
    if filed.source.format != "toml":
        return kinds
    joints = (*network.robot.friction_per_joint, *filed.friction_per_joint)
    return tuple(
        kind for kind in kinds if kind == "motor_inertia" or all(kind in j for j in joints)
    )


def _slopes(network: CSLC, filed: Manipulator) -> dict[int, float]:
    """The network's slopes of joints that have static friction in the file too."""
    if network.static_slopes is None:
        return {}
    kinds = zip(network.robot.friction_per_joint, filed.friction_per_joint, strict=True)
    slopes = np.asarray(network.static_slopes, float)
    return {
        joint: float(slopes[joint])
        for joint, (of_network, of_file) in enumerate(kinds)
        if "static" in of_network and "static" in of_file
    }


def _motors(path: Path, source: Source, parameters: PhysicalParameters) -> Path | None:
    """The file of a URDF's motor inertias, written if there are any; an older one is removed."""
    if source.format != "urdf":
        return None
    inertias = [float(link.motor_inertia) for link in parameters.links]
    if any(inertias):
        return write_motor_inertias(path, dict(zip(source.joints, inertias, strict=True)))
    motor_file(path).unlink(missing_ok=True)
    return None


def _left_out(network: CSLC, stored: tuple[str, ...]) -> list[str]:
    names: list[str] = []
    for term in network.input_terms:
        if term.kind not in stored:
            names += term.names
    return names + list(network.names[network.layout.payload])


def random_states(n: int) -> States:
    """A hundred states at which torques of an arm are compared."""
    rng = np.random.default_rng(0)
    q, qd, qdd = rng.uniform(-1, 1, (3, 100, n))
    return np.pi * q, qd, qdd
