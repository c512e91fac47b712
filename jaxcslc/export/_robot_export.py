"""Robot files with identified parameters, read again and compared.

`export_robot` finds the possible parameters nearest to an identification, `write_robot` writes them
into a copy of the robot's file. `_parameter_files` edits the text.
"""

import dataclasses
from collections.abc import Callable, Collection
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from .._scratch import all_together, hidden_beside
from .._text_table import text_table
from ..bodies import (
    FilePrior,
    FileWeight,
    PhysicalParameters,
    fixed_bodies,
    moved_bodies,
    other_masses,
    physical_parameters,
)
from ..least_squares import Identification
from ..manipulator import Manipulator, RobotError, Source, load_robot
from ..network import CSLC, derive
from ..recordings import Patterns
from ..uncertainty import SystematicError
from ._parameter_files import (
    STORED,
    motor_file,
    read_motor_inertias,
    rounded,
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

    **Attributes**

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
    """Write physical parameters into a copy of the robot's file, and read it again.

    Nothing but numbers of links and joints changes: all other bytes, comments and layout included,
    stay as they are. TOML, URDF and MJCF. TOML takes viscous and dry friction for all
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

    **Returns** the file, read again, and the difference of its torques from the parameters'.

    **Raises**

    - `RobotError`: if the robot comes from no file, or a body or joint cannot be found in it.
    - `OSError`: if the file cannot be read or written.

    >>> import tempfile
    >>> import jaxcslc as jc
    >>> with tempfile.TemporaryDirectory() as name:
    ...     folder = Path(name)
    ...     _ = (folder / "arm.toml").write_text("gravity = [0, -9.81, 0]\\n[[joint]]  # hinge\\n")
    ...     network = jc.derive(jc.load_robot(folder / "arm.toml"), lengths="numeric")
    ...     patterns = jc.examples.swing(network, [0.5, 0.3, -0.1, 0.2, 0.05])
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
    try:
        # In the same folder, from which the file may name others; readable, or not at all.
        with hidden_beside(path) as scratch:
            try:
                scratch.write_bytes(text)
                written = load(scratch)
            except RobotError as error:
                raise RobotError(str(error).replace(str(scratch), str(path))) from None
        if written.links is None:
            notes = "" if written.source is None else "; ".join(written.source.notes)
            raise RobotError(f"its links still have no parameters: {notes}")
        motors = _write(path, text, source, parameters)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None
    again = load(path)
    q, qd, qdd = random_states(network.joint_count) if states is None else states
    kinds = [kind for kind in ("viscous", "dry") if kind in stored and kind in parameters.friction]
    file_network = derive(again, lengths=network.algebra.lengths)
    from_file = _coefficients_of_file(file_network, source, kinds, motors)
    friction: dict[str, Any] = {kind: parameters.friction[kind] for kind in kinds}
    wanted = network.coefficients_from(parameters.links, **friction)
    change = np.asarray(file_network.torque(from_file, q, qd, qdd)) - np.asarray(
        network.torque(wanted, q, qd, qdd)
    )
    return WrittenRobot(
        path,
        again,
        _left_out(network, stored),
        np.sqrt(np.mean(change**2, axis=0)),
        np.max(np.abs(change), axis=0),
        motors,
    )


def _coefficients_of_file(
    network: CSLC, source: Source, kinds: Collection[str], motors: Path | None
) -> Any:
    """Return coefficients of the file's links, of some kinds of its friction, and of its motors."""
    robot = network.robot
    assert robot.links is not None
    links = robot.links
    if motors is not None:
        inertias = read_motor_inertias(motors)
        links = tuple(
            dataclasses.replace(link, motor_inertia=inertias[joint])
            for link, joint in zip(links, source.joints, strict=True)
        )
    values = {"viscous": robot.viscous, "dry": robot.dry}
    friction: dict[str, Any] = {kind: values[kind] for kind in kinds if values[kind] is not None}
    return network.coefficients_from(links, **friction)


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
    """Return the network's slopes of joints that have static friction in the file too."""
    if network.static_slopes is None:
        return {}
    kinds = zip(network.robot.friction_per_joint, filed.friction_per_joint, strict=True)
    slopes = np.asarray(network.static_slopes, float)
    return {
        joint: float(slopes[joint])
        for joint, (of_network, of_file) in enumerate(kinds)
        if "static" in of_network and "static" in of_file
    }


def _write(path: Path, text: bytes, source: Source, parameters: PhysicalParameters) -> Path | None:
    """Write a robot file and, of a URDF that has some, motor inertias, whose file is returned.

    An older file of motor inertias is removed.
    """
    inertias = [float(link.motor_inertia) for link in parameters.links]
    has_motors = source.format == "urdf" and any(inertias)
    with all_together([path, motor_file(path)]) as (robot, _):
        robot.write_bytes(text)
        if has_motors:
            write_motor_inertias(robot, dict(zip(source.joints, inertias, strict=True)))
    if source.format == "urdf" and not has_motors:
        motor_file(path).unlink(missing_ok=True)
    return motor_file(path) if has_motors else None


def _left_out(network: CSLC, stored: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of coefficients that the file cannot store."""
    terms = [term.names for term in network.input_terms if term.kind not in stored]
    return (*chain.from_iterable(terms), *network.names[network.layout.payload])


def random_states(n: int) -> States:
    """Draw a hundred states at which torques of an arm are compared."""
    rng = np.random.default_rng(0)
    q, qd, qdd = rng.uniform(-1, 1, (3, 100, n))
    return np.pi * q, qd, qdd


@dataclass(frozen=True, eq=False)
class RobotExport:
    """A robot file with identified parameters, and their distance from the fit.

    `print` shows what `jaxcslc export` prints.

    **Attributes**

    - `network`: of the identified robot.
    - `parameters`: the possible link parameters nearest to the identified coefficients.
    - `written`: the file, and the torques that it predicts when it is read again.
    - `measured`: whether torques were compared over recorded motion, not over random states.
    - `warnings`: about bodies that are far from the fit, a sentence each.
    """

    network: CSLC
    parameters: PhysicalParameters
    written: WrittenRobot
    measured: bool
    warnings: tuple[str, ...] = ()

    def __str__(self) -> str:
        written, parameters = self.written, self.parameters
        units = self.network.output_units
        names = self.network.output_names
        rows = [
            [names[j], f"{parameters.torque_distance[j]:.3g}", f"{written.rms[j]:.1g}", units[j]]
            for j in range(len(units))
        ]
        table = parameters.to_pandas().apply(rounded)
        units_of = {"mass": "kg"} | {f"r{axis}": "m" for axis in "xyz"}
        table.columns = [f"{name} [{units_of.get(name, 'kg m²')}]" for name in table.columns]
        states = "the recording's motion" if self.measured else "random states"
        header = ["joint", "cost of physical consistency", "file against parameters", "unit"]
        lines = [
            f"{self.network}\n",
            f"{table.to_string(float_format=lambda x: f'{x:.5g}')}\n",
            "in the frames of the robot's file; rx, ry, rz: centre of gravity; I..: about it\n",
            f"physically consistent parameters are {parameters.distance:.3g} standard errors from"
            " the identified coefficients (root mean square)",
            f"\nRMS difference of torque over {states}",
            text_table(header, rows),
        ]
        lines += [f"warning: {warning}" for warning in self.warnings]
        if written.motors is not None:
            lines.append(
                f"URDF has no element for motor inertia: {written.motors} holds it. Link inertias"
                " of the URDF do not include it, except with --no-motors."
            )
        if written.left_out:
            lines.append(f"the file has no entry for {', '.join(written.left_out)}: omitted")
        lines.append(
            f"\nwrote {written.path}; read again, it predicts the same torques to"
            f" {np.max(written.largest):.1g} {' or '.join(dict.fromkeys(units))}"
        )
        return "\n".join(lines)


def export_robot(
    network: CSLC,
    fit: Identification,
    path: str | Path,
    *,
    motion: Patterns | None = None,
    motors: bool = True,
    systematic: SystematicError | None = None,
    bodies: PhysicalParameters | None = None,
    file_weight: FileWeight | None = None,
    progress: Callable[[str], None] | None = None,
) -> RobotExport:
    """Write the physically consistent parameters of an identification into a copy of the robot's
    file.

    Bodies that the robot's file fixes to a link keep their numbers. Motor inertias go to TOML's
    `motor_inertia`, MJCF's `armature` or, for URDF, a file beside it (`motor_file`).

    **Arguments**

    - `network`: derived from a robot that was read from a file.
    - `fit`: of this network.
    - `path`: of the file to write, of the same kind as the robot's.
    - `motion`: states at which torques are compared; random ones if omitted.
    - `motors`: whether joints have motor inertia where the network has it. False fixes it at zero:
      for a simulator that has none, at the cost of bodies that compensate it.
    - `systematic`: of the fit: added to the standard errors that movements are counted in.
    - `bodies`: of the identification (`Report.bodies`); those nearest to the fit if None.
    - `file_weight`: of the fit, if the robot's file was a prior of it (`Report.file_prior`): its
      coefficients then contain the file's values already.
    - `progress`: is called with a short text at the start of every step.

    **Returns** the parameters, the written file, and how well it reproduces their torque.

    **Raises** the errors of `physical_parameters` and `write_robot`.

    >>> import tempfile
    >>> import jaxcslc as jc
    >>> from jaxcslc.export import export_robot
    >>> with tempfile.TemporaryDirectory() as name:
    ...     folder = Path(name)
    ...     _ = (folder / "arm.toml").write_text("gravity = [0, -9.81, 0]\\n[[joint]]  # hinge\\n")
    ...     network = jc.derive(jc.load_robot(folder / "arm.toml"), lengths="numeric")
    ...     patterns = jc.examples.swing(network, [0.5, 0.3, -0.1, 0.2, 0.05])
    ...     fit = jc.Settings().fit(network, patterns)
    ...     export = export_robot(network, fit, folder / "identified.toml", motion=patterns)
    >>> bool(export.written.largest.max() < 1e-9)
    True
    """
    report = progress or (lambda _: None)
    if motion is None:
        q, qd, qdd = random_states(network.joint_count)
        mask = np.ones(q.shape, bool)
        states = Patterns(np.arange(float(len(q))), q, qd, qdd, 0 * q, mask, mask)
    else:
        states = motion
    report("fitting physically consistent parameters")
    if bodies is None or not motors:
        bodies = _nearest(network, fit, states, bodies, file_weight, motors)
    parameters = bodies
    report("writing and reading again")
    written = write_robot(network, parameters, path, states=(states.q, states.qd, states.qdd))
    warnings = moved_bodies(network, fit, parameters, systematic, motors=motors)
    warnings += other_masses(network, parameters)
    return RobotExport(network, parameters, written, motion is not None, warnings)


def _nearest(
    network: CSLC,
    fit: Identification,
    states: Patterns,
    bodies: PhysicalParameters | None,
    file_weight: FileWeight | None,
    motors: bool,
) -> PhysicalParameters:
    """Return the consistent parameters nearest to bodies or, without such, to a fit.

    Of a fit with the robot's file as prior, the file decides only what no coefficient depends on:
    it would count twice otherwise.
    """
    prior = None if file_weight is None else FilePrior.of(network)
    if prior is not None and file_weight is not None:
        prior = prior.as_tie_break(file_weight.widths)
    if bodies is not None:
        fit, links, confidence = fit.with_k(bodies.k), bodies.links, None
    else:
        links = None if prior is None else prior.bodies
        confidence = None if prior is None else prior.confidence
    return physical_parameters(
        network,
        fit,
        links,
        fixed=fixed_bodies(network.robot),
        patterns=states,
        motors=motors,
        confidence=confidence,
    )
