from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from ..identification import PayloadFit, fit_payload, settings_document
from ..identification.report import all_or_nothing, text_table, write_csv, write_json
from ..motion import Patterns
from ..motion.files import load_recording
from ..network import CSLC
from ._common import (
    BaseOption,
    RobotArgument,
    TipOption,
    one_line_errors,
    progress,
    robot_named,
    usable,
)
from ._identified import identified
from ._recorded import SettingsOption, of_file, settings_for


def payload_command(
    robot: RobotArgument,
    loaded: Annotated[
        Path, typer.Argument(metavar="LOADED", help="Recording of the arm carrying the payload.")
    ],
    known: Annotated[
        Path,
        typer.Option(help="The identification.json of the arm without payload, from identify."),
    ],
    unloaded: Annotated[
        Path | None,
        typer.Option(
            help="Recording of the arm without it: the arm's coefficients are then fitted to both"
            " recordings, in place of those of --known."
        ),
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the results.")] = Path(
        "payload"
    ),
    base: BaseOption = None,
    tip: TipOption = None,
    settings: SettingsOption = None,
) -> None:
    """Identify a payload: its mass, centre of gravity and inertia, in the last link's frame."""
    with one_line_errors(), progress("reading") as step:
        usable(output)
        before = identified(robot_named(robot, base, tip), known, robot)
        network = before.network.with_payload()
        recording = load_recording(loaded, joints=network.joint_count)
        empty = None if unloaded is None else load_recording(unloaded, network.joint_count)
        step("choosing smoothing and masks")
        chosen = settings_for(network, recording, loaded, settings, before)
        step("preparing patterns")
        with of_file(loaded):
            patterns = chosen.patterns(recording)
        step("solving")
        if unloaded is None or empty is None:
            found = fit_payload(network, patterns, previous=before.fit, solver=chosen.solver)
        else:
            with of_file(unloaded):
                alone = chosen.patterns(empty)
            found = fit_payload(network, patterns, alone, solver=chosen.solver)
        step("writing")
        errors = _errors(network, found, patterns)
        with all_or_nothing(output) as folder:
            write_csv(folder / "payload.csv", found.rows())
            document = {"robot": network.robot.name, "settings": settings_document(chosen)}
            document |= found.document() | {"torque_error_rms": errors}
            write_json(folder / "payload.json", document)
    typer.echo(f"{network}\nsettings: {chosen}\n")
    header = ["", "unit", "value", "low", "high", "possible"]
    cells = [[row["name"], row["unit"], *_cells(row, header[2:])] for row in found.rows()]
    typer.echo(text_table(header, cells, left=("unit",)))
    typer.echo(
        "\nframe of the last link; I.. at the centre of gravity; low and high: 95 % intervals for"
        f" {found.fit.errors} errors; possible: the nearest body that can exist"
    )
    for sentence in found.unidentifiable:
        typer.echo(f"not determined: {sentence}")
    carried, none = (", ".join(f"{x:.3g}" for x in errors[name]) for name in ("with", "without"))
    typer.echo(f"torque error over the loaded recording, joint by joint: {carried}")
    typer.echo(f"  without the payload's part: {none}")
    typer.echo(f"\nwrote {output / 'payload.csv'}, {output / 'payload.json'}")


def _cells(row: dict[str, Any], names: list[str]) -> list[str]:
    return [f"{row[name]:.4g}" for name in names]


def _errors(network: CSLC, found: PayloadFit, patterns: Patterns) -> dict[str, list[float]]:
    """Root mean square torque error of each joint, with the payload's part and without."""
    k, counts = np.asarray(found.fit.k), np.asarray(patterns.mask)
    errors: dict[str, list[float]] = {}
    without = k.copy()
    without[network.layout.payload] = 0.0
    for name, coefficients in (("with", k), ("without", without)):
        torque = np.asarray(network.torque(coefficients, patterns.q, patterns.qd, patterns.qdd))
        squares = np.where(counts, torque - np.asarray(patterns.torque), 0.0) ** 2
        number = np.maximum(np.sum(counts, axis=0), 1)
        errors[name] = np.sqrt(np.sum(squares, axis=0) / number).tolist()
    return errors
