from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from ..export import CCode, WrittenRobot, c_code, write_robot
from ..identification import PhysicalParameters, physical_parameters
from ..identification.report import text_table
from ..identification.solver import Identification
from ..motion import Patterns
from ..network import CSLC
from ._common import (
    BUNDLED,
    BaseOption,
    RobotArgument,
    TipOption,
    one_line_errors,
    progress,
    robot_named,
)
from ._identified import LARGEST, identified


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
        file = _bundled_file(robot) if robot in BUNDLED else robot
        path = _default(Path(file)) if output is None else output
        if not c and not overwrite and _same(path, Path(file)):
            raise ValueError(f"{path}: is the robot's own file; expected another, or --overwrite")
        found = identified(robot_named(str(file), base, tip), identification, robot)
        network, fit, document = found.network, found.fit, found.document
        states = _states(document, network, identification)
        if c:
            step("writing C")
            code = c_code(network, fit.k)
            said = _write_c(code, output)
        else:
            step("looking for bodies")
            bodies = _possible(network, fit, states)
            step("writing and reading again")
            motion = states.q, states.qd, states.qdd
            written = write_robot(network, bodies, path, states=motion)
            said = _report(network, bodies, written, measured="motion" in document)
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
    if not q.shape == qd.shape == qdd.shape == shape or not np.all(np.abs([q, qd, qdd]) <= LARGEST):
        raise ValueError(f"{path}: motion: expected finite q, qd and qdd of {shape[1]} joints each")
    every = np.ones(q.shape, bool)
    return Patterns(np.arange(len(q), dtype=float), q, qd, qdd, 0 * q, every, every)


def _bundled_file(name: str) -> Path:
    return Path(str(files("jaxcslc.manipulator") / "robots" / f"{name}.toml"))


def _same(path: Path, file: Path) -> bool:
    return path.exists() and file.exists() and path.samefile(file)


def _default(path: Path) -> Path:
    return Path(f"{path.stem}_identified{path.suffix}")
