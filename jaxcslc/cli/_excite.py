"""The command `jaxcslc excite`."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import typer

from ..excitation import (
    CRITERIA,
    FAMILIES,
    Design,
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
from ..report import check_output_folder, load_report
from ._common import (
    ColumnsOption,
    CommandContext,
    LengthsOption,
    RobotArgument,
    check_inputs_are_kept,
    choice_of,
    command_text,
    names_in,
    one_line_errors,
    progress,
    recording_of,
    recordings_of,
    typed_options,
)
from ._excite_options import MotionOptions
from ._robot_options import Drives, RobotPart
from ._spread import spread


# Kinds of friction with a coefficient for a torque that is the same whatever the motion.
_CONSTANTS = {"offset", "asymmetric_dry"}


@spread
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
    with one_line_errors(), progress("reading") as step:
        _check_options(context, options)
        arm = part.read(robot)
        before = _before(arm, options, columns, lambda: drives.network(arm, lengths), step)
        before, names = _wanted(before, options.wanted, options.payload)
        bounds = Limits.of(arm) if not options.limits else load_limits(options.limits, arm)
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
    text = _text(design, before, options.reach)
    typer.echo(f"{text}\n\nwrote " + ", ".join(map(str, paths)))


def _check_options(context: CommandContext, options: MotionOptions) -> None:
    choice_of("--family", options.family, FAMILIES)
    choice_of("--criterion", options.criterion, CRITERIA)
    if options.starts < 1:
        raise ValueError(f"--starts is {options.starts}; expected 1 or more")
    folder = options.output.parent
    if not folder.is_dir():
        raise ValueError(f"{folder}: no such folder")
    check_output_folder(folder)
    check_inputs_are_kept(context, design_files(options.output))


@dataclasses.dataclass(frozen=True)
class _Before:
    """Knowledge from earlier recordings."""

    network: CSLC
    knowledge: Knowledge
    fit: Identification | None = None
    sampling: Sampling | None = None
    cutoff: float | None = None  # of the low pass of the fit's equations [Hz]

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
        saved = load_report(prior, arm)
        settings = saved.settings
        sampling = None if settings is None else settings.chosen_on
        knowledge = Knowledge.of_fit(saved.network, saved.fit)
        return _Before(saved.network, knowledge, saved.fit, sampling, _cutoff(settings))
    network = derived()
    if not after:
        return _Before(network, Knowledge.of_robot(network))
    recordings = recordings_of(after, lambda path: recording_of(path, network.robot, columns))
    report = identify(network, recordings, possible="never", progress=step)
    sampling = Sampling.of(next(iter(recordings.values())))
    knowledge = Knowledge.of_fit(network, report.fit)
    return _Before(network, knowledge, report.fit, sampling, _cutoff(report.settings))


def _wanted(
    before: _Before, wanted: str | None, payload: float | None
) -> tuple[_Before, list[str] | None]:
    """Return what is known, with a payload if one is carried, and the coefficients that matter."""
    names = None if wanted is None else names_in(wanted)
    if payload is None:
        return before, names
    return before.carrying(payload), names or ["payload"]


def _cutoff(settings: Settings | None) -> float | None:
    """Return the cut-off of the low pass of a fit's equations; None without one."""
    return None if settings is None else settings.solver.cutoff


def _stated_noise(options: MotionOptions) -> dict[str, Any]:
    texts = {
        "torque": ("--torque-noise", options.torque_noise),
        "offset": ("--torque-offset", options.torque_offset),
        "resolution": ("--encoder", options.encoder),
    }
    stated = {
        name: _numbers(option, text) for name, (option, text) in texts.items() if text is not None
    }
    return stated | {"estimator": options.estimator}


def _noise(before: _Before, limits: Limits, stated: dict[str, Any]) -> Noise:
    """Stated, or as earlier recordings had it, or a guess."""
    if before.fit is not None:
        return Noise.of_fit(before.fit, before.sampling, cutoff=before.cutoff, **stated)
    if "torque" not in stated:
        if not np.isfinite(limits.torque).all():
            raise ValueError("--torque-noise: expected it, as not all joints have a torque limit")
        stated["torque"] = tuple((0.01 * limits.torque).tolist())
    defaults: dict[str, Any] = {"resolution": 1e-4, "offset": _offset(before, stated["torque"])}
    return Noise(**(defaults | stated))


def _offset(before: _Before, torque: tuple[float, ...]) -> tuple[float, ...]:
    """Return the assumed torque that differs between directions, per joint.

    It is unknown before a first recording, and never nothing. Where the model has a coefficient for
    it, it is no error. No motion tells it from the coefficient, and a criterion that counts both
    sees less of the others.
    """
    noise = torque if len(torque) > 1 else torque * before.network.joint_count
    return tuple(
        0.0 if _CONSTANTS & set(kinds) else value
        for kinds, value in zip(before.network.friction_per_joint, noise, strict=False)
    )


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


def _text(design: Design, before: _Before, reach: float | None) -> str:
    """The design, what it buys, and how long it takes to reach a wish."""
    lines = [str(design)]
    if before.fit is not None:
        lines += ["", f"{design.family.duration:g} s more are predicted to bring"]
        lines += [f"  {gain}" for gain in design.prediction.gains()]
    if reach is not None:
        seconds = design.seconds_for(reach / 100)
        lines.append(f"{reach:g} % of all sizes: about {seconds:.3g} s of such motion")
    return "\n".join(lines)


def _numbers(option: str, text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"{option}: expected numbers as in 0.1,0.2, got {text!r}") from None
