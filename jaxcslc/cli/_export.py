import json
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from ..assessment import text_table
from ..export import CCode, WrittenRobot, c_code, write_robot
from ..learning import Identification, PhysicalParameters, physical_parameters
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
) -> None:
    """Write what was identified into the robot's own file, or as C code for a controller.

    Masses, centres of gravity and inertia tensors are the possible ones nearest to the identified
    coefficients; nothing else in the file changes. It is read again to prove that it predicts the
    same torques. C code has the identified coefficients as they are.
    """
    with one_line_errors(), progress("reading") as step:
        document = _document(identification)
        file = _bundled_file(robot) if robot in BUNDLED else robot
        network = network_of(robot_named(str(file), base, tip), _lengths(document))
        network = _with_slopes(network, document, identification)
        fit = Identification.load(identification)
        if fit.names != network.names:
            raise ValueError(
                f"{identification}: has coefficients {_few(fit.names)}; {robot} has"
                f" {_few(network.names)}; expected an identification of this robot"
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
            path = _default(Path(file)) if output is None else output
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
        lines.append(f"the file has no words for {', '.join(written.left_out)}: left out")
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
    if not q.shape == qd.shape == qdd.shape == shape or not np.isfinite([q, qd, qdd]).all():
        raise ValueError(f"{path}: motion: expected finite q, qd and qdd of {shape[1]} joints each")
    every = np.ones(q.shape, bool)
    return Patterns(np.arange(len(q), dtype=float), q, qd, qdd, 0 * q, every, every)


def _bundled_file(name: str) -> Path:
    return Path(str(files("jaxcslc.manipulator") / "robots" / f"{name}.toml"))


def _default(path: Path) -> Path:
    return Path(f"{path.stem}_identified{path.suffix}")


def _few(names: tuple[str, ...]) -> str:
    return f"{names[0]} to {names[-1]} ({len(names)})" if names else "none"
