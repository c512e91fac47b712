import json
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from ..assessment import text_table
from ..export import CCode, WrittenRobot, c_code, write_robot
from ..learning import Identification, PhysicalParameters, physical_parameters
from ..manipulator import Manipulator, RobotError
from ..motion import Patterns
from ..network import CSLC
from ._common import (
    BUNDLED,
    BaseOption,
    RobotArgument,
    TipOption,
    network_of,
    one_line_errors,
    progress,
    robot_named,
)


# SI units. No robot comes near; and squares, in covariances, are far from overflow.
_LARGEST = 1e12


def export_command(
    robot: RobotArgument,
    identification: Annotated[
        Path,
        typer.Argument(
            metavar="IDENTIFICATION", help="The identification.json that identify wrote."
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help="File to write: the robot's with _identified in its name if omitted, or with"
            " --c NAME.c and NAME.h.",
        ),
    ] = None,
    c: Annotated[
        bool, typer.Option("--c", help="Write C code for a controller instead of a robot file.")
    ] = False,
    base: BaseOption = None,
    tip: TipOption = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Let the output be the robot's own file.")
    ] = False,
) -> None:
    """Write what was identified into the robot's own file, or as C code for a controller.

    Masses, centres of gravity and inertia tensors are the possible ones nearest to the identified
    coefficients; nothing else in the file changes. It is read again to prove that it predicts the
    same torques. C code has the identified coefficients as they are.
    """
    with one_line_errors(), progress("reading") as step:
        document = _document(identification)
        file = _bundled_file(robot) if robot in BUNDLED else robot
        path = _default(Path(file)) if output is None else output
        if not c and not overwrite and _same(path, Path(file)):
            raise ValueError(f"{path}: is the robot's own file; expected another, or --overwrite")
        drawn = _with_drives(robot_named(str(file), base, tip), document, identification)
        network = network_of(drawn, _lengths(document))
        network = _with_slopes(network, document, identification)
        fit = _fit(identification)
        if difference := _difference(network, document, fit.names, robot):
            raise ValueError(
                f"{identification}: {difference}; expected an identification of this robot"
            )
        states = _states(document, network, identification)
        if c:
            step("writing C")
            code = c_code(network, fit.k)
            said = _write_c(code, output)
        else:
            step("looking for bodies")
            found = _possible(network, fit, states)
            step("writing and reading again")
            motion = states.q, states.qd, states.qdd
            written = write_robot(network, found, path, states=motion)
            said = _report(network, found, written, measured="motion" in document)
    typer.echo(said)


def _possible(network: CSLC, fit: Identification, states: Patterns) -> PhysicalParameters:
    source = network.robot.source
    carried = source.carried if source is not None else None
    fixed = carried if carried is not None and any(body is not None for body in carried) else None
    drives = source is None or source.format != "urdf"
    return physical_parameters(network, fit, fixed=fixed, patterns=states, motors=drives)


def _report(
    network: CSLC, found: PhysicalParameters, written: WrittenRobot, *, measured: bool
) -> str:
    lines = [f"{network}", "", found.to_pandas().to_string(float_format=lambda x: f"{x:.5g}"), ""]
    lines.append(
        f"possible parameters are {found.distance:.3g} standard errors from the identified"
        " coefficients (root mean square)"
    )
    units = ["N m" if kind == "R" else "N" for kind in network.robot.kinds]
    header = ["joint", "cost of being possible", "file against parameters", "unit"]
    rows = [
        [
            str(joint + 1),
            f"{found.torque_distance[joint]:.3g}",
            f"{written.rms[joint]:.1e}",
            unit,
        ]
        for joint, unit in enumerate(units)
    ]
    where = "the recording's motion" if measured else "random states"
    lines += [f"\nRMS difference of torque over {where}", text_table(header, rows)]
    if network.robot.source is not None and network.robot.source.format == "urdf":
        lines.append("URDF has no word for motor inertia: it was held at zero")
    if written.left_out:
        lines.append(f"the file has no place for {', '.join(written.left_out)}: left out")
    lines.append(
        f"\nwrote {written.path}; read again, it predicts the same torques to"
        f" {np.max(written.largest):.1e} {' or '.join(dict.fromkeys(units))}"
    )
    return "\n".join(lines)


def _write_c(code: CCode, output: Path | None) -> str:
    source = Path(f"{code.name}.c") if output is None else output
    if source.suffix != ".c":
        raise ValueError(f"{source}: expected a name ending in .c")
    header = source.with_suffix(".h")
    # The source includes its header by name.
    text = code.source.replace(f'#include "{code.name}.h"', f'#include "{header.name}"')
    source.parent.mkdir(parents=True, exist_ok=True)
    header.write_text(code.header, encoding="ascii")
    source.write_text(text, encoding="ascii")
    counts = ", ".join(f"{name} {count}" for name, count in code.operations.items())
    return f"operations: {counts}\nwrote {source} and {header}"


