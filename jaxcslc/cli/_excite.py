"""The command `jaxcslc excite`: the motion to record next, what it is for, and what is known."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from ..excitation import (
    CRITERIA,
    FAMILIES,
    Effort,
    Goal,
    Knowledge,
    Limits,
    Noise,
    design_files,
    design_motion,
    load_limits,
    save_design,
    wanted_indices,
)
from ..identification import identify
from ..least_squares import Identification, Settings
from ..manipulator import Manipulator
from ..network import CSLC
from ..recordings import Sampling
from ..report import load_report
from ._common import (
    CommandContext,
    check_output,
    choice_of,
    command,
    command_text,
    names_in,
    progress,
    typed_options,
    wrote,
)
from ._inputs import (
    ColumnsOption,
    Drives,
    LengthsOption,
    RobotArgument,
    RobotPart,
    recording_of,
    recordings_of,
)


@dataclasses.dataclass(frozen=True)
class MotionOptions:
    """The motion, the coefficients that it is for, and noise of its recording."""

    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            help="CSV file of the motion; .yaml, .json, .h and .html go beside it.",
        ),
    ] = Path("motion.csv")
    duration: Annotated[float, typer.Option(help="Length of the motion [s].")] = 10.0
    rate: Annotated[
        float,
        typer.Option(
            help="Rows a second, and of the recording [Hz]; that of --prior or --after if omitted.",
        ),
    ] = 500.0
    family: Annotated[
        str,
        typer.Option(
            metavar="splines|fourier|periodic|moves",
            help="B-splines, a Fourier series, one that ends where it starts, or minimum-jerk"
            " moves.",
        ),
    ] = "splines"
    wanted: Annotated[
        str | None,
        typer.Option(
            "--for",
            metavar="NAMES",
            help="Coefficients that matter, by group or name as in viscous,kd5; all if omitted.",
        ),
    ] = None
    payload: Annotated[
        float | None,
        typer.Option(
            metavar="KG",
            help="Design for a payload of about this mass at the last link, which payload"
            " identifies: its coefficients are those that matter, unless --for names others. What"
            " --prior or --after say of the arm counts as known.",
        ),
    ] = None
    criterion: Annotated[
        str,
        typer.Option(
            metavar="overall|error|worst|torque|bodies|A|D|E|condition|scaled_condition",
            help="What is made small: mean or largest standard error over size, error of torques"
            " on --task, the mean of the first and the third (overall), or what other designs use"
            " (docs/excitation.md).",
        ),
    ] = "overall"
    prior: Annotated[
        Path | None,
        typer.Option(
            "--prior", help="identification.json of earlier recordings: what is known already."
        ),
    ] = None
    after: Annotated[
        list[Path] | None,
        typer.Option(help="Earlier recordings, which are identified first; may be repeated."),
    ] = None
    reach: Annotated[
        float | None,
        typer.Option(
            metavar="PERCENT",
            help="Standard error over size that all coefficients of --for should reach: nothing is"
            " designed where they have.",
        ),
    ] = None
    limits: Annotated[
        Path | None,
        typer.Option(
            metavar="LIMITS.TOML",
            help="Limits of joints, and surroundings to keep away from; those of the robot's file"
            " if omitted.",
        ),
    ] = None
    floor: Annotated[
        bool,
        typer.Option(
            help="Keep above the plane through the base's foot, or the floor that --limits states.",
        ),
    ] = True
    torque_noise: Annotated[
        str | None,
        typer.Option(
            metavar="NUMBERS",
            help="Standard deviation of torques, one or one a joint [N m]; of --prior or --after,"
            " or 1 % of the torque limits if omitted.",
        ),
    ] = None
    torque_offset: Annotated[
        str | None,
        typer.Option(
            metavar="NUMBERS",
            help="Standard deviation of constant errors of torques, one or one a joint [N m]; as"
            " large as --torque-noise if omitted, 0 after --prior or --after and for joints with"
            " friction of kind offset or asymmetric_dry.",
        ),
    ] = None
    encoder: Annotated[
        str | None,
        typer.Option(
            metavar="NUMBERS",
            help="Step of encoders, one or one a joint [rad]; that of --prior or --after, or 1e-4"
            " if omitted.",
        ),
    ] = None
    estimator: Annotated[
        str,
        typer.Option(
            metavar="likelihood|regression", help="The estimator that the recording is for."
        ),
    ] = "likelihood"
    task: Annotated[
        Path | None,
        typer.Option(
            help="Recording of the motion on which torques matter, for criteria overall and"
            " torque; random motions within the limits if omitted.",
        ),
    ] = None
    start: Annotated[
        str | None,
        typer.Option(
            metavar="NUMBERS",
            help="Pose to start from, one number a joint [rad or m]; searched for if omitted.",
        ),
    ] = None
    seed: Annotated[
        int, typer.Option(help="Seed of random motions; the same gives the same motion.")
    ] = 0
    starts: Annotated[
        int, typer.Option(help="How many random motions the search starts from; the best counts.")
    ] = 3


# Kinds of friction with a coefficient for a torque that is the same whatever the motion.
_CONSTANTS = {"offset", "asymmetric_dry"}
# Before a first recording: noise of torques over their limits, and the step of encoders [rad].
_TORQUE_NOISE, _ENCODER = 0.01, 1e-4


@command
def excite_command(
    context: CommandContext,
    robot: RobotArgument,
    options: MotionOptions,
    part: RobotPart,
    drives: Drives,
    lengths: LengthsOption = "auto",
    columns: ColumnsOption = None,
) -> None:
    """Design the motion to record next, within all limits, for the least errors."""
    with progress("reading") as step:
        _check_options(context, options)
        arm = part.read(robot)
        before = _before(arm, options, columns, lambda: drives.network(arm, lengths), step)
        names = None if options.wanted is None else names_in(options.wanted)
        if options.payload is not None:
            before, names = before.carrying(options.payload), names or ["payload"]
        bounds = _bounds(arm, options)
        asked = "rate" in typed_options(context)
        rate = options.rate if asked else before.rate(options.rate)
        noise = _noise(before, bounds, _stated_noise(options) | {"rate": rate})
        if reached := _reached(before, names, options.reach):
            return typer.echo(reached)
        task = None if options.task is None else recording_of(options.task, arm, columns)
        design = design_motion(
            before.network,
            bounds,
            noise,
            goal=Goal(options.criterion, names, task),
            knowledge=before.knowledge,
            duration=options.duration,
            family=options.family,
            start=None if not options.start else np.array(_numbers("--start", options.start)),
            seed=options.seed,
            effort=Effort(options.starts),
            progress=step,
        )
        paths = save_design(design, options.output, command=command_text(context))
    lines = [str(design)]
    if before.fit is not None:
        lines += ["", f"{design.family.duration:g} s more are predicted to bring"]
        lines += [f"  {gain}" for gain in design.prediction.gains()]
    if (reach := options.reach) is not None:
        seconds = design.seconds_for(reach / 100)
        lines.append(f"{reach:g} % of all sizes: about {seconds:.3g} s of such motion")
    typer.echo("\n".join([*lines, "", wrote(paths)]))


def _bounds(arm: Manipulator, options: MotionOptions) -> Limits:
    stated = options.limits
    bounds = load_limits(stated, arm) if stated else Limits.of(arm, surroundings="usual")
    return bounds if options.floor else bounds.without_floor()


def _check_options(context: CommandContext, options: MotionOptions) -> None:
    choice_of("--family", options.family, FAMILIES)
    choice_of("--criterion", options.criterion, CRITERIA)
    if options.starts < 1:
        raise ValueError(f"--starts is {options.starts}; expected 1 or more")
    folder = options.output.parent
    if not folder.is_dir():
        raise ValueError(f"{folder}: no such folder")
    check_output(context, folder, design_files(options.output))


@dataclasses.dataclass(frozen=True)
class _Before:
    """Knowledge from earlier recordings."""

    network: CSLC
    knowledge: Knowledge
    fit: Identification | None = None
    settings: Settings | None = None
    sampling: Sampling | None = None

    def rate(self, default: float) -> float:
        """Return the sampling rate [Hz]."""
        return default if self.sampling is None else 1.0 / self.sampling.interval

    def carrying(self, mass: float) -> "_Before":
        """Return the knowledge of the arm with a payload of about that mass [kg]."""
        network = self.network.with_payload()
        knowledge = self.knowledge.with_payload(network, mass)
        return dataclasses.replace(self, network=network, knowledge=knowledge)


def _before(
    arm: Manipulator,
    options: MotionOptions,
    columns: Path | None,
    derived: Callable[[], CSLC],
    step: Callable[[str], None],
) -> _Before:
    prior, after = options.prior, options.after
    if prior is not None and after:
        raise ValueError("--prior and --after: expected one of them")
    if prior is not None:
        report = load_report(prior, arm)
        network = report.network
        sampling = None if report.settings is None else report.settings.chosen_on
    elif after:
        network = derived()
        recordings = recordings_of(after, lambda path: recording_of(path, network.robot, columns))
        report = identify(network, recordings, possible="never", progress=step)
        sampling = Sampling.of(next(iter(recordings.values())))
    else:
        network = derived()
        return _Before(network, Knowledge.of_robot(network))
    knowledge = Knowledge.of_fit(network, report.fit)
    return _Before(network, knowledge, report.fit, report.settings, sampling)


def _stated_noise(options: MotionOptions) -> dict[str, Any]:
    texts = {
        "torque": ("--torque-noise", options.torque_noise),
        "offset": ("--torque-offset", options.torque_offset),
        "resolution": ("--encoder", options.encoder),
    }
    given = {
        name: _numbers(option, text) for name, (option, text) in texts.items() if text is not None
    }
    return {**given, "estimator": options.estimator}


def _noise(before: _Before, limits: Limits, stated: dict[str, Any]) -> Noise:
    """Return noise as stated, or as earlier recordings had it, or a guess."""
    if before.fit is not None:
        cutoff = None if before.settings is None else before.settings.solver.cutoff
        return Noise.of_fit(before.fit, before.sampling, cutoff=cutoff, **stated)
    if "torque" not in stated:
        if not np.isfinite(limits.torque).all():
            raise ValueError("--torque-noise: expected it, as not all joints have a torque limit")
        stated["torque"] = tuple((_TORQUE_NOISE * limits.torque).tolist())
    # Between directions a torque differs, never by nothing, and by how much is unknown before a
    # first recording. Where the model has a coefficient for it, it is no error: no motion tells it
    # from the coefficient, and a criterion that counts both sees less of the others.
    torque, kinds = stated["torque"], before.network.friction_per_joint
    torque = torque if len(torque) > 1 else torque * len(kinds)
    pairs = zip(kinds, torque, strict=False)
    offset = tuple(0.0 if _CONSTANTS & set(terms) else value for terms, value in pairs)
    defaults: dict[str, Any] = {"resolution": _ENCODER, "offset": offset}
    return Noise(**(defaults | stated))


def _reached(before: _Before, names: list[str] | None, reach: float | None) -> str | None:
    """Return the message that nothing need be recorded, if so."""
    if reach is None:
        return None
    if not reach > 0.0:
        raise ValueError(f"--reach is {reach}; expected more than 0 %")
    indices = wanted_indices(before.network, names)
    size = np.abs(before.knowledge.k[indices])
    relative = 100 * before.knowledge.standard_error[indices] / np.where(size > 0, size, np.inf)
    if np.all(relative <= reach):
        return f"nothing to record: standard errors are {np.max(relative):.3g} % or less already"
    return None


def _numbers(option: str, text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"{option}: expected numbers as in 0.1,0.2, got {text!r}") from None
