from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from jaxtyping import Array

from ..identification import SlopeFit, cross_validated_error, fit_slopes, held_out_error
from ..identification.report import (
    ErrorTable,
    all_or_nothing,
    coefficient_rows,
    coefficient_text,
    compare,
    degree_of_excitation,
    identification_report,
)
from ..motion import Recording
from ..motion.files import load_recording
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
from ._identified import identified
from ._recorded import SettingsOption, of_file, settings_for


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
    settings: SettingsOption = None,
    relearn: Annotated[
        str | None,
        typer.Option(
            metavar="WORDS",
            help="Learn only these coefficients, by group or name as in viscous,dry; the others"
            " stay as in --known.",
        ),
    ] = None,
    known: Annotated[
        Path | None,
        typer.Option(help="The identification.json of an earlier run, for --relearn."),
    ] = None,
) -> None:
    """Identify a robot's coefficients from a recording of positions and torques."""
    with one_line_errors(), progress("reading") as step:
        usable(output)
        if (relearn is None) != (known is None):
            raise ValueError("--relearn and --known: expected both or neither")
        drawn = robot_named(robot, base, tip)
        if known is None:
            before = None
            network = network_of(with_drives(drawn, friction, coupled), lengths)
        elif lengths != "auto" or friction is not None or coupled:
            raise ValueError("--lengths, --friction and --coupled: not with --known, which has own")
        else:
            before = identified(drawn, known, robot)
            network = before.network
        recording = load_recording(train, joints=network.joint_count)
        held_out = None if validate is None else load_recording(validate, network.joint_count)
        step("choosing smoothing and masks")
        chosen = settings_for(network, recording, train, settings, before)
        step("preparing patterns")
        with of_file(train):
            patterns = {"training": chosen.patterns(recording)}
        if held_out is not None and validate is not None:
            with of_file(validate):
                patterns["validation"] = chosen.patterns(held_out)
        slopes, words = "", [word.strip() for word in (relearn or "").split(",")]
        if before is None and "static" in network.robot.friction_terms:
            step("looking for the slopes of static friction")
            searched = fit_slopes(network, patterns["training"], solver=chosen.solver)
            network, slopes = searched.network, _slopes(searched.network, searched)
        step("solving")
        vectors: dict[str, Array] = {}
        if before is None:
            fit = chosen.fit(network, patterns["training"])
        else:
            fit = chosen.reidentify(network, patterns["training"], before.fit, words)
            vectors["before"] = before.fit.k
        step("judging")
        excitation = elsewhere = None
        if before is None:  # what the whole recording tells of all coefficients
            excitation = degree_of_excitation(network, patterns["training"])
        if held_out is None and before is None:
            elsewhere = cross_validated_error(network, patterns["training"], chosen)
        elif held_out is not None:
            elsewhere = held_out_error(network, fit, patterns["training"], patterns["validation"])
        step("writing")
        errors = {
            name: compare(network, p, {"fit": fit.k, **vectors}) for name, p in patterns.items()
        }
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
    if before is not None:
        typer.echo(f"learnt again: {', '.join(words)}; all others are those of {known}\n")
    typer.echo(coefficient_text(coefficient_rows(network, fit, excitation=excitation)))
    if slopes:
        typer.echo(f"\n{slopes}")
    typer.echo(
        f"\nlow and high: 95 % intervals for {fit.errors} errors,"
        f" {float(fit.degrees_of_freedom):.0f} degrees of freedom"
    )
    for sentence in fit.unidentifiable:
        typer.echo(f"not determined: {sentence}")
    fitted = network.size if before is None else _count(network, words)
    least = "" if excitation is None else f"; told least: {excitation.worst_combination}"
    typer.echo(f"rank {int(fit.rank)} of {fitted}, condition {float(fit.condition):.4g}{least}")
    for name, table in errors.items():
        typer.echo(f"\ntorque error, {name} recording\n{table}")
    if elsewhere is not None:
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


def _count(network: CSLC, words: list[str]) -> int:
    return sum(c.group in words or c.name in words for c in network.coefficients)


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
