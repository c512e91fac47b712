import contextlib
import json
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from ..assessment import (
    ErrorTable,
    all_or_nothing,
    coefficient_rows,
    coefficient_text,
    compare,
    degree_of_excitation,
    identification_report,
)
from ..learning import (
    Settings,
    SlopeFit,
    choose_settings,
    cross_validated_error,
    fit_slopes,
    held_out_error,
    settings_from,
)
from ..motion import Recording, load_recording
from ..network import CSLC
from ._common import (
    BaseOption,
    CoupledOption,
    FrictionOption,
    LengthsOption,
    RobotArgument,
    TipOption,
    network_of,
    one_line_errors,
    progress,
    robot_named,
    usable,
    with_drives,
)


def identify_command(
    robot: RobotArgument,
    train: Annotated[Path, typer.Argument(metavar="TRAIN", help="Recording to learn from.")],
    validate: Annotated[
        Path | None, typer.Option(help="Recording to judge on; nothing is learnt from it.")
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the results.")] = Path(
        "identified"
    ),
    lengths: LengthsOption = "auto",
    base: BaseOption = None,
    tip: TipOption = None,
    friction: FrictionOption = None,
    coupled: CoupledOption = None,
    settings: Annotated[
        Path | None,
        typer.Option(
            help="Settings from an earlier run's identification.json, or written by hand;"
            " chosen by cross-validation within TRAIN if omitted."
        ),
    ] = None,
) -> None:
    """Identify a robot's coefficients from a recording of positions and torques."""
    with one_line_errors(), progress("reading") as step:
        usable(output)
        network = network_of(with_drives(robot_named(robot, base, tip), friction, coupled), lengths)
        recording = load_recording(train, joints=network.joint_count)
        held_out = None if validate is None else load_recording(validate, network.joint_count)
        if settings is None:
            step("choosing smoothing and masks by cross-validation")
            with _of_file(train):
                chosen = choose_settings(network, recording).settings
        else:
            chosen = _settings(settings)
        step("preparing patterns")
        with _of_file(train):
            patterns = {"training": chosen.patterns(recording)}
        if held_out is not None and validate is not None:
            with _of_file(validate):
                patterns["validation"] = chosen.patterns(held_out)
        slopes = ""
        if "static" in network.robot.friction_terms:
            step("looking for the slopes of static friction")
            searched = fit_slopes(network, patterns["training"], joint_weights=chosen.joint_weights)
            network, slopes = searched.network, _slopes(searched.network, searched)
        step("solving")
        fit = chosen.fit(network, patterns["training"])
        step("judging")
        excitation = degree_of_excitation(network, patterns["training"])
        if held_out is None:
            elsewhere = cross_validated_error(network, patterns["training"], chosen)
        else:
            elsewhere = held_out_error(network, fit, patterns["training"], patterns["validation"])
        step("writing")
        errors = {name: compare(network, p, {"fit": fit.k}) for name, p in patterns.items()}
        with all_or_nothing(output) as folder:
            written = identification_report(
                folder,
                network,
                fit,
                patterns,
                errors,
                chosen,
                excitation=excitation,
                held_out=elsewhere,
            )
    typer.echo(f"{network}\nsettings: {chosen}\n")
    typer.echo(coefficient_text(coefficient_rows(network, fit, excitation=excitation)))
    if slopes:
        typer.echo(f"\n{slopes}")
    typer.echo(
        f"\nlow and high: 95 % intervals for {fit.errors} errors, {float(fit.freedom):.0f} degrees"
        " of freedom"
    )
    for sentence in fit.unidentifiable:
        typer.echo(f"not determined: {sentence}")
    typer.echo(
        f"rank {int(fit.rank)} of {network.size}, condition {float(fit.condition):.4g}; told least:"
        f" {excitation.worst_combination}"
    )
    for name, table in errors.items():
        typer.echo(f"\ntorque error, {name} recording\n{table}")
    kind = "cross-validated within the training recording" if held_out is None else "held out"
    ratios = ", ".join(f"{ratio:.3g}" for ratio in elsewhere.ratio)
    typer.echo(f"\ntorque error, {kind}, over training error, joint by joint: {ratios}")
    for sentence in elsewhere.warnings:
        typer.echo(f"warning: {sentence}")
    for sentence in (*_standstills(recording), *_unexplained(recording, errors["training"])):
        typer.echo(f"warning: {sentence}")
    if held_out is None:  # of an earlier run
        for name in ("errors_validation.csv", "torque_validation.csv", "torque_validation.png"):
            (output / name).unlink(missing_ok=True)
    typer.echo("\nwrote " + ", ".join(str(output / path.name) for path in written))


@contextlib.contextmanager
def _of_file(path: Path) -> Generator[None]:
    """Says which file it was that something cannot be made of."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _standstills(recording: Recording) -> Iterator[str]:
    still = np.ptp(recording.position, axis=0) == 0
    for joint in np.flatnonzero(still) + 1:
        yield f"joint {joint} does not move: what its motion alone would tell is not determined"


def _unexplained(recording: Recording, table: ErrorTable) -> Iterator[str]:
    """Joints of whose torque's variation less than half is explained, as by a wrong unit."""
    spread = np.std(recording.torque, axis=0)
    for joint, (error, size) in enumerate(zip(np.asarray(table.rms[0]), spread, strict=True), 1):
        if size == 0:
            yield f"the torque of joint {joint} never changes"
        elif error > np.sqrt(0.5) * size:
            yield (
                f"the torque of joint {joint} is hardly explained: an error of {error:.3g} where"
                f" the torque itself varies by {size:.3g}; are positions in rad, torques in N m,"
                " and their signs those of the robot file?"
            )


def _slopes(network: CSLC, found: SlopeFit) -> str:
    listed = ", ".join(
        f"joint {joint} {slope:.4g} ± {error:.2g}"
        for joint, slope, error in zip(
            range(1, network.joint_count + 1),
            np.asarray(found.slopes),
            np.asarray(found.slope_error),
            strict=True,
        )
        if "static" in network.robot.friction_per_joint[joint - 1]
    )
    return (
        f"slopes of static friction [s/rad or s/m]: {listed};"
        " the intervals above take them as given"
    )


def _settings(path: Path) -> Settings:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise ValueError(f"{path}: not valid JSON: {error}") from None
    if not isinstance(document, dict):
        raise ValueError(f"{path}: expected settings as a JSON object")
    try:
        return settings_from(document.get("settings", document))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