def _document(path: Path) -> dict[str, Any]:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ValueError(f"{path}: no such identification") from None
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(f"{path}: not valid JSON: {error}") from None
    if not isinstance(document, dict):
        raise ValueError(f"{path}: expected an identification as a JSON object")
    return document


def _lengths(document: dict[str, Any]) -> str:
    lengths = document.get("lengths", "auto")
    return ",".join(lengths) if isinstance(lengths, list) else str(lengths)


def _with_drives(robot: Manipulator, document: dict[str, Any], path: Path) -> Manipulator:
    """With the friction and couplings of the identification, where the file says nothing of them.

    What a file says of single joints, and its own couplings, are for `_difference` to compare.
    """
    words, pairs = document.get("friction"), document.get("coupled")
    for name, value in (("friction", words), ("coupled", pairs)):
        if value is not None and not isinstance(value, list):
            raise ValueError(f"{path}: {name}: expected a list")
    if robot.own_friction is not None:
        return robot
    try:
        if words is not None and tuple(words) != robot.friction:
            robot = robot.with_friction(*words)
        if pairs and not robot.coupled:
            robot = robot.with_coupling(*pairs)
    except (RobotError, TypeError) as error:
        raise ValueError(f"{path}: {error}") from None
    return robot


def _difference(
    network: CSLC, document: dict[str, Any], names: tuple[str, ...], robot: str
) -> str | None:
    """In what the identification is another robot's; None if in nothing that can be told."""
    if names != network.names:
        return f"has coefficients {_few(names)}; {robot} has {_few(network.names)}"
    expressions = document.get("expressions")
    if expressions is None:
        named = document.get("robot", network.robot.name)
        if named != network.robot.name:  # nothing else to tell robots of one structure apart by
            return f"is of robot {named!r}; {robot} is {network.robot.name!r}"
    elif not isinstance(expressions, list) or len(expressions) != len(names):
        return f"expressions: is no list of {len(names)}"
    else:
        for coefficient, theirs in zip(network.coefficients, expressions, strict=True):
            if theirs != coefficient.expression:
                return f"{coefficient.name} is {theirs}; of {robot} it is {coefficient.expression}"
    own = [list(pair) for pair in network.robot.coupled]
    if document.get("coupled", own) != own:
        return f"has coupled joints {document['coupled']}; {robot} has {own}"
    return None


def _fit(path: Path) -> Identification:
    """**Raises** `ValueError` for numbers that are no robot's, and would overflow on the way."""
    try:
        fit = Identification.load(path)
    except OverflowError as error:
        raise ValueError(f"{path}: {error}") from None
    for name, value in zip(fit.names, np.asarray(fit.k), strict=True):
        if not abs(value) <= _LARGEST:
            raise ValueError(
                f"{path}: {name} is {value:.3g}; expected finite coefficients below {_LARGEST:g}"
            )
    for name in ("covariance", "independent_covariance"):
        if np.any(np.abs(np.asarray(getattr(fit, name))) > _LARGEST**2):
            raise ValueError(f"{path}: {name}: expected variances below {_LARGEST**2:g}")
    return fit


def _with_slopes(network: CSLC, document: dict[str, Any], path: Path) -> CSLC:
    """With the slopes of static friction that were found."""
    if network.static_slopes is None or "static_slopes" not in document:
        return network
    try:
        return network.with_static_slopes(np.asarray(document["static_slopes"], float))
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: static_slopes: {error}") from None


def _states(document: dict[str, Any], network: CSLC, path: Path) -> Patterns:
    """Motion of the recording, as patterns without torques; random if the document has none."""
    motion = document.get("motion")
    if motion is None:
        drawn = np.random.default_rng(0).uniform(-1, 1, (3, 100, network.joint_count))
        motion = dict(zip(("q", "qd", "qdd"), drawn * [[[np.pi]], [[1.0]], [[1.0]]], strict=True))
    try:
        q, qd, qdd = (np.asarray(motion[name], float) for name in ("q", "qd", "qdd"))
    except (KeyError, TypeError, ValueError):
        raise ValueError(f"{path}: motion: expected arrays q, qd and qdd") from None
    shape = (len(q), network.joint_count)
    if not q.shape == qd.shape == qdd.shape == shape or not np.all(
        np.abs([q, qd, qdd]) <= _LARGEST
    ):
        raise ValueError(f"{path}: motion: expected finite q, qd and qdd of {shape[1]} joints each")
    every = np.ones(q.shape, bool)
    return Patterns(np.arange(len(q), dtype=float), q, qd, qdd, 0 * q, every, every)


def _bundled_file(name: str) -> Path:
    return Path(str(files("jaxcslc.manipulator") / "robots" / f"{name}.toml"))


def _same(path: Path, file: Path) -> bool:
    return path.exists() and file.exists() and path.samefile(file)


def _default(path: Path) -> Path:
    return Path(f"{path.stem}_identified{path.suffix}")


def _few(names: tuple[str, ...]) -> str:
    return f"{names[0]} to {names[-1]} ({len(names)})" if names else "none"
